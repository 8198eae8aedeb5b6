"""Lead-ins: a recording that begins in mid-motion, and every state that a model may have there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_sim.effects import EFFECTS
from mrd_sim.lead_in import moving_lead_in, resting_lead_in
from mrd_sim.models import MODELS, find_model
from mrd_sim.path import Path, make_path

RATE = 500.0
REACHES = 5e-3 * 3.0 ** -np.arange(4.0)
"""m from the last reversal to the first sample, of which the likeliest is taken."""
EFFECTS_WITH_MEMORY = [name for name, effect in EFFECTS.items() if not effect.only_as_change]


def motion(current: float, phase: float) -> tuple[np.ndarray, ...]:
    """Two tones of up to 12 mm, from 2 s on also a third one, at a constant current."""
    time = np.arange(int(6 * RATE)) / RATE
    x, v, a = np.zeros((3, len(time)))
    for frequency, amplitude in ((0.7, 9e-3), (2.3, 3e-3)):
        w = 2 * np.pi * frequency
        angle = w * time + phase * frequency
        x, v, a = x + amplitude * np.sin(angle), v + amplitude * w * np.cos(angle), a - amplitude * w**2 * np.sin(angle)
    return time, x, v, a, np.full(len(time), current)


def warm_path(*series: np.ndarray) -> Path:
    path = make_path(*series)
    return replace(path, temperature=np.full(len(path.dt), 330.0))


def cut_while_moving(v: np.ndarray, first: int) -> int:
    """Return the first sample from ``first`` on at which the rod is fast and has been for 100 ms."""
    slow = np.abs(v) < 0.3 * np.abs(v).max()
    return next(k for k in range(first, len(v)) if not slow[k - 50 : k].any())


@pytest.mark.parametrize(
    ("model", "effect"), [*((name, "") for name in MODELS), *(("bouc_wen", name) for name in EFFECTS_WITH_MEMORY)]
)
@settings(max_examples=4)
@given(current=st.floats(0.0, 0.8), phase=st.floats(0.0, 6.0), first=st.integers(400, 1500))
def test_a_cut_recording_gives_the_force_of_the_uncut_one(model: str, effect: str, current: float, phase: float, first: int):
    damper = find_model(model, effects=[effect] if effect else [])
    values = {f"{effect}.{name}": value for name, value in (EFFECTS[effect].typical if effect else {}).items()}
    theta = damper.vector(values)
    series = motion(current, phase)
    begin = cut_while_moving(series[2], first)
    uncut = damper.force(theta, warm_path(*series))[begin:]
    cut = warm_path(*(part[begin:] for part in series))
    from_rest, *led_ins = (
        damper.force(theta, path) - uncut
        for path in (cut, *(cut.led_in(moving_lead_in(cut.velocity[0], reach, 5e-3)) for reach in REACHES))
    )
    led_in = min(led_ins, key=np.std)
    if effect and (EFFECTS[effect].outlasts_run or EFFECTS[effect].begin):
        assert np.allclose(led_in[100:], from_rest[100:], atol=0.02 * np.std(uncut))  # these count from the first sample
        return
    # What a dashpot in series has let through over a minute is an offset of the run, which every fit allows for.
    led_in, from_rest = (error - error[len(error) // 2 :].mean() for error in (led_in, from_rest))
    if effect == "cavitation":
        # A void that the strokes before have left is gone after a long one (four reversals); no motion of a moment shows it.
        reversals = np.flatnonzero(np.diff(np.signbit(cut.velocity)))
        led_in, from_rest = led_in[reversals[3] :], from_rest[reversals[3] :]
    rms = [float(np.sqrt(np.mean(error**2))) for error in (from_rest, led_in)]
    assert np.sqrt(np.mean(led_in[25:] ** 2)) < 0.01 * np.std(uncut)  # after 50 ms
    assert rms[1] < 0.01 * np.std(uncut) or rms[1] < 0.2 * rms[0]


@given(st.floats(-0.5, 0.5).filter(lambda v: abs(v) > 1e-3), st.floats(1e-6, 0.1), st.floats(1e-4, 0.1))
def test_a_moving_lead_in_arrives_with_the_motion_of_the_first_sample(velocity: float, reach: float, approach: float):
    lead_in = moving_lead_in(velocity, reach, approach)
    assert (np.diff(lead_in.before) < 0).all()
    assert lead_in.before[-1] > 0
    last = -lead_in.before[-1]
    assert lead_in.position[-1] - lead_in.acceleration[-1] * last**2 / 2 == pytest.approx(velocity * last, rel=1e-6)
    assert lead_in.velocity[-1] == pytest.approx(velocity + lead_in.acceleration[-1] * last, rel=1e-6)
    assert np.min(np.sign(velocity) * lead_in.position) == pytest.approx(-reach)


@given(st.floats(-0.05, 0.05).filter(lambda r: abs(r) > 1e-6), st.floats(1e-4, 0.1), st.floats(1e-3, 0.5))
def test_a_resting_lead_in_ends_at_rest_where_the_recording_begins(reach: float, approach: float, speed: float):
    lead_in = resting_lead_in(reach, approach, speed)
    assert (np.diff(lead_in.before) < 0).all()
    assert lead_in.before[-1] > 0
    assert lead_in.position[-1] == lead_in.velocity[-1] == 0.0
    assert np.abs(lead_in.velocity).max() <= 1.0001 * speed * max(1.0, np.sqrt(abs(reach) / approach))
    assert lead_in.position.min() == pytest.approx(min(0.0, -reach, -reach + np.sign(reach) * approach))
    assert lead_in.position.max() == pytest.approx(max(0.0, -reach, -reach + np.sign(reach) * approach))


def test_a_path_takes_another_lead_in_and_gives_it_back():
    path = make_path(*motion(0.3, 1.0))
    led = path.led_in(moving_lead_in(0.1, 1e-3, 5e-3)).led_in(resting_lead_in(1e-3, 5e-3, 0.05))
    assert led.recorded is path
    assert led.led_in(None) is path
    assert path.recorded is path
    assert led.dt[0] == 0.0
    assert led.dt.sum() == pytest.approx(path.dt.sum() + led.lead_in.before[0])
    assert np.array_equal(led.position[led.samples], path.position[path.samples])
    assert replace(led, mains=path.mains).lead == led.lead
