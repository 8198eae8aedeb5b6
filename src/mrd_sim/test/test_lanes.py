"""Candidates in lanes have the force that each has alone."""

import numpy as np
import pytest
from numba import njit

from mrd_sim.lanes import CANDIDATES, runs_in_lanes
from mrd_sim.models import MODELS, find_model
from mrd_sim.path import make_path

IN_LANES = ["linear_viscous", "bingham", "algebraic", "bouc_wen", "normalised_bouc_wen"]


def test_models_that_decide_nothing_themselves_run_in_lanes():
    assert set(IN_LANES) <= {name for name, model in MODELS.items() if model.runs_in_lanes}
    assert not MODELS["modified_bouc_wen"].runs_in_lanes
    assert not find_model("bouc_wen", effects=["seal_friction"]).runs_in_lanes

    @njit
    def decides(q, state, dt, x, v, a, force):
        force[0] = q[0, 0] if q[0, 0].real > 0.0 else x[0]

    assert not runs_in_lanes(decides)


@pytest.mark.parametrize("laws", [None, "quadratic", "tanh", "exponential"])
@pytest.mark.parametrize("name", IN_LANES)
def test_force_in_lanes_is_that_of_each_candidate(name, laws, examples):
    """Anywhere in the bounds, with and without coil lag; a number of candidates that does not fill the lanes."""
    model = find_model(name, laws)
    rng = np.random.default_rng(3)
    for samples in (30, 700):
        thetas = np.array([examples.values(rng, model.parameters) for _ in range(2 * CANDIDATES - 3)])
        thetas[::4, -1] = 0.0
        path = make_path(*examples.two_tones(**examples.motion(rng, samples=[samples])))
        found = model.forces_of(thetas, path, slice(3, None, 2))
        for force, theta in zip(found, thetas, strict=True):
            expected = model.force(theta, path)[3::2]
            assert np.allclose(force, expected, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(expected).max()))


def test_what_is_no_number_stays_none():
    model = MODELS["bouc_wen"]
    thetas = np.tile(model.defaults, (3, 1))
    thetas[1, 0] = np.nan
    time = np.arange(50) / 500.0
    force = model.forces_of(thetas, make_path(time, time, np.ones(50), np.zeros(50), np.full(50, 0.5)))
    assert np.isnan(force[1]).all()
    assert np.isfinite(force[[0, 2]]).all()
