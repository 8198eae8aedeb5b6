"""Known errors put into recordings of measured dampers: the diagnosis names them, and not in the untouched recordings."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrd_diagnosis import diagnose
from mrd_runs import read_runs

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def measured(pattern):
    folder = Path(os.environ.get("MRD_DATA", Path(__file__).resolve().parents[2] / "shared/data"))
    files = sorted(folder.glob(pattern))
    if not files:
        pytest.skip(f"no measured runs {pattern} in {folder}; name their folder by MRD_DATA")
    return read_runs([str(file) for file in files])


def asymmetric(run):
    """Make the damper 12 % harder in extension."""
    return replace(run, force=run.force * np.where(run.velocity > 0.0, 1.12, 1.0))


def late(run):
    """Delay the force by 12 ms."""
    return replace(run, force=np.interp(run.time - 0.012, run.time, run.force))


def stopped(run):
    """Let the rod meet a stop of rubber at 19.85 mm."""
    depth = np.maximum(np.abs(run.position) - 19.85e-3, 0.0)
    return replace(run, force=run.force + 2e6 * np.sign(run.position) * depth**1.5)


@pytest.mark.parametrize(
    ("pattern", "model", "alter", "names"),
    [
        ("utfpr/*.csv", "auto", asymmetric, {"flow_asymmetry"}),
        # Around the modified Bouc-Wen model, which predicts as well, nothing is named yet.
        ("utfsm/sine_*.csv", "shear_thinning_bouc_wen", late, {"channel_delay", "force_sensor_lag"}),
        ("utfsm/sine_*.csv", "auto", stopped, {"end_stop"}),
    ],
    ids=["flow asymmetry", "delay", "end stop"],
)
def test_a_known_error_in_a_measured_recording_is_named(pattern, model, alter, names):
    untouched = measured(pattern)
    altered = diagnose([alter(run) for run in untouched], model)
    assert names & {cause.effect for cause in altered.causes}, altered.sentence
    background = diagnose(untouched, model)
    assert not names & {cause.effect for cause in background.causes}, background.sentence
