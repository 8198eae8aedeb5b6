"""Recordings that begin in mid-motion or preloaded: their start is estimated, and tells nothing about the damper."""

import numpy as np
import pytest

from mrd_base import InputError
from mrd_identification import identify
from mrd_identification.recording import consecutive_forces, prepare_recording, thinned
from mrd_identification.run_start import estimate_starts
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_sim.path import make_path

RATE = 500.0
NOISE = 1.0
VALUES = {"yield_force": 80.0, "yield_force_per_A": 900.0, "yield_travel": 1.5e-4, "viscous": 900.0, "coil_lag": 0.0}


def recorded(name, scale, current, *, model="bouc_wen", skip=0.0, seconds=6.0, seed=0):
    """Two tones of ``scale``, recorded from ``skip`` on, of a damper that has been at rest before."""
    time = np.arange(int((seconds + skip) * RATE)) / RATE
    x, v, a = np.zeros((3, len(time)))
    for frequency, amplitude in ((0.7, 9e-3), (2.3, 3e-3)):
        w = 2 * np.pi * frequency
        angle = w * time + frequency
        x, v, a = (
            x + scale * amplitude * np.sin(angle),
            v + scale * amplitude * w * np.cos(angle),
            a - scale * amplitude * w**2 * np.sin(angle),
        )
    damper = find_model(model)
    force = damper.force(damper.vector(VALUES), make_path(time, x, v, a, np.full(len(time), current)))
    rng = np.random.default_rng(seed)
    force = force + rng.normal(0.0, NOISE, len(time))
    run = Run(name, time, x + rng.normal(0.0, 1e-6, len(time)), v, np.full(len(time), current), force)
    return run.without_start(skip)


def preloaded(current, direction, seconds=6.0):
    """Strokes of 0.1 mm about a rod that rests preloaded, because it came from one direction before."""
    time = np.arange(int((seconds + 2.0) * RATE)) / RATE
    before = np.clip(1.0 - time, 0.0, None)
    w = 2 * np.pi * 1.5
    swell = np.clip(time - 2.5, 0.0, 1.0)
    x = 5e-3 * direction * before + 5e-5 * swell * np.sin(w * time)
    v = np.gradient(x, time)
    damper = find_model("bouc_wen")
    path = make_path(time, x, v, np.gradient(v, time), np.full(len(time), current))
    force = damper.force(damper.vector(VALUES), path) + np.random.default_rng(1).normal(0.0, NOISE, len(time))
    return Run("preloaded", time, x, v, np.full(len(time), current), force).without_start(2.0)


@pytest.mark.parametrize("direction", [-1.0, 1.0])
@pytest.mark.parametrize("most", [400, 10_000])
def test_a_preloaded_run_gets_the_start_that_gives_its_force(direction, most):
    model = find_model("bouc_wen")
    theta = model.vector(VALUES)
    recordings = thinned([prepare_recording(recorded("a", 1.0, 0.5)), prepare_recording(preloaded(0.5, direction))], most)
    unknown, known = (
        consecutive_forces(model, theta, r)[1] for r in (recordings, estimate_starts(model, theta, recordings))
    )
    before, after = (float(np.std(force - recordings[1].force)) for force in (unknown, known))
    assert before > 20 * NOISE
    assert after < 2.5 * NOISE


@pytest.mark.parametrize("skip", [0.3, 0.7, 1.5, 2.2])
def test_a_cut_recording_is_identified_like_a_whole_one(skip):
    runs = [recorded(f"{current:g}", 1.0, current, skip=skip, seed=k) for k, current in enumerate((0.0, 0.3, 0.6))]
    runs.append(recorded("small", 0.02, 0.3, skip=skip, seed=9))
    fit = identify(runs, "bouc_wen", seeds=1, population=16, generations=8, profile=False)
    found = dict(zip(fit.model.names, fit.theta, strict=True))
    for result in fit.fitted:
        assert np.std(result.measured_counted - result.modelled_counted) < 1.5 * NOISE, result.run.name
    assert found["yield_travel"] == pytest.approx(VALUES["yield_travel"], rel=0.03)
    assert found["yield_force_per_A"] == pytest.approx(VALUES["yield_force_per_A"], rel=0.02)


def test_heat_is_carried_past_a_start_and_nothing_else():
    model = find_model("bouc_wen", effects=["thermal_fade", "settling", "load_cell_drift", "magnetic_hysteresis"])
    theta = model.vector(VALUES | {"thermal_fade.fade": 1e-4, "settling.excess": 0.2, "load_cell_drift.drift": 0.1})
    recordings = [prepare_recording(recorded(f"{k}", 1.0, 0.4, skip=0.7, seed=k)) for k in range(2)]
    assert all(recording.path.lead for recording in recordings)
    with_lead, without = [], []
    state = model.initial_state(recordings[0].path)
    for recording in recordings:
        model.force(theta, recording.path, state)
        with_lead.append(state[model.effect_states[0]].copy())
        state = model.next_state(state, recording.path)
    state = model.initial_state(recordings[0].path.recorded)
    for recording in recordings:
        model.force(theta, recording.path.recorded, state)
        without.append(state[model.effect_states[0]].copy())
        state = model.next_state(state, recording.path.recorded)
    assert np.allclose(with_lead, without, rtol=0.02)


@pytest.mark.parametrize("skip", [-1.0, 6.0, np.nan])
def test_nothing_left_to_skip_is_refused(skip):
    with pytest.raises(InputError, match="skip is"):
        recorded("a", 1.0, 0.5).without_start(skip)


def test_a_skip_leaves_samples_enough():
    time = np.arange(100) / 5.0
    run = Run("slow", time, np.sin(time), np.cos(time), 0 * time, np.cos(time))
    with pytest.raises(InputError, match=r"slow: skip is 19\.65 s, which leaves 1 of 100 samples; expected at least 50"):
        run.without_start(19.65)
    assert len(run.without_start(10.0)) == 50


def test_what_is_skipped_is_left_out():
    run = recorded("a", 1.0, 0.5)
    rest = run.without_start(0.5)
    assert rest.time[0] == 0.0
    assert rest.duration == pytest.approx(run.duration - 0.5)
    assert rest.force.tolist() == run.force[len(run) - len(rest) :].tolist()
