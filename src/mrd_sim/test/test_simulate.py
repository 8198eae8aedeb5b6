"""The simulator as a tool: an experiment or a recorded motion in, a run out."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import read_run
from mrd_sim.current import parse_laws
from mrd_sim.damper import Damper
from mrd_sim.simulate import simulate_plan, simulate_run, write_csv
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

EXPERIMENT = """
name: short
duration_s: 2.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 5.0, frequency_hz: 2.0}
coil: {waveform: constant, level_mA: 200.0}
"""


@pytest.fixture
def simulated():
    return simulate_plan(plan(parse_experiment(EXPERIMENT, "short"), Limits(), ForceEnvelope()), "bouc_wen", {})


def test_a_plan_gives_a_run_that_reads_back(simulated, tmp_path):
    write_csv(simulated, tmp_path / "short.csv")
    back = read_run(tmp_path / "short.csv")
    assert np.allclose(back.force, simulated.force, atol=1e-6)
    assert np.allclose(back.velocity, simulated.velocity, atol=1e-9)
    assert back.rate == pytest.approx(500.0)
    with pytest.raises(InputError, match="exists already"):
        write_csv(simulated, tmp_path / "short.csv")


def test_along_a_recorded_motion_the_same_model_gives_the_same_force(simulated):
    again = simulate_run(simulated, "bouc_wen", {})
    # The motion is smoothed from the positions before it is used.
    assert np.sqrt(np.mean((again.force - simulated.force)[50:] ** 2)) < 0.01 * np.std(simulated.force)


def test_the_tool(tmp_path):
    experiment = tmp_path / "short.yaml"
    experiment.write_text(EXPERIMENT)
    command = ["ros2", "run", "mrd_sim", "simulate", str(experiment), "--output", str(tmp_path / "out.csv")]
    done = subprocess.run([*command, "--model", "bingham", "--parameters", "{offset: -40}"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert read_run(Path(tmp_path / "out.csv")).force.min() < -100
    wrong = subprocess.run([*command, "--model", "binghm"], capture_output=True, text=True)
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("error: unknown model binghm (known: ")
    assert wrong.stderr.count("\n") == 1


def test_current_laws_are_chosen_by_text():
    assert parse_laws("tanh", "--law") == "tanh"
    assert parse_laws("", "--law") == ""
    assert parse_laws("yield_force=tanh, viscous = quadratic", "--law") == {"yield_force": "tanh", "viscous": "quadratic"}
    with pytest.raises(InputError, match=r"yield_force=,viscous=tanh is no current law, expected LAW or COEFF"):
        parse_laws("yield_force=,viscous=tanh", "--law")
    with pytest.raises(InputError, match="no current law for exponent"):
        Damper("bouc_wen", laws={"exponent": "tanh"})
    bent = Damper("bouc_wen", {"yield_force_saturation": 0.5}, "tanh")
    assert bent.model.at_current(bent.theta, 1.0)["yield_force"] == pytest.approx(80.0 + 900.0 * 0.5 * np.tanh(2.0))
