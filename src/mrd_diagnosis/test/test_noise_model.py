"""The noise model, on simulated runs of which everything is known."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrd_diagnosis.noise.input_errors import propagated_variance
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_diagnosis.recordings.repetition import repeating_period, runs_repeat
from mrd_diagnosis.sequential.first_set import first_set
from mrd_identification.recording import Recording, prepare_recording
from mrd_runs import make_run, read_run
from mrd_runs.signals.smoothed_run import SmoothedRun
from mrd_sim.damper import Damper
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_sim.simulate import Instruments, measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import GeneratorSettings

DAMPER = Damper("bouc_wen")
EXACT = Instruments(run_gain=0.0, run_offset=0.0)
"""Without the scatter from run to run, which is no noise."""

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
    """Return a run without any gap: the damper's force along a true motion, and every channel measured with noise."""
    t = np.arange(int(seconds * rate) * FINE) / (rate * FINE)
    levels = np.random.default_rng(5).choice([0.0, 0.2, 0.5, 1.0], int(seconds / 0.1) + 1)
    current = levels[(t / 0.1).astype(int)] if kind in ("multisine", "steps") else np.full(len(t), 0.3)
    if kind == "multisine":
        lines = np.arange(0.3, 7.5, 0.6)
        motion = sines(t, lines, 4e-3 / lines, 7)
    elif kind == "fast":
        lines = np.arange(0.3, 11.0, 0.7) * 1.0137
        motion = sines(t, lines, 4e-3 / lines, 7)
    elif kind == "sine":
        motion = sines(t, np.array([2.3]), np.array([8e-3]), 7)
    elif kind == "wander":
        lines = np.array([0.7, 1.1, 1.9, 2.3]) * 1.0137
        motion = sines(t, lines, 5e-3 / lines, 7)
    else:
        motion = sines(t, np.array([0.21]), np.array([2e-2]), 7)
    force = DAMPER.model.force(DAMPER.theta, make_path(t, *motion, current))[::FINE]
    rng = np.random.default_rng(seed)
    position, _, acceleration = (series[::FINE] for series in motion)
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
def test_a_true_model_leaves_only_noise(accelerometer: bool) -> None:
    kinds = ("multisine", "sine", "wander", "steps")
    recordings = [recorded(kind, seed, accelerometer=accelerometer) for seed, kind in enumerate(kinds)]
    noises = estimate_noise(recordings, DAMPER.model, DAMPER.theta, np.random.default_rng(1))
    assert [noise.source for noise in noises] == ["residual", "periods", "residual", "residual"]
    for recording, noise in zip(recordings, noises, strict=True):
        left = (recording.force - recording.modelled(DAMPER.model, DAMPER.theta)) / noise.sigma
        near = near_reversals(recording)
        assert 0.8 < rms(left) < 1.2
        assert 0.7 < rms(left[near]) < 1.4
        assert 0.7 < rms(left[~near]) < 1.4
        assert noise.force == pytest.approx(FORCE, rel=0.2)
        assert rms(noise.sigma) == pytest.approx(np.hypot(noise.force, noise.motion), rel=1e-6)


@pytest.mark.parametrize("model", ["bingham", "quasi_static", "biviscous", "bouc_wen"])
def test_a_force_that_jumps_at_a_reversal_leaves_only_noise(model: str) -> None:
    """A converter gives the mean since the sample before, behind a filter, so that a jump lies anywhere in the reading."""
    plans = first_set(GeneratorSettings())
    damper = Damper(model)
    recordings = [
        prepare_recording(run) for run in measure_plans(plans, damper, np.random.default_rng(1), instruments=EXACT)
    ]
    noises = estimate_noise(recordings, damper.model, damper.theta, np.random.default_rng(1))
    for recording, noise in zip(recordings, noises, strict=True):
        left = (recording.force - recording.modelled(damper.model, damper.theta)) / noise.sigma
        assert rms(left) < 1.2


def test_a_force_that_bends_at_a_reversal_is_no_noise() -> None:
    """What a mass does at the reversals of a triangle is evidence, and no reading lies anywhere between."""
    text = (
        "name: fast\nduration_s: 8\nrate_hz: 500\n"
        "rod: {waveform: triangle, amplitude_mm: 10, slope_mm_per_s: 100}\ncoil: {waveform: constant, level_mA: 200}"
    )
    settings = GeneratorSettings()
    plans = [plan(parse_experiment(text, "fast"), settings.limits, settings.force_envelope)]
    (run,) = measure_plans(plans, DAMPER, np.random.default_rng(1), instruments=EXACT)
    recording = prepare_recording(run)
    with_it, without = (
        propagated_variance(recording, DAMPER.model, DAMPER.theta, np.random.default_rng(1), 8, within_readings=within)
        for within in (True, False)
    )
    assert (with_it - without).max() < 0.05 * FORCE**2


def test_changes_between_few_samples_are_noise() -> None:
    recording = recorded("fast", rate=25.0, seconds=60.0)
    (noise,) = estimate_noise([recording], DAMPER.model, DAMPER.theta, np.random.default_rng(1))
    left = (recording.force - recording.modelled(DAMPER.model, DAMPER.theta)) / noise.sigma
    assert 0.7 < rms(left) < 1.4


# At 100 Hz, even the slowest motion between two reversals is fast: some of the error of the model then counts as noise.
@pytest.mark.parametrize(("rate", "most"), [(100.0, 2.5), (500.0, 1.4)])
def test_the_error_of_a_wrong_model_is_no_noise(rate: float, most: float) -> None:
    recordings = [recorded(kind, rate=rate, seconds=20.0) for kind in ("sine", "wander")]
    wrong = find_model("bingham")
    theta = wrong.vector({"yield_force": 80.0, "yield_force_per_A": 900.0, "viscous": 900.0, "viscous_per_A": 2500.0})
    for recording, noise in zip(recordings, estimate_noise(recordings, wrong, theta, np.random.default_rng(2)), strict=True):
        residual = recording.force - recording.modelled(wrong, theta)
        assert rms(residual) > 15 * FORCE
        assert 0.7 * FORCE < noise.force < most * FORCE


def test_repeats_are_recognised() -> None:
    recordings = [recorded("multisine", 1), recorded("multisine", 2), recorded("sine", 3)]
    noises = estimate_noise(recordings, DAMPER.model, DAMPER.theta, np.random.default_rng(3))
    assert [noise.source for noise in noises] == ["repeats", "repeats", "periods"]
    assert noises[0].force == pytest.approx(FORCE, rel=0.2)


@pytest.mark.parametrize("current", [0.0, 0.3])
def test_a_repeat_without_current_or_of_another_length_is_recognised(current: float) -> None:
    def smoothed(seed: int, seconds: float) -> SmoothedRun:
        run = recorded("sine", seed, seconds=seconds).run
        return prepare_recording(replace(run, current=np.full(len(run), current))).smoothed

    first = smoothed(1, 12.0)
    assert runs_repeat(first, smoothed(2, 11.99))
    assert not runs_repeat(first, smoothed(2, 11.0))
    assert repeating_period(first) == pytest.approx(1 / 2.3, abs=2e-5)


def test_a_change_is_no_noise() -> None:
    """The damper is more viscous after the change; the model is the one from before."""
    recordings = []
    for seed, added in enumerate((0.0, 0.0, 500.0, 500.0)):
        run = recorded("wander", seed).run
        recording = prepare_recording(replace(run, force=run.force + added * run.velocity))
        recordings.append(replace(recording, without_effects=added == 0.0))
    for noise in estimate_noise(recordings, DAMPER.model, DAMPER.theta, np.random.default_rng(3)):
        assert noise.source == "repeats"
        assert noise.force == pytest.approx(FORCE, rel=0.2)


def test_blocks_of_one_run_do_not_repeat_each_other() -> None:
    whole = recorded("wander")
    blocks = [replace(whole, counted=slice(start, start + 2500)) for start in (500, 3200)]
    for noise in estimate_noise(blocks, DAMPER.model, DAMPER.theta, np.random.default_rng(8)):
        assert noise.source == "residual"
        assert noise.sigma.shape == (2500,)
        assert noise.force == pytest.approx(FORCE, rel=0.2)


def test_quantisation_of_the_force_is_noise() -> None:
    (noise,) = estimate_noise([recorded("wander", step=8.0)], DAMPER.model, DAMPER.theta, np.random.default_rng(4))
    assert noise.force == pytest.approx(np.hypot(FORCE, 8.0 / np.sqrt(12)), rel=0.2)


@pytest.mark.parametrize("frequency", [50.0, 59.97, 100.04, 120.0])
@pytest.mark.parametrize("kind", ["sine", "wander"])
def test_a_hum_is_no_noise(kind: str, frequency: float) -> None:
    recording = recorded(kind, rate=200.0)
    run = recording.run
    hum = 0.12 * np.std(run.force) * np.cos(2 * np.pi * frequency * run.time + 1.0)
    humming = prepare_recording(replace(run, force=run.force + hum))
    (noise,) = estimate_noise([humming], DAMPER.model, DAMPER.theta, np.random.default_rng(4))
    assert noise.force == pytest.approx(FORCE, rel=0.3)


def test_a_hum_in_a_measured_run_is_no_noise() -> None:
    folder = os.environ.get("MRD_DATA", str(Path(__file__).resolve().parents[4] / "shared/data"))
    file = Path(folder) / "utfsm/sine_25mm_0.25hz_0.5A.csv"
    if not file.exists():
        pytest.skip("no measured runs; name their folder by MRD_DATA")
    run = read_run(file)
    hum = 0.12 * np.sqrt(2) * np.std(run.force) * np.cos(2 * np.pi * 50.0 * run.time + 1.0)
    humming = prepare_recording(replace(run, force=run.force + hum))
    (noise,) = estimate_noise([humming], DAMPER.model, DAMPER.theta, np.random.default_rng(4))
    assert noise.force < 0.1 * np.std(hum)


def test_noise_is_never_larger_than_the_residual() -> None:
    recording = recorded("wander", rate=25.0, accelerometer=False)
    (noise,) = estimate_noise([recording], DAMPER.model, DAMPER.theta, np.random.default_rng(5))
    residual = recording.force - recording.modelled(DAMPER.model, DAMPER.theta)
    assert rms(noise.sigma) < 1.1 * rms(residual)


@pytest.mark.parametrize("count", [50, 200])
@pytest.mark.parametrize("moves", [True, False])
def test_short_runs_and_runs_without_noise_have_positive_finite_noise(count: int, moves: bool) -> None:
    t = np.arange(count) / 25
    x = 0.01 * np.sin(t) if moves else np.full(count, 0.01)
    run = make_run("short", {"time_s": t, "position_m": x, "current_A": np.zeros(count), "force_N": 100 * np.cos(t)})
    (noise,) = estimate_noise([prepare_recording(run)], DAMPER.model, DAMPER.theta, np.random.default_rng(7))
    assert np.isfinite(noise.sigma).all()
    assert noise.sigma.min() > 0


@pytest.mark.parametrize(("kind", "period"), [("sine", 1 / 2.3), ("wander", None), ("multisine", None), ("steps", None)])
def test_periods_are_found(kind: str, period: float | None) -> None:
    measured = repeating_period(recorded(kind).smoothed)
    assert measured is None if period is None else measured == pytest.approx(period, abs=2e-5)


def test_the_same_seed_gives_the_same() -> None:
    recording = recorded("wander", seconds=4.0)
    first, second = (estimate_noise([recording], DAMPER.model, DAMPER.theta, np.random.default_rng(6)) for _ in range(2))
    np.testing.assert_array_equal(first[0].sigma, second[0].sigma)
