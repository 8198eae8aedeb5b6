"""What every damper model of the catalogue promises."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_sim.damper import Damper
from mrd_sim.models import MODELS, find_model
from mrd_sim.path import make_path

EVERY = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def sine(rate=1000.0, seconds=2.0, amplitude=0.01, frequency=1.5, current=0.3):
    time = np.arange(int(rate * seconds)) / rate
    w = 2 * np.pi * frequency
    return (
        time,
        amplitude * np.sin(w * time),
        amplitude * w * np.cos(w * time),
        -amplitude * w**2 * np.sin(w * time),
        np.full(len(time), current),
    )


@EVERY
def test_shape_and_names(model):
    force = model.force(model.defaults, make_path(*sine()))
    assert force.shape == (2000,)
    assert np.isfinite(force).all()
    assert len(set(model.names)) == len(model.names)
    for parameter in model.parameters:
        assert parameter.lower <= parameter.default <= parameter.upper
        assert not parameter.log or parameter.lower > 0
    assert model.source
    assert model.equation


@EVERY
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_finite_over_the_whole_bounds_box(model, data):
    unit = np.array([data.draw(st.floats(0, 1)) for _ in model.parameters])
    lower = np.array([p.lower for p in model.parameters])
    upper = np.array([p.upper for p in model.parameters])
    theta = lower + unit * (upper - lower)
    if "exponent" in model.names:
        theta[model.names.index("exponent")] = data.draw(st.sampled_from([1.0, 2.0]))
    path = make_path(*sine(rate=data.draw(st.sampled_from([25.0, 200.0, 1000.0])), amplitude=0.02, frequency=2.0))
    assert np.isfinite(model.force(theta, path)).all()


@EVERY
def test_dissipates_over_a_closed_cycle(model):
    time, x, v, a, current = sine(seconds=4 / 1.5)
    force = model.force(model.defaults, make_path(time, x, v, a, current))
    last = slice(len(time) // 2, None)
    assert np.sum(force[last] * v[last]) > 0


@EVERY
def test_force_grows_with_current(model):
    levels = [model.force(model.defaults, make_path(*sine(current=level))) for level in (0.0, 0.5, 1.0)]
    spans = [np.ptp(force) for force in levels]
    assert spans[0] < spans[1] < spans[2]


@EVERY
def test_odd_without_offset(model):
    """Turning the motion round turns the force round (the polynomial's branches change places and are equal here)."""
    theta = model.defaults.copy()
    if "offset" in model.names:
        theta[model.names.index("offset")] = 0.0
    time, x, v, a, current = sine()
    there = model.force(theta, make_path(time, x, v, a, current))
    back = model.force(theta, make_path(time, -x, -v, -a, current))
    assert np.allclose(there, -back, atol=1e-8)


@EVERY
def test_block_by_block_equals_at_once(model):
    time, x, v, a, current = sine(rate=8000.0)
    current = np.where(time < 1, 0.1, 0.6)
    damper = Damper(model.id)
    blocks = [damper.advance(1 / 8000, *(s[k : k + 77] for s in (x, v, a, current))) for k in range(0, len(x), 77)]
    whole = Damper(model.id).advance(1 / 8000, x, v, a, current)
    assert np.allclose(np.concatenate(blocks), whole, atol=1e-8)


@pytest.mark.parametrize("name", ["bouc_wen", "modified_bouc_wen"])
def test_sampling_rate_does_not_change_the_force(name):
    """Stable at any speed: at 0.2 m/s, 1 kHz agrees with 16 kHz, where explicit schemes at 1 kHz are far off."""
    model = find_model(name)
    fine = model.force(model.defaults, make_path(*sine(rate=16000.0, amplitude=0.0127, frequency=2.5)))
    coarse = model.force(model.defaults, make_path(*sine(rate=1000.0, amplitude=0.0127, frequency=2.5)))
    error = fine[::16] - coarse
    assert np.sqrt(np.mean(error**2)) < 3e-3 * np.std(fine)


def test_reversal_vertex_makes_the_hysteresis_independent_of_where_samples_fall():
    model = find_model("bouc_wen")
    theta = model.vector({"yield_travel": 3e-4, "coil_lag": 0.0})
    time = np.arange(0, 3, 0.01)
    w = 2 * np.pi * 1.5
    with_vertex, fine = [], []
    for shift in (0.0, 0.0037):
        t = time + shift
        x, v, a = 0.01 * np.sin(w * t), 0.01 * w * np.cos(w * t), -0.01 * w**2 * np.sin(w * t)
        with_vertex.append(model.force(theta, make_path(t, x, v, a, np.full(len(t), 0.5))))
        dense = np.arange(t[0], t[-1] + 5e-6, 1e-5)
        dense_force = model.force(
            theta,
            make_path(
                dense, 0.01 * np.sin(w * dense), 0.01 * w * np.cos(w * dense), -0.01 * w**2 * np.sin(w * dense),
                np.full(len(dense), 0.5),
            ),
        )
        fine.append(np.interp(t, dense, dense_force))
    for coarse, dense_force in zip(with_vertex, fine, strict=True):
        assert np.max(np.abs(coarse - dense_force)[20:]) < 0.02 * np.std(dense_force)


def test_spencer_is_two_equal_expressions():
    """The force through the outer dashpot equals the force through the element beside it, plus the accumulator."""
    model = find_model("modified_bouc_wen")
    values = dict(zip(model.names, model.defaults, strict=True)) | {"coil_lag": 0.0}
    time, x, v, a, current = sine(rate=4000.0)
    state = model.initial_state(make_path(time, x, v, a, current))
    theta = model.vector(values)
    whole = model.force(theta, make_path(time, x, v, a, current), state)
    w, y = state[2], state[4]
    c0 = values["viscous"] + values["viscous_per_A"] * 0.3
    c1 = values["series_viscous"] + values["series_viscous_per_A"] * 0.3
    f_y = values["yield_force"] + values["yield_force_per_A"] * 0.3
    outer = whole[-1] - values["accumulator_stiffness"] * x[-1] - values["offset"]
    inner = f_y * w + c0 * (v[-1] - outer / c1) + values["stiffness"] * (x[-1] - y)
    assert outer == pytest.approx(inner, rel=1e-9)


def test_modified_bouc_wen_converges_at_second_order():
    model = find_model("modified_bouc_wen")

    def at(rate):
        return model.force(model.defaults, make_path(*sine(rate=rate)))[:: int(rate // 500)]

    exact = at(64000.0)
    errors = [np.sqrt(np.mean((at(rate) - exact)[50:] ** 2)) for rate in (500.0, 1000.0, 2000.0)]
    order = np.log2(errors[0] / errors[2]) / 2
    assert order > 1.5


def test_lagged_current_follows_an_exponential():
    from mrd_sim.current import lagged_current

    time = np.arange(0, 0.05, 1e-3)
    current = np.where(time > 0, 1.0, 0.0)
    dt = np.diff(time, prepend=0.0)
    effective = lagged_current(0.005, np.zeros(2), dt, current)
    # The step is a ramp over the first sample: its mean delay is half a sample.
    assert np.allclose(effective[5:], 1 - np.exp(-(time[5:] - 0.5e-3) / 0.005), atol=2e-3)
    assert np.allclose(lagged_current(0.0, np.zeros(2), dt, current), current)


def test_wrong_names_and_values_are_one_line():
    with pytest.raises(InputError, match=r"unknown model bouc_wenn \(known: linear_viscous, bingham"):
        find_model("bouc_wenn")
    with pytest.raises(InputError, match="unknown parameter alpha"):
        find_model("bouc_wen").vector({"alpha": 1.0})
    with pytest.raises(InputError, match=r"yield_force is -5 N, expected 0 to 1500"):
        find_model("bouc_wen").vector({"yield_force": -5.0})
    with pytest.raises(InputError, match=r"exponent is 0\.5, expected 1 to 5"):
        find_model("bouc_wen").vector({"exponent": 0.5})
