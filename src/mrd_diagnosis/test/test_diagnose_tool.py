"""The tool `diagnose`: its exit status."""

import sys
from dataclasses import replace

import pytest

from mrd_diagnosis.cli import diagnose
from mrd_sim.damper import Damper
from mrd_sim.simulate import simulate_plan, write_csv
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

EXPERIMENT = """
name: short
duration_s: 3.0
rate_hz: 250.0
rod: {waveform: sine, amplitude_mm: 8.0, frequency_hz: 1.5}
"""


def test_faulty_recordings_have_an_exit_status_of_their_own_and_a_report(tmp_path, monkeypatch, capsys):
    run = simulate_plan(plan(parse_experiment(EXPERIMENT, "short"), Limits(), ForceEnvelope()), Damper("bingham"))
    write_csv(replace(run, force=0 * run.force + 3.0), tmp_path / "dead.csv")
    monkeypatch.setattr(sys, "argv", ["mrd diagnose", str(tmp_path / "dead.csv"), "--output", str(tmp_path / "gap")])
    with pytest.raises(SystemExit) as end:
        diagnose.main()
    text, error = capsys.readouterr()
    assert end.value.code == 3
    assert text.startswith("Data problem (run dead, force): ")
    assert error.splitlines()[-1].startswith("error: the recordings are faulty, so that nothing was diagnosed; ")
    assert (tmp_path / "gap/gap_report.html").exists()
