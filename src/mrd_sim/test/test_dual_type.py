"""Dual numbers: arithmetic in compiled code, and forces with the derivatives to all parameters in one pass."""

import math
import operator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from mrd_sim import dual
from mrd_sim.dual_type import LANES, along, as_duals, like
from mrd_sim.effects import EFFECTS
from mrd_sim.models import MODELS, find_model
from mrd_sim.path import make_path

NUMBERS = st.floats(-10.0, 10.0).filter(lambda value: abs(value) > 1e-3)
SLOPES = st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=2)


@njit
def _arithmetic(z, out):
    x, y = z[0], z[1]
    out[0], out[1], out[2], out[3] = x + y, x - y, x * y, x / y
    out[4], out[5], out[6], out[7] = 2.0 + y, 2 - y, 2.0 * y, 2.0 / y
    out[8], out[9], out[10], out[11] = y + 3, y - 3.0, y * 3.0, y / 3
    out[12], out[13], out[14] = -y, +y.real, x
    out[14] += y
    out[14] *= y


@given(NUMBERS, NUMBERS, SLOPES, SLOPES)
def test_arithmetic_follows_the_chain_rule(x, y, dx, dy):
    z, out = as_duals(np.array([x, y])), as_duals(np.zeros(15))
    z.derivatives[:, :2] = dx, dy
    _arithmetic(z, out)
    dx, dy = np.array(dx), np.array(dy)
    values = [x + y, x - y, x * y, x / y, 2 + y, 2 - y, 2 * y, 2 / y, y + 3, y - 3, y * 3, y / 3, -y, y, (x + y) * y]
    slopes = [dx + dy, dx - dy, x * dy + y * dx, dx / y - x / y**2 * dy, dy, -dy, 2 * dy, -2 / y**2 * dy, dy, dy, 3 * dy]
    slopes += [dy / 3, -dy, 0 * dy, (dx + dy) * y + (x + y) * dy]
    assert np.array_equal(out.real, values)
    assert np.allclose(out.derivatives[:, :2], slopes, rtol=1e-12, atol=1e-9)
    assert not out.derivatives[:, 2:].any()


@njit
def _same(z):
    return z[0] == 2.0, z[0] == z[1], z[0] != z[1]


def test_numbers_are_equal_only_with_equal_derivatives():
    z = as_duals(np.array([2.0, 2.0]))
    assert _same(z) == (True, True, False)
    z.derivatives[0, LANES - 1] = 1e-300
    assert _same(z) == (False, False, True)


@njit
def _functions(z, out):
    x = z[0]
    out[0], out[1], out[2], out[3], out[4] = dual.exp(x), dual.expm1(x), dual.log(x), dual.log1p(x), dual.sqrt(x)
    out[5], out[6], out[7], out[8], out[9] = dual.sin(x), dual.cos(x), dual.tan(x), dual.atan(x), dual.tanh(x)
    out[10], out[11], out[12] = dual.absolute(-x), dual.power(x, 1.5), dual.clip(x, 0.1, 0.5)


@given(st.floats(0.01, 1.5))
def test_elementary_functions(x):
    z, out = along(np.array([x]), np.array([3.0])), as_duals(np.zeros(13))
    _functions(z, out)
    plain, beside = np.zeros((2, 13))
    _functions(np.array([x]), plain)
    assert np.array_equal(out.real, plain)
    _functions(np.array([x + 1e-7]), beside)
    _functions(np.array([x - 1e-7]), plain)
    assert out.derivatives[:12, 0] == pytest.approx(3.0 * (beside - plain)[:12] / 2e-7, rel=1e-5, abs=1e-5)


def _path():
    w, u, time = 5.0, 41.0, np.arange(1400) / 500.0
    x = 8e-3 * np.sin(w * time) + 1e-3 * np.sin(u * time)
    v = 8e-3 * w * np.cos(w * time) + 1e-3 * u * np.cos(u * time)
    a = -8e-3 * w**2 * np.sin(w * time) - 1e-3 * u**2 * np.sin(u * time)
    path = make_path(time, x, v, a, 0.3 + 0.2 * np.sin(3.0 * time))
    return replace(path, temperature=300.0 + 10.0 * np.cumsum(path.dt))


CASES = [(name, ()) for name in MODELS] + [("bouc_wen", (effect,)) for effect in EFFECTS]
CASES += [("shear_thinning_bouc_wen", ("backlash", "joint_play")), ("sigmoid", ("bypass_flow", "channel_delay"))]


@pytest.mark.parametrize(("name", "effects"), CASES)
def test_one_pass_is_as_many_passes_of_one_column(name, effects):
    """More vertices than one block has; values are those without derivatives."""
    model = find_model(name, effects=effects)
    typical = {f"{effect.id}.{key}": value for effect in model.effects for key, value in effect.typical.items()}
    theta = model.vector(typical)
    path = _path()
    free = [place for place, parameter in enumerate(model.parameters) if parameter.free][:LANES]
    together = as_duals(theta)
    together.derivatives[free, np.arange(len(free))] = 1.0
    found = model.force(together, path)
    force = model.force(theta, path)
    assert np.allclose(found.real, force, rtol=1e-9, atol=1e-9 * np.abs(force).max())
    for lane, place in enumerate(free):
        alone = model.force(along(theta, np.arange(len(theta)) == place), path).derivatives[:, 0]
        assert np.allclose(found.derivatives[:, lane], alone, rtol=1e-9, atol=1e-9 * np.abs(alone).max()), place


def test_floats_stay_floats():
    theta = MODELS["bouc_wen"].defaults
    assert like(theta, theta) is theta
    assert math.isclose(operator.getitem(as_duals(theta).real, 0), theta[0])
