"""The benchmarks fit the packages that they measure; `make bench` runs them."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


def test_all_benchmarks_can_be_imported() -> None:
    scripts = ", ".join(sorted(path.stem for path in FOLDER.glob("*.py")))
    done = subprocess.run([sys.executable, "-c", f"import {scripts}"], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("model_id", ["bouc_wen", "modified_bouc_wen", "shear_thinning_bouc_wen"])
def test_the_peer_integrates_the_equations_of_the_model(model_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(FOLDER)
    import common
    import integration

    from mrd_sim.models import MODELS
    from mrd_sim.path import make_path

    model = MODELS[model_id]
    time_s, x, v, i = common.sampled(int(0.5 * common.RATE))
    ours = model.force(model.defaults, make_path(time_s, x, v, np.gradient(v, time_s), i))
    peer = integration.with_odeint(model_id, model.defaults, time_s, x, v)
    assert np.sqrt(np.mean((ours - peer) ** 2)) < 1e-3 * np.std(peer)


@pytest.mark.slow
def test_the_benchmark_of_the_diagnosis_measures_every_candidate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(FOLDER)
    import diagnosis

    assert diagnosis.candidates(diagnosis.recorded("moving_mass")).row_count > 20


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_the_recorder_loses_nothing_in_five_minutes_at_2_khz() -> None:
    """Half an hour of it: `make soak`."""
    command = [sys.executable, "recorder.py", "--duration", "300", "--kills", "1"]
    done = subprocess.run(command, cwd=FOLDER, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    lost, samples = map(int, re.findall(r"lost: (\d+) of (\d+) samples", done.stdout)[0])
    assert lost == 0
    assert samples > 0.95 * 300 * 2000
    first, last = map(float, re.findall(r"memory: ([\d.]+) MB at first, ([\d.]+) MB at last", done.stdout)[0])
    assert last < first + 10
    assert "latency from the stamp of a block to the recorder: 50 %: " in done.stdout
