"""What every damper model of the catalogue promises, and what single ones do besides."""

import gc
import sys
import weakref
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from mrd_base import InputError
from mrd_runs.scales import REFERENCE
from mrd_sim.cli import models as tool
from mrd_sim.current import LAWS, lagged_current
from mrd_sim.damper import Damper
from mrd_sim.dual_type import along, as_duals
from mrd_sim.effects import find_effects
from mrd_sim.hysteresis import advance
from mrd_sim.models import MODELS, find_model
from mrd_sim.models.modified_bouc_wen import travel_of_element
from mrd_sim.models.quasi_static import pressure_drop, yield_stress
from mrd_sim.models_page import COMMAND, page
from mrd_sim.path import Path, make_path

EVERY = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
BY_NAME = pytest.mark.parametrize("name", MODELS)  # a failing random example then shows a name and a seed only
TINY = 1e-9  # of the largest force


def seeds(count):
    """Run a test with random seeds. A failing seed is reported, and tried first the next time."""

    def decorate(test):
        phases = (Phase.explicit, Phase.reuse, Phase.generate)
        return settings(max_examples=count, phases=phases)(given(seed=st.integers(0, 2**32 - 1))(test))

    return decorate


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


def damper(examples, rng, model, margin=0.0):
    """The model with any current laws, and parameters from anywhere in its bounds, ``margin`` away from them."""
    if model.laws and rng.random() < 0.5:
        model = model.with_laws({name: str(rng.choice(list(LAWS))) for name in model.laws})
    theta = examples.values(rng, model.parameters, margin)
    for coefficient in model.coefficients:
        if coefficient.symbol == "n" and rng.random() < 0.5:
            theta[model.names.index(coefficient.name)] = rng.choice([1.0, 2.0])  # written-out solutions
    return model, theta


def values(model, theta):
    return dict(zip(model.names, theta, strict=True))


@EVERY
def test_shape_names_and_defaults(model):
    force = model.force(model.defaults, make_path(*sine()))
    assert force.shape == (2000,)
    assert np.isfinite(force).all()
    assert len(set(model.names)) == len(model.names)
    assert len({coefficient.symbol for coefficient in model.coefficients}) == len(model.coefficients)
    for parameter in model.parameters:
        assert parameter.lower < parameter.upper or (parameter.is_constant and not parameter.free)
        assert parameter.lower <= parameter.default <= parameter.upper
        assert not parameter.log or parameter.lower > 0
        assert parameter.meaning
    assert model.title
    assert model.source
    assert model.equation


@BY_NAME
@seeds(40)
def test_finite_over_the_whole_bounds_box(name, examples, seed):
    """Force and derivative; real and dual numbers give the same force."""
    model = MODELS[name]
    rng = np.random.default_rng(seed)
    model, theta = damper(examples, rng, model)
    path = make_path(*examples.two_tones(**examples.motion(rng)))
    force = model.force(theta, path)
    assert np.isfinite(force).all()
    with_derivative = model.force(along(theta, np.arange(len(theta)) == rng.integers(len(theta))), path)
    assert np.isfinite(with_derivative.derivatives).all()
    assert np.allclose(with_derivative.real, force, rtol=0, atol=TINY * (1 + np.max(np.abs(force))))


@BY_NAME
@seeds(8)
def test_derivatives_agree_with_central_differences(name, examples, seed):
    model = MODELS[name]
    rng = np.random.default_rng(seed)
    model, theta = damper(examples, rng, model, margin=0.1)
    path = make_path(*examples.two_tones(**examples.motion(rng, samples=[200])))
    size = np.max(np.abs(model.force(theta, path)))
    for index, parameter in enumerate(model.parameters):
        direction = np.zeros(len(theta))
        direction[index] = theta[index] if parameter.log else parameter.upper - parameter.lower
        found = model.force(along(theta, direction), path).derivatives[:, 0]

        def error(step, direction=direction, found=found):
            difference = model.force(theta + step * direction, path) - model.force(theta - step * direction, path)
            # A kink of the force may lie between the two: a few samples may differ.
            return np.quantile(np.abs(found - difference / (2 * step)), 0.97)

        # Where the force bends sharply, the shorter step is the better one; where it is large, the longer.
        limit = 1e-3 * np.max(np.abs(found)) + 1e-6 * size
        assert error(1e-5) <= limit or error(1e-7) <= limit, parameter.name


@pytest.mark.parametrize("effects", [(), ("series_compliance",)], ids=["alone", "in series"])
@EVERY
def test_derivatives_agree_with_central_differences_where_the_rod_begins_at_rest(model, effects):
    """Smoothed recordings do: before the first stroke, they move by no more than rounding."""
    model = model.with_effects(find_effects(effects))
    theta = model.defaults
    if effects:
        theta[model.names.index("series_compliance.compliance")] = 4e-7
    time, position, velocity, acceleration, current = sine(rate=100.0, seconds=3.0)
    share = np.exp(np.minimum(0.0, 80.0 * (time - 2.0)))  # 1e-70 at first
    velocity = share * velocity + np.where(time < 2.0, 80.0 * share * position, 0.0)
    # Off the middle of the stroke, where the force of some models jumps.
    path = make_path(time, 5e-3 + share * position, velocity, share * acceleration, current)
    size = np.max(np.abs(model.force(theta, path)))
    for index, parameter in enumerate(model.parameters):
        step = 1e-5 * (theta[index] if parameter.log else parameter.upper - parameter.lower)
        direction = step * (np.arange(len(theta)) == index)
        if not step or not parameter.lower <= theta[index] - step <= theta[index] + step <= parameter.upper:
            continue
        found = model.force(along(theta, direction), path).derivatives[:, 0]
        difference = 0.5 * (model.force(theta + direction, path) - model.force(theta - direction, path))
        assert np.quantile(np.abs(found - difference), 0.97) <= 0.01 * np.max(np.abs(difference)) + 1e-9 * size, (
            parameter.name
        )


@BY_NAME
@seeds(20)
def test_linear_part_and_rest_make_the_force(name, examples, seed):
    model = MODELS[name]
    rng = np.random.default_rng(seed)
    model, theta = damper(examples, rng, model)
    path = make_path(*examples.two_tones(**examples.motion(rng)))
    ((columns, rest),) = model.regressors(theta[None], path)
    terms = columns * theta[model.linear]
    size = np.abs(terms).sum(axis=1) + np.abs(rest)
    assert np.all(np.abs(terms.sum(axis=1) + rest - model.force(theta, path)) <= TINY * (1 + np.max(size)))
    other = theta.copy()
    other[model.linear] = 0.0
    ((again, rest_again),) = model.regressors(other[None], path)
    assert np.array_equal(again, columns)
    assert np.array_equal(rest_again, rest)


@pytest.mark.parametrize("name", [m.id for m in MODELS.values() if m.dissipative])
@seeds(40)
def test_no_closed_cycle_yields_energy(name, examples, seed):
    """From rest round closed cycles, no energy comes out: neither the first time nor once the loop has settled.

    Wherever in the bounds, as long as the current laws leave the damping coefficients within theirs.
    """
    rng = np.random.default_rng(seed)
    count, model = 8000, MODELS[name]
    motion = examples.motion(rng, cycles=3, samples=[count])
    motion["later_current"] = motion["current"]
    for _ in range(100):
        varied, theta = damper(examples, rng, model)
        coefficients = varied.at_current(theta, motion["current"])
        if all(coefficients[c.name] >= c.lower for c in varied.coefficients if c.multiplies in ("v", "term")):
            break
    else:
        pytest.fail("no parameters found whose damping coefficients are within their bounds")
    model = varied
    path = make_path(*examples.two_tones(**motion))
    force = model.force(theta, replace(path, samples=np.arange(len(path.dt))))
    tiny = 1e-3 * np.ptp(force) * np.ptp(path.position) + 1e-12  # a step of the force falls between two samples
    for cycle in (1, 2, 3):
        upto = slice(path.samples[cycle * count] + 1)
        assert trapezoid(force[upto], path.position[upto]) >= -cycle * tiny


@EVERY
def test_dissipates_over_a_settled_cycle_by_default(model):
    time, x, v, a, current = sine(seconds=4 / 1.5)
    force = model.force(model.defaults, make_path(time, x, v, a, current))
    last = slice(len(time) // 2, None)
    power = np.mean(force[last] * v[last])
    assert 0.2 * np.std(force[last]) * np.std(v[last]) < power


@BY_NAME
@seeds(10)
def test_without_current_only_the_values_at_zero_ampere_count(name, examples, seed):
    model = MODELS[name]
    rng = np.random.default_rng(seed)
    model, theta = damper(examples, rng, model)
    known = values(model, theta)
    assert model.at_current(theta, 0.0) == {q.name: known[q.name] for q in model.coefficients}
    time, x, v, a, _ = examples.two_tones(**examples.motion(rng))
    path = make_path(time, x, v, a, np.zeros(len(time)))
    plain = model.vector({name: known[name] for name in model.at_current(theta, 0.0)} | {"coil_lag": known["coil_lag"]})
    assert np.array_equal(model.force(theta, path), model.force(plain, path))


@EVERY
def test_force_grows_with_current(model):
    levels = [model.force(model.defaults, make_path(*sine(current=level))) for level in (0.0, 0.5, 1.0)]
    spans = [np.ptp(force) for force in levels]
    assert 100 < spans[0] < spans[1] < spans[2] < 4000


@pytest.mark.parametrize("name", [m.id for m in MODELS.values() if m.odd])
@seeds(20)
def test_odd_without_offset(name, examples, seed):
    """Turning the motion round turns the force round."""
    rng = np.random.default_rng(seed)
    model, theta = damper(examples, rng, MODELS[name])
    offset = ("offset", "offset_per_A", "offset_per_A2")
    theta = np.array([0.0 if name in offset else value for name, value in values(model, theta).items()])
    time, x, v, a, current = examples.two_tones(**examples.motion(rng))
    there = model.force(theta, make_path(time, x, v, a, current))
    back = model.force(theta, make_path(time, -x, -v, -a, current))
    assert np.allclose(there, -back, rtol=0, atol=TINY * (1 + np.max(np.abs(there))))


@BY_NAME
@pytest.mark.parametrize("effects", [(), ("end_stop", "joint_play")])
def test_position_counts_from_mid_stroke(name, effects):
    """A sensor may count from anywhere."""
    model = find_model(name, effects=effects)
    values = (
        {"end_stop.stiffness": 1e8, "end_stop.upper": 5e-3, "end_stop.lower": -4e-3, "joint_play.play": 2e-4}
        if effects
        else {}
    )
    time, x, v, a, current = sine()
    near, far = (make_path(time, x + zero, v, a, current) for zero in (1e-5, 0.4 + 1e-5))
    theta, moved = model.vector(values), model.vector({**values, "mid_stroke": 0.4})
    force = model.force(theta, near)
    tolerance = {"rtol": 0, "atol": 1e-9 * np.abs(force).max()}
    np.testing.assert_allclose(model.force(moved, far), force, **tolerance)
    np.testing.assert_allclose(model.forces_of(np.stack([moved] * 3), far)[1], force, **tolerance)
    np.testing.assert_allclose(model.force(as_duals(moved), far).real, force, **tolerance)
    if model.linear.size:
        (columns, rest), *_ = model.regressors(moved[None], far)
        np.testing.assert_allclose(columns @ moved[model.linear] + rest, force, **tolerance)
    damper_force = model.force_of_damper(theta, near)
    behind, of_near = (
        model.motion_of_damper(parameters, path, damper_force) for parameters, path in ((moved, far), (theta, near))
    )
    np.testing.assert_allclose(behind[0] - 0.4, of_near[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", [model.id for model in MODELS.values() if "centre" in model.names])
def test_the_loop_of_strokes_aside_of_mid_stroke_has_its_own_centre(name):
    """The force of these models depends on where in the stroke the rod is, and the papers' strokes are about the zero."""
    model = find_model(name, scales=replace(REFERENCE, centre=0.007))
    assert model.defaults[model.names.index("centre")] == 0.007
    time, x, v, a, current = sine()
    near, aside = (make_path(time, x + place, v, a, current) for place in (1e-5, 0.007 + 1e-5))
    values = {"stiffness": 0.0} if "stiffness" in model.names else {}
    force, moved = find_model(name).force(find_model(name).vector(values), near), model.force(model.vector(values), aside)
    np.testing.assert_allclose(moved, force, rtol=0, atol=1e-9 * np.abs(force).max())


@BY_NAME
@seeds(10)
def test_block_by_block_equals_at_once(name, examples, seed):
    model = MODELS[name]
    rng = np.random.default_rng(seed)
    model, theta = damper(examples, rng, model)
    time, *series = examples.two_tones(**examples.motion(rng))
    steps = np.diff(time, prepend=time[0])
    whole = Path(steps, *series, np.arange(len(time)))
    at_once = model.force(theta, whole)
    size = int(rng.integers(1, 78))
    state = model.initial_state(whole)
    for first in range(0, len(time), size):
        part = slice(first, first + size)
        block = Path(steps[part], *(values[part] for values in series), np.arange(len(time[part])))
        # The last digits of a current law depend on the block.
        tolerance = 10 * TINY * np.max(np.abs(at_once))
        assert np.allclose(model.force(theta, block, state), at_once[part], rtol=0, atol=tolerance)


@EVERY
def test_laws_agree_where_they_are_the_same(model):
    """Affine is quadratic without the square, and exponential or tanh that saturate far away."""
    path = make_path(*sine(current=0.8))
    affine = model.with_laws("affine")
    known = values(affine, affine.defaults)
    expected = affine.force(affine.defaults, path)
    for law in ("quadratic", "exponential", "tanh"):
        other = model.with_laws(law)
        theta = np.array([known.get(name, 0.0 if name.endswith("_per_A2") else 1e7) for name in other.names])
        assert np.allclose(other.force(theta, path), expected, rtol=0, atol=1e-6 * np.max(np.abs(expected))), law


def test_damper_block_by_block():
    _, x, v, a, _ = sine(rate=8000.0)
    current = np.where(np.arange(len(x)) < 8000, 0.1, 0.6)
    damper = Damper("bouc_wen")
    blocks = [damper.advance(1 / 8000, *(s[k : k + 77] for s in (x, v, a, current))) for k in range(0, len(x), 77)]
    whole = Damper("bouc_wen").advance(1 / 8000, x, v, a, current)
    assert np.allclose(np.concatenate(blocks), whole, atol=1e-8)


WRITTEN_OUT = {
    "linear_viscous": lambda q, x, v, a: q["c"] * v + q["f0"],
    "bingham": lambda q, x, v, a: q["f_c"] * np.tanh(v / q["v_e"]) + q["c0"] * v + q["f0"],
    "biviscous": lambda q, x, v, a: (
        np.where(np.abs(v) < q["v_y"], (q["C_po"] + q["F_y"] / q["v_y"]) * v, q["C_po"] * v + q["F_y"] * np.sign(v))
        + q["f0"]
    ),
    "hyperbolic_tangent": lambda q, x, v, a: (
        q["alpha"] * np.tanh(q["beta"] * v + q["delta"] * np.sign(x)) + q["c"] * v + q["k"] * x + q["f0"]
    ),
    "algebraic": lambda q, x, v, a: q["f_I"] * np.tanh(q["a1"] * v + q["a2"] * x) + q["b1"] * v + q["b2"] * x + q["f0"],
}


@pytest.mark.parametrize("name", WRITTEN_OUT)
@seeds(10)
def test_force_is_the_equation(name, examples, seed):
    """The models without memory and peak speed, written out in the symbols of their equations."""
    rng = np.random.default_rng(seed)
    model, theta = damper(examples, rng, find_model(name))
    motion = examples.motion(rng)
    motion["later_current"] = motion["current"]
    time, x, v, a, current = examples.two_tones(**motion)
    found = model.at_current(theta, motion["current"])
    q = {coefficient.symbol: found[coefficient.name] for coefficient in model.coefficients}
    force = model.force(theta, make_path(time, x, v, a, current))
    assert np.allclose(force, WRITTEN_OUT[name](q, x, v, a), rtol=1e-9, atol=1e-9)


def test_hysteretic_biviscous_has_the_six_branches_of_wereley():
    model = find_model("hysteretic_biviscous")
    theta = model.vector({"yield_force": 500.0, "viscous": 1500.0, "yield_speed": 0.02, "loop_half_width": 0.008})
    found = {name: value for name, (value, _) in model.observables(model.at_current(theta, 0.0)).items()}
    f_y, before, after, v0 = found["yield force F_y"], found["C_pr"], found["C_po"], found["zero-force speed v0"]
    v1, v2 = (f_y - before * v0) / (before - after), (f_y + before * v0) / (before - after)
    time, x, v, a, _ = sine()
    rising = np.where(v <= -v1, after * v - f_y, np.where(v <= v2, before * (v - v0), after * v + f_y))
    falling = np.where(v <= -v2, after * v - f_y, np.where(v <= v1, before * (v + v0), after * v + f_y))
    force = model.force(theta, make_path(time, x, v, a, np.zeros(len(time))))
    expected = np.where(a > 0, rising, falling)
    assert np.allclose(force[a != 0], expected[a != 0])


def test_sigmoid_on_a_sine():
    """On a centred sine the peak speed is constant; the loop closes where x' = v_h, rising, and x' = -v_h, falling."""
    model = find_model("sigmoid")
    theta = model.vector({"loop_half_width": 0.1, "transition_growth": 0.0, "viscous_growth": 0.0, "coil_lag": 0.0})
    time, x, v, a, current = sine(current=0.0)
    force = model.force(theta, make_path(time, x, v, a, current))
    peak = 0.01 * 2 * np.pi * 1.5
    steepness = 250.0 / (1 + 2.0 * peak)
    assert np.allclose(force, 100.0 * np.tanh(0.5 * steepness * (v - 0.1 * peak * np.sign(a))), atol=1e-2)


def test_sigmoid_stays_finite_off_centre_and_under_noise():
    model = find_model("sigmoid")
    upper = np.array([parameter.upper for parameter in model.parameters])
    time, x, v, a, current = sine(amplitude=0.002)
    noise = np.random.default_rng(1).normal(size=len(a))
    for moved, accelerated in ((x + 0.02, a), (x + 0.02, a + 1e4 * noise)):
        assert np.isfinite(model.force(upper, make_path(time, moved, v, accelerated, current))).all()


def test_sigmoid_law_over_current_is_tanh():
    """S(I) = 1 + k / (1 + exp(-a (I + I_j))) - k / (1 + exp(-a I_j)) with I_j = 0, as the docs say."""
    current, k, a = np.linspace(0, 2, 21), 8.0, 3.0
    model = find_model("sigmoid")
    theta = model.vector(
        {"transition_force": 90.0, "transition_force_per_A": 90.0 * k * a / 4, "transition_force_saturation": 2 / a}
    )
    found = [model.at_current(theta, value)["transition_force"] for value in current]
    assert np.allclose(found, 90.0 * (1 + k / (1 + np.exp(-a * current)) - k / 2))


@given(st.floats(-12, 12), st.floats(0, 6))
def test_pressure_drop_is_the_largest_root(ratio, size):
    """Of p^3 - (a + 3 b) p^2 + 4 b^3 = 0, to the accuracy that the double root at a = 0 leaves."""
    b = 10.0**size
    a = b * 10.0**ratio
    p = pressure_drop(a, b)
    assert p >= max(a, 2 * b) * (1 - 1e-12)  # the smaller positive root is below 2 b
    scale = p**3 + (a + 3 * b) * p**2
    assert abs(p**3 - (a + 3 * b) * p**2 + 4 * b**3) <= 1e-14 * scale
    practical = a * (1 + 2.07 * b / a + b / (a + 0.4 * b))
    assert p == pytest.approx(practical, rel=0.05)


def test_pressure_drop_at_its_ends():
    assert pressure_drop(0.0, 5.0) == 10.0
    assert pressure_drop(5.0, 0.0) == 5.0
    assert pressure_drop(0.0, 0.0) == 0.0


def test_quasi_static_force_agrees_with_the_practical_form():
    model = find_model("quasi_static")
    theta = model.vector({"coil_lag": 0.0, "offset": 0.0})
    bore, rod, gap, length, eta, share = 0.036, 0.010, 0.0009, 0.017, 0.1, 0.32
    area, width = np.pi / 4 * ((bore - 2 * gap) ** 2 - rod**2), np.pi * (bore - gap)
    time, x, v, a, _ = sine(frequency=3.0)
    moving = np.abs(v) > 0.01
    for current in (0.1, 0.5, 1.0):
        force = model.force(theta, make_path(time, x, v, a, np.full(len(time), current)))
        flow, tau = area * np.abs(v), yield_stress(share, 1.2e5 * current)
        slope = 12 * eta * flow
        c = 2.07 + slope / (slope + 0.4 * width * gap**2 * tau)
        viscous = (1 + width * gap / (2 * area)) * slope * (length + 0.015) * area / (width * gap**3)
        practical = np.sign(v) * (viscous + c * tau * length * area / gap + 50.0)
        assert np.allclose(force[moving], practical[moving], rtol=0.03)
    assert np.max(force) == pytest.approx(1200, abs=100)


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
                dense,
                0.01 * np.sin(w * dense),
                0.01 * w * np.cos(w * dense),
                -0.01 * w**2 * np.sin(w * dense),
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


def test_modified_bouc_wen_converges_at_fourth_order():
    """Reversals between the samples included, at constant current."""
    model = find_model("modified_bouc_wen")

    def at(rate):
        return model.force(model.defaults, make_path(*sine(rate=rate)))[:: int(rate // 500)]

    exact = at(64000.0)
    errors = [np.sqrt(np.mean((at(rate) - exact)[50:] ** 2)) for rate in (500.0, 1000.0, 2000.0)]
    order = np.log2(errors[0] / errors[2]) / 2
    assert order > 3.5


@given(
    w=st.floats(-1, 1),
    travel=st.floats(-80, 80),
    e=st.floats(-1e-3, 1e-3),
    dt=st.floats(1e-4, 0.04),
    f_y=st.floats(0, 1500),
    sigma=st.floats(0.5, 1.5),
    n=st.sampled_from([1.0, 1.4, 2.0]),
    k0=st.floats(0, 1e4),
    viscous=st.floats(1e3, 7e5),
)
@example(w=1.0, travel=7.416728749572749, e=0.0, dt=0.04, f_y=150.0, sigma=0.6, n=1.4, k0=1e3, viscous=1.716e5)
def test_travel_of_the_element_is_found_however_long_the_step_is(w, travel, e, dt, f_y, sigma, n, k0, viscous):
    """Newton's method alone goes to and fro over the kink where the element reverses, and ends on the wrong force."""
    x_y = 4e-6
    whole, creep, pull = travel * x_y, f_y / viscous, k0 / viscous
    drive = whole / dt
    d, after = travel_of_element(w, e, dt, whole, drive, drive, creep, creep, pull, pull, x_y, sigma, n)
    assert after == pytest.approx(advance(w, d / x_y, sigma, n), abs=1e-6)
    # The travel is what the rod gives, less what creep and spring take at the mean of a state and an elongation on the way.
    mean = whole - dt * pull * (e + 0.5 * d) - d
    between = sorted((dt * creep * w, dt * creep * after))
    assert between[0] - 1e-6 * x_y <= mean <= between[1] + 1e-6 * x_y


def test_reversal_on_a_sample_adds_no_vertex():
    """Where rounding leaves a velocity of 1e-17 at a turning point: a vertex there would take no time."""
    time, x, v, a, current = sine(rate=100.0, frequency=0.25, seconds=8.0)
    assert 0 < np.min(np.abs(v[100::200])) < 1e-15
    path = make_path(time, x, v, a, current)
    assert np.all(path.dt[1:] > 0)


def test_a_path_goes_with_its_last_user():
    """A diagnosis draws hundreds of paths; those of long recordings, if they stayed, would fill the memory."""
    path = make_path(*sine())
    assert path.fine is path
    gone = weakref.ref(path)
    gc.disable()
    try:
        del path
        assert gone() is None
    finally:
        gc.enable()


def test_lagged_current_follows_an_exponential():
    time = np.arange(0, 0.05, 1e-3)
    current = np.where(time > 0, 1.0, 0.0)
    dt = np.diff(time, prepend=0.0)
    effective, prompt = np.empty((2, len(dt)))
    lagged_current(np.array([0.005]), np.zeros(2), dt, current, effective)
    lagged_current(np.array([0.0]), np.zeros(2), dt, current, prompt)
    # The step is a ramp over the first sample: its mean delay is half a sample.
    assert np.allclose(effective[5:], 1 - np.exp(-(time[5:] - 0.5e-3) / 0.005), atol=2e-3)
    assert np.allclose(prompt, current)


def test_wrong_names_and_values_are_one_line():
    with pytest.raises(InputError, match=r"unknown model bouc_wenn; did you mean bouc_wen\? \(known: linear"):
        find_model("bouc_wenn")
    with pytest.raises(InputError, match="unknown parameter alpha"):
        find_model("bouc_wen").vector({"alpha": 1.0})
    with pytest.raises(InputError, match=r"yield_force is -5 N, expected 0 to 2.5e"):
        find_model("bouc_wen").vector({"yield_force": -5.0})
    with pytest.raises(InputError, match=r"exponent is 0\.5, expected 1 to 5"):
        find_model("bouc_wen").vector({"exponent": 0.5})


def test_docs_are_those_of_the_catalogue():
    written = File(__file__).resolve().parents[3] / "docs" / "models.md"
    assert written.read_text(encoding="utf-8") == page(), f"the catalogue has changed; write the page anew: {COMMAND}"


def test_tool_shows_the_catalogue_and_each_model(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "200")

    def printed(*arguments):
        monkeypatch.setattr(sys, "argv", ["models", *arguments])
        tool.work()
        return capsys.readouterr().out

    listed = printed()
    assert all(model.id in listed and model.title in listed for model in MODELS.values())
    for model in MODELS.values():
        shown = printed(model.id)
        assert all(name in shown for name in model.names)
        assert printed(model.id, "--markdown") in page()
    assert printed("--markdown") == page()
    with pytest.raises(InputError, match="unknown model bouc"):
        printed("bouc")
