"""The noise floor, on simulated runs of which everything is known."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_diagnosis.noise_model import distortion, repeating_period, run_noise
from mrd_identification.recording import Recording, prepare_recording
from mrd_runs import Run, make_run
from mrd_sim.damper import Damper
from mrd_sim.models import find_model
from mrd_sim.path import make_path

DAMPER = Damper("bouc_wen")
FORCE, POSITION, CURRENT, ACCELERATION = 1.5, 8e-6, 4e-3, 0.05
FINE = 8


def sines(t: np.ndarray, lines: np.ndarray, amplitudes: np.ndarray, seed: int) -> tuple[np.ndarray, ...]:
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(lines))
    omega = 2 * np.pi * lines[:, None]
    angle, amplitude = omega * t + phases[:, None], amplitudes[:, None]
    return (
        (amplitude * np.sin(angle)).sum(0),
        (amplitude * omega * np.cos(angle)).sum(0),
        -(amplitude * omega**2 * np.sin(angle)).sum(0),
    )


def recorded(
    kind: str, seed: int = 0, *, rate: float = 500.0, seconds: float = 12.0, accelerometer: bool = True, step: float = 0.0
) -> Recording:
    """A null run: the damper's force along a true motion, and everything read with noise."""
    t = np.arange(int(seconds * rate) * FINE) / (rate * FINE)
    levels = np.random.default_rng(5).choice([0.0, 0.2, 0.5, 1.0], int(seconds / 0.1) + 1)
    current = levels[(t / 0.1).astype(int)] if kind in ("multisine", "steps") else np.full(len(t), 0.3)
    if kind == "multisine":
        lines = np.arange(0.3, 7.5, 0.6)
        moved = sines(t, lines, 4e-3 / lines, 7)
    elif kind == "fast":
        lines = np.arange(0.3, 11.0, 0.7) * 1.0137
        moved = sines(t, lines, 4e-3 / lines, 7)
    elif kind == "sine":
        moved = sines(t, np.array([2.3]), np.array([8e-3]), 7)
    elif kind == "wander":
        lines = np.array([0.7, 1.1, 1.9, 2.3]) * 1.0137
        moved = sines(t, lines, 5e-3 / lines, 7)
    else:
        moved = sines(t, np.array([0.21]), np.array([2e-2]), 7)
    force = DAMPER.model.force(DAMPER.theta, make_path(t, *moved, current))[::FINE]
    rng = np.random.default_rng(seed)
    position, _, acceleration = (series[::FINE] for series in moved)
    force = force + rng.normal(0, FORCE, len(force))
    columns = {
        "time_s": t[::FINE],
        "position_m": position + rng.normal(0, POSITION, len(force)),
        "current_A": current[::FINE] + rng.normal(0, CURRENT, len(force)),
        "force_N": np.round(force / step) * step if step else force,
    }
    if accelerometer:
        columns["acceleration_mps2"] = acceleration + rng.normal(0, ACCELERATION, len(force))
    return prepare_recording(make_run(f"{kind}{seed}", columns))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def near_reversals(recording: Recording, reach: float = 0.02) -> np.ndarray:
    velocity = recording.motion.velocity
    turns = np.flatnonzero(velocity[1:] * velocity[:-1] < 0)
    near = np.abs(recording.run.time[:, None] - recording.run.time[turns]).min(axis=1) < reach
    return near[recording.counted]


@pytest.mark.parametrize("accelerometer", [True, False])
def test_of_true_models_nothing_is_left(accelerometer: bool) -> None:
    kinds = ("multisine", "sine", "wander", "steps")
    recordings = [recorded(kind, seed, accelerometer=accelerometer) for seed, kind in enumerate(kinds)]
    found = run_noise(recordings, DAMPER.model, DAMPER.theta, np.random.default_rng(1))
    assert [noise.source for noise in found] == ["residual", "periods", "residual", "residual"]
    for recording, noise in zip(recordings, found, strict=True):
        left = (recording.force - recording.modelled(DAMPER.model, DAMPER.theta)) / noise.sigma
        near = near_reversals(recording)
        assert 0.8 < rms(left) < 1.2
        assert 0.7 < rms(left[near]) < 1.4
        assert 0.7 < rms(left[~near]) < 1.4
        assert noise.force == pytest.approx(FORCE, rel=0.2)
        assert rms(noise.sigma) == pytest.approx(np.hypot(noise.force, noise.motion), rel=1e-6)


def test_what_happens_between_few_samples_is_noise() -> None:
    recording = recorded("fast", rate=25.0, seconds=60.0)
    (noise,) = run_noise([recording], DAMPER.model, DAMPER.theta, np.random.default_rng(1))
    left = (recording.force - recording.modelled(DAMPER.model, DAMPER.theta)) / noise.sigma
    assert 0.7 < rms(left) < 1.4


# At 100 Hz nothing between two reversals is slow: some of what the model misses then counts as noise.
@pytest.mark.parametrize(("rate", "most"), [(100.0, 2.5), (500.0, 1.4)])
def test_what_a_wrong_model_leaves_is_no_noise(rate: float, most: float) -> None:
    recordings = [recorded(kind, rate=rate, seconds=20.0) for kind in ("sine", "wander")]
    wrong = find_model("bingham")
    theta = wrong.vector({"yield_force": 80.0, "yield_force_per_A": 900.0, "viscous": 900.0, "viscous_per_A": 2500.0})
    for recording, noise in zip(recordings, run_noise(recordings, wrong, theta, np.random.default_rng(2)), strict=True):
        residual = recording.force - recording.modelled(wrong, theta)
        assert rms(residual) > 15 * FORCE
        assert 0.7 * FORCE < noise.force < most * FORCE


def test_repeats_are_known() -> None:
    recordings = [recorded("multisine", 1), recorded("multisine", 2), recorded("sine", 3)]
    found = run_noise(recordings, DAMPER.model, DAMPER.theta, np.random.default_rng(3))
    assert [noise.source for noise in found] == ["repeats", "repeats", "periods"]
    assert found[0].force == pytest.approx(FORCE, rel=0.2)


def test_blocks_of_one_run_do_not_repeat_each_other() -> None:
    whole = recorded("wander")
    blocks = [replace(whole, counted=slice(start, start + 2500)) for start in (500, 3200)]
    for noise in run_noise(blocks, DAMPER.model, DAMPER.theta, np.random.default_rng(8)):
        assert noise.source == "residual"
        assert noise.sigma.shape == (2500,)
        assert noise.force == pytest.approx(FORCE, rel=0.2)


def test_digits_of_the_force_are_noise() -> None:
    (found,) = run_noise([recorded("wander", step=8.0)], DAMPER.model, DAMPER.theta, np.random.default_rng(4))
    assert found.force == pytest.approx(np.hypot(FORCE, 8.0 / np.sqrt(12)), rel=0.2)


def test_noise_is_never_larger_than_the_residual() -> None:
    recording = recorded("wander", rate=25.0, accelerometer=False)
    (found,) = run_noise([recording], DAMPER.model, DAMPER.theta, np.random.default_rng(5))
    residual = recording.force - recording.modelled(DAMPER.model, DAMPER.theta)
    assert rms(found.sigma) < 1.1 * rms(residual)


@pytest.mark.parametrize("count", [50, 200])
@pytest.mark.parametrize("moves", [True, False])
def test_short_runs_and_runs_without_noise_have_a_floor(count: int, moves: bool) -> None:
    t = np.arange(count) / 25
    x = 0.01 * np.sin(t) if moves else np.full(count, 0.01)
    run = make_run("short", {"time_s": t, "position_m": x, "current_A": np.zeros(count), "force_N": 100 * np.cos(t)})
    (found,) = run_noise([prepare_recording(run)], DAMPER.model, DAMPER.theta, np.random.default_rng(7))
    assert np.isfinite(found.sigma).all()
    assert found.sigma.min() > 0


@pytest.mark.parametrize(("kind", "period"), [("sine", 1 / 2.3), ("wander", None), ("multisine", None), ("steps", None)])
def test_periods_are_found(kind: str, period: float | None) -> None:
    found = repeating_period(recorded(kind).smoothed)
    assert found is None if period is None else found == pytest.approx(period, abs=2e-5)


def test_the_same_seed_gives_the_same() -> None:
    recording = recorded("wander", seconds=4.0)
    first, second = (run_noise([recording], DAMPER.model, DAMPER.theta, np.random.default_rng(6)) for _ in range(2))
    np.testing.assert_array_equal(first[0].sigma, second[0].sigma)


LINES = np.array([1, 3, 5, 9, 11, 15, 17, 19])  # of 1/4 s; 7, 13 and all above 19 are left empty
PERIOD = 4.0


def multisine(force, periods: int = 6, noise: float = 0.0, rate: float = 500.0, seed: int = 1) -> Run:  # type: ignore[no-untyped-def]
    t = np.arange(round(periods * PERIOD * rate)) / rate
    x, v, _ = sines(t, LINES / PERIOD, 0.03 / LINES, 7)
    rng = np.random.default_rng(seed)
    measured = force(t, x, v) + rng.normal(0, noise, len(t))
    position = x + rng.normal(0, 2e-6, len(t))
    columns = {"time_s": t, "position_m": position, "velocity_mps": v, "current_A": np.ones_like(t), "force_N": measured}
    return make_run("multisine", columns)


def at(line: int, t: np.ndarray) -> np.ndarray:
    """One newton rms at a line."""
    return np.sqrt(2) * np.cos(2 * np.pi * line * t / PERIOD + 0.3)


@pytest.mark.parametrize("rate", [500.0, 501.3])
def test_known_levels_of_distortion(rate: float) -> None:
    run = multisine(lambda t, x, v: 900 * v + 3 * at(4, t) + 4 * at(12, t) + 2 * at(13, t), noise=6.0, rate=rate)
    found = distortion(run, PERIOD)
    assert (found.noise, found.even, found.odd) == pytest.approx((6.0, 5.0, 2.0), rel=0.15)
    assert found.periods == 6
    assert found.highest == pytest.approx(57 / PERIOD)


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

    found = distortion(multisine(force, noise=FORCE), PERIOD)
    assert found.odd > 20 * found.even


def test_what_is_no_multisine_is_refused() -> None:
    run = multisine(lambda t, x, v: 900 * v)
    with pytest.raises(InputError, match="odd lines"):
        distortion(run, 2 * PERIOD)
    with pytest.raises(InputError, match="at least two"):
        distortion(run, 20.0)
