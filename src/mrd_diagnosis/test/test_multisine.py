"""Noise and distortion of the force under an odd multisine, on runs of which everything is known."""

import numpy as np
import pytest

from mrd_base import InputError
from mrd_diagnosis.recordings.multisine import distortion
from mrd_runs import Run, make_run
from mrd_sim.damper import Damper
from mrd_sim.path import make_path

DAMPER = Damper("bouc_wen")
FORCE_NOISE = 1.5
LINES = np.array([1, 3, 5, 9, 11, 15, 17, 19])  # of 1/4 s; 7, 13 and all above 19 are left empty
PERIOD = 4.0


def multisine(force, periods: int = 6, noise: float = 0.0, rate: float = 500.0, seed: int = 1) -> Run:  # type: ignore[no-untyped-def]
    t = np.arange(round(periods * PERIOD * rate)) / rate
    phases = np.random.default_rng(7).uniform(0, 2 * np.pi, len(LINES))
    omega, amplitude = 2 * np.pi * LINES[:, None] / PERIOD, 0.03 / LINES[:, None]
    x = (amplitude * np.sin(omega * t + phases[:, None])).sum(0)
    v = (amplitude * omega * np.cos(omega * t + phases[:, None])).sum(0)
    rng = np.random.default_rng(seed)
    measured = force(t, x, v) + rng.normal(0, noise, len(t))
    position = x + rng.normal(0, 2e-6, len(t))
    columns = {"time_s": t, "position_m": position, "velocity_mps": v, "current_A": np.ones_like(t), "force_N": measured}
    return make_run("multisine", columns)


def at(line: int, t: np.ndarray) -> np.ndarray:
    """Return one newton rms at a line."""
    return np.sqrt(2) * np.cos(2 * np.pi * line * t / PERIOD + 0.3)


@pytest.mark.parametrize("rate", [500.0, 501.3])
def test_known_levels_of_distortion(rate: float) -> None:
    run = multisine(lambda t, x, v: 900 * v + 3 * at(4, t) + 4 * at(12, t) + 2 * at(13, t), noise=6.0, rate=rate)
    measured = distortion(run, PERIOD)
    assert (measured.noise, measured.even, measured.odd) == pytest.approx((6.0, 5.0, 2.0), rel=0.15)
    assert measured.periods == 6
    assert measured.highest == pytest.approx(57 / PERIOD)


def test_squares_are_even_and_cubes_are_odd() -> None:
    square = distortion(multisine(lambda t, x, v: 900 * v + 4000 * v**2, noise=0.5), PERIOD)
    cube = distortion(multisine(lambda t, x, v: 900 * v + 20000 * v**3, noise=0.5), PERIOD)
    linear = distortion(multisine(lambda t, x, v: 900 * v + 1000 * x, noise=0.5), PERIOD)
    assert square.even > 30 * square.odd
    assert cube.odd > 30 * cube.even
    assert max(linear.even, linear.odd) < 0.3


def test_a_damper_is_odd() -> None:
    def force(t: np.ndarray, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return DAMPER.model.force(DAMPER.theta, make_path(t, x, v, np.gradient(v, t), np.ones_like(t)))

    measured = distortion(multisine(force, noise=FORCE_NOISE), PERIOD)
    assert measured.odd > 20 * measured.even


def test_a_motion_that_is_no_odd_multisine_is_refused() -> None:
    run = multisine(lambda t, x, v: 900 * v)
    with pytest.raises(InputError, match="expected an odd multisine"):
        distortion(run, 2 * PERIOD)
    with pytest.raises(InputError, match="at least two"):
        distortion(run, 20.0)
