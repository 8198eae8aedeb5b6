"""Weighting of residuals where a model has diverged."""

from pathlib import Path

import numpy as np
import pytest

from mrd_diagnosis.fitting.weighting import Weighting, usual_run_scatter
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_identification.recording import prepare_recording
from mrd_runs import read_runs
from mrd_sim.models import find_model

EXAMPLE = Path(__file__).parents[3] / "examples" / "worn_joint" / "4_fast_sine.csv"


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e200])
def test_a_model_that_has_diverged_can_be_weighed(wrong):
    """A candidate that diverges from its start ended the whole diagnosis, when its force multiplied the gain of a run."""
    model = find_model("bingham")
    (run,) = read_runs(EXAMPLE)
    recording = prepare_recording(run)
    noise = estimate_noise([recording], model, model.defaults, np.random.default_rng(0))
    weighting = Weighting([recording], noise, usual_run_scatter(model.scales), {"coil_lag": 0.0})

    force = recording.modelled(model, model.defaults).copy()
    force[len(force) // 2 :] = wrong
    (white,) = weighting._whitenings([force])
    assert np.isfinite(white.basis).all()
    assert np.isfinite(white(recording.force)).all()
