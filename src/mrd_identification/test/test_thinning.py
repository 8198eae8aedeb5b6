"""Thinned recordings: fewer samples and vertices, the same modelled force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_identification.low_pass import with_force_filter
from mrd_identification.recording import consecutive_forces, prepare_recording, thinned
from mrd_runs import Run
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model


def recording(rate, seconds, frequency=1.5, seed=0):
    """A sine with a switched current at a sampling rate, of a Bouc-Wen damper."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(rate * seconds)) / rate
    w = 2 * np.pi * frequency
    x, v = 0.01 * np.sin(w * t), 0.01 * w * np.cos(w * t)
    current = np.where(np.sin(7.3 * t) > 0, 0.4, 0.1)
    force = (60.0 + 700.0 * current) * np.tanh(v / 0.02) + 900.0 * v + rng.normal(0, 1.5, len(t))
    return prepare_recording(Run(f"{rate:g}Hz_{seed}", t, x, v, current, force))


@settings(max_examples=20)
@given(most=st.integers(300, 8000))
def test_about_as_many_samples_are_counted_as_asked_for_and_fast_recordings_lose_most(most):
    recordings = [recording(1000.0, 4.0), recording(100.0, 4.0), recording(500.0, 2.0)]
    fewer = thinned(recordings, most)
    samples = sum(len(of_run.force) for of_run in fewer)
    assert samples <= 1.25 * most
    assert samples >= min(0.4 * most, 0.4 * sum(len(of_run.force) for of_run in recordings))
    rates = [of_run.run.rate / of_run.step for of_run in fewer]
    assert max(rates) <= 2.1 * min(rates) or fewer[1].step == 1
    for before, after in zip(recordings, fewer, strict=True):
        assert np.isin(after.force, before.force).all()
        assert len(after.path.dt) <= len(before.path.dt)
        assert after.whole.force.tolist() == before.force.tolist()
        assert after.path.dt.sum() == pytest.approx(before.path.dt.sum(), abs=1e-9)


def test_recordings_that_are_short_enough_stay_as_they_are():
    recordings = [recording(200.0, 2.0)]
    assert thinned(recordings, 1000)[0] is recordings[0]


@pytest.mark.parametrize("word", ["lowpass:3", "lowpass:20:4:zero-phase", "average:0.2:past"])
def test_a_thinned_recording_passes_the_filter_of_the_whole_one(word):
    model = find_model("bouc_wen")
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 700.0, "coil_lag": 0.0})
    whole = [prepare_recording(with_force_filter(recording(1000.0, 4.0).run, word))]
    part = thinned(whole, 400)
    expected = consecutive_forces(model, theta, whole)[0][:: part[0].step]
    found = consecutive_forces(model, theta, part)[0]
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.02 * expected.std()


@pytest.mark.parametrize(
    "effect", [None, "coil_lag", "force_sensor_lag", "channel_delay", "joint_play", "series_compliance"]
)
def test_a_thinned_recording_gives_the_force_of_the_whole_one(effect):
    model = find_model("bouc_wen", effects=[effect] if effect else [])
    sizes = {f"{effect}.{name}": value for name, value in EFFECTS[effect].typical.items()} if effect else {}
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 700.0, "coil_lag": 0.0} | sizes)
    whole = [recording(1000.0, 4.0)]
    part = thinned(whole, 400)
    assert part[0].step == 10
    expected = consecutive_forces(model, theta, whole)[0][:: part[0].step]
    found = consecutive_forces(model, theta, part)[0]
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.02 * expected.std()
