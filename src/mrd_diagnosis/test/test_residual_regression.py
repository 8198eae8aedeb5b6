"""The explainable share of a gap: high for an effect of the path, none for noise."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_diagnosis.fitting.residual_regression import explainable_fraction
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.path import make_path

BASE = find_model("bouc_wen")
RATE = 250.0
NOISE = 1.5  # N
MOTIONS = (  # Hz, m
    ((0.5, 6e-3), (1.5, 4e-3), (4.0, 2e-3)),
    ((0.1, 20e-3), (0.9, 2e-3)),
    ((1.0, 10e-3),),
    ((3.0, 4e-3), (0.4, 5e-3)),
    ((2.0, 6e-3),),
)


def campaign(effect=None, seconds=12.0, seed=0):
    """Return recordings of the base model with an effect, and the residuals of the refitted base model."""
    model = find_model("bouc_wen", effects=[effect]) if effect else BASE
    theta = model.vector({f"{effect}.{k}": v for k, v in EFFECTS[effect].typical.items()} if effect else {})
    recordings = []
    for place, lines in enumerate(MOTIONS):
        random = np.random.default_rng([seed, place])
        time = np.arange(int(RATE * seconds)) / RATE
        w, a = 2 * np.pi * np.array([f for f, _ in lines]), np.array([a for _, a in lines])
        angle = np.outer(time, w) + random.uniform(0, 6, len(w))
        motion = np.sin(angle) @ a, np.cos(angle) @ (a * w), -np.sin(angle) @ (a * w**2)
        current = np.repeat(random.choice((0.0, 0.3, 0.6, 1.0), 100), int(0.3 * RATE))[: len(time)]
        force = model.force(theta, make_path(time, *motion, current)) + NOISE * random.standard_normal(len(time))
        recordings.append(prepare_recording(Run(f"run{place}", time, motion[0], motion[1], current, force)))
    fitted = fit_least_squares(make_problem(BASE, recordings)[0], BASE.defaults)[0] if effect else BASE.defaults
    return recordings, [r.force - r.modelled(BASE, fitted) for r in recordings]


def explainable(recordings, residuals):
    sigmas = [np.full(len(residual), NOISE) for residual in residuals]
    return explainable_fraction(recordings, residuals, sigmas, np.random.default_rng(0))


@pytest.mark.parametrize("effect", ["shear_thinning", "coil_lag", "gas_spring"])
def test_most_of_a_known_effect_can_be_explained_on_unseen_runs(effect):
    assert explainable(*campaign(effect)) > 0.4


def test_in_a_single_run_blocks_take_the_place_of_runs():
    recordings, residuals = campaign("shear_thinning", seconds=20.0)
    assert explainable(recordings[:1], residuals[:1]) > 0.4


@pytest.mark.parametrize("seed", range(4))
def test_noise_cannot_be_explained(seed):
    recordings, residuals = campaign(seed=seed)
    # The true motion is known here up to rounding: nothing but noise is left.
    assert explainable(recordings, residuals) < 0.05
    assert explainable(recordings[:1], residuals[:1]) < 0.05


def test_an_error_that_is_independent_of_the_path_cannot_be_explained():
    recordings, residuals = campaign()
    random = np.random.default_rng(3)
    added = [20.0 * np.cos(2 * np.pi * random.uniform(5, 9) * np.arange(len(r)) / RATE) for r in residuals]
    changed = []
    for recording, extra in zip(recordings, added, strict=True):
        force = recording.run.force.copy()
        force[recording.counted] += extra
        changed.append(replace(recording, smoothed=replace(recording.smoothed, run=replace(recording.run, force=force))))
    assert explainable(changed, [r + extra for r, extra in zip(residuals, added, strict=True)]) < 0.05


def test_zero_residuals_have_nothing_to_explain():
    recordings, residuals = campaign()
    silent = [0.0 * r for r in residuals]
    assert explainable_fraction(recordings, silent, silent, np.random.default_rng(0)) == 0.0


def test_the_same_seed_gives_the_same_share():
    runs = campaign("coil_lag", seconds=6.0)
    assert explainable(*runs) == explainable(*runs)
