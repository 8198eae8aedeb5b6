"""Modified Bouc-Wen model of Spencer et al.: a Bouc-Wen element in series with a dashpot."""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.hysteresis import advance, slope
from mrd_sim.models.bouc_wen import observables
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import EXPONENT, OFFSET, SHAPE, YIELD_FORCE, YIELD_TRAVEL
from mrd_sim.root import settled


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before, y = state[0], state[1], state[2]
    if dt[0] == 0.0:
        before, y = x[0], x[0]
    for k in range(len(x)):
        f_y, x_y, sigma, n, c0, c1, k0 = q[k, 0], q[k, 1], q[k, 2], q[k, 3], q[k, 4], q[k, 5], q[k, 6]
        travel = x[k] - before
        if dt[k] > 0.0:
            step, w = _internal_step(w, travel, 0.5 * (x[k] + before) - y, dt[k], f_y, x_y, sigma, n, c0, c1, k0)
            y += step
        before = x[k]
        y_speed = (f_y * w + c0 * v[k] + k0 * (x[k] - y)) / (c0 + c1)
        force[k] = c1 * y_speed + q[k, 7] * x[k] + q[k, 8]
    state[0], state[1], state[2] = w, before, y


@njit(cache=True, nogil=True, forceinline=True)
def _internal_step(
    w: float,
    travel: float,
    middle: float,
    dt: float,
    f_y: float,
    x_y: float,
    sigma: float,
    n: float,
    c0: float,
    c1: float,
    k0: float,
) -> tuple[float, float]:
    """Displacement d of the internal node over one step, and the state after it.

    Balance of the node's velocity with the exact hysteresis over the travel left to the element:
    d (c0 + c1) = dt (F_y ((1 - theta) w + theta w+(travel - d)) + k0 (middle - d / 2)) + c0 travel. Its left minus right
    side grows strictly with d, so the root is unique; Newton's method, kept within a bracket, finds it at any speed.
    """
    scale = c0 + c1 + 0.5 * dt * k0
    per_scale, per_travel = 1.0 / scale, 1.0 / x_y
    whole = dt * f_y
    push = implicit_share(whole * per_travel * per_scale) * whole
    fixed = c0 * travel + dt * k0 * middle + (whole - push) * w
    d = (fixed + push * w) * per_scale
    # The state stays within ±1, which bounds the root.
    reach = push * per_scale
    low, high = (d - (1.0 + w) * reach).real, (d + (1.0 - w) * reach).real
    after = w
    last = high - low
    for _ in range(100):
        element = travel - d
        direction = 1.0 if element.real >= 0.0 else -1.0
        after = advance(w, element * per_travel, sigma, n)
        balance = scale * d - fixed - push * after
        if balance.real > 0.0:
            high = d.real
        else:
            low = d.real
        bend = slope(after, direction, sigma, n) * per_travel
        step = -balance / (scale + push * bend)
        # The error after a step of Newton's method is of the order of its square.
        if abs(step.real) <= 1e-7 * x_y.real or high - low <= 1e-13 * x_y.real:
            return d + step, after - bend * step
        d, last = settled(d, step, low, high, last)
    return d, after


@njit(cache=True, nogil=True)
def implicit_share(decay: Any) -> Any:
    """Weight theta of a step's end against its beginning, for a rate times a step.

    With (3 + z) / (6 + z) the step multiplies a decaying mode by the (1, 2) Padé approximant of exp(-z): of second order at
    least, and without the ringing of the trapezoidal rule, theta = 1/2, where the step is long.
    """
    return (3.0 + decay) / (6.0 + decay)


MODEL = DamperModel(
    id="modified_bouc_wen",
    title="Modified Bouc-Wen (Spencer)",
    equation="F = c1 y' + k1 x + f0, (c0 + c1) y' = F_y w + c0 x' + k0 (x - y), "
    "x_y w' = z' - sigma |z'| w |w|^(n-1) - (1 - sigma) z' |w|^n with z' = x' - y'",
    source="Spencer, Dyke, Sain & Carlson, J. Eng. Mech. 123 (1997) 230",
    quantities=(
        YIELD_FORCE,
        YIELD_TRAVEL,
        SHAPE,
        EXPONENT,
        Quantity("viscous", "c0", "N s/m", "viscous coefficient at high speed", 1500.0, 0.0, 2e4, (3000.0, 0.0, 2e4)),
        Quantity(
            "series_viscous",
            "c1",
            "N s/m",
            "dashpot in series, roll-off at low speed",
            3e4,
            1e3,
            3e5,
            (6e4, 0.0, 4e5),
            log=True,
        ),
        Quantity("stiffness", "k0", "N/m", "stiffness beside the element", 500.0, 0.0, 1e4),
        Quantity(
            "accumulator_stiffness",
            "k1",
            "N/m",
            "stiffness of the accumulator",
            1000.0,
            0.0,
            1e4,
            (0.0, -1e4, 1e4),
            multiplies="x",
            law="constant",
        ),
        replace(OFFSET, meaning="constant force (gas preload), -k1 x0"),
    ),
    kernel=_force,
    states=3,
    order=2,
    observables=observables,
)
