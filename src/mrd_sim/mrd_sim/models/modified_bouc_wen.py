"""Modified Bouc-Wen model of Spencer et al.: a Bouc-Wen element in series with a dashpot."""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.hysteresis import advance, slope
from mrd_sim.models.bouc_wen import observables
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import EXPONENT, OFFSET, SHAPE, STIFFNESS, YIELD_FORCE, YIELD_TRAVEL
from mrd_sim.named import Row, named_row, tuple_type
from mrd_sim.root import next_iterate

STATE_TOLERANCE = 1e-7
"""Share of the yield travel. Newton's last step leaves an error of the order of the square of it."""
BRACKET_TOLERANCE = 1e-13
"""Share of the yield travel. A bracket as narrow as this is as narrow as rounding lets it become."""

COEFFICIENTS = (
    YIELD_FORCE,
    YIELD_TRAVEL,
    SHAPE,
    EXPONENT,
    Coefficient("viscous", "c0", "N s/m", "viscous coefficient at high speed", 1500.0, 0.0, 2e4, (3000.0, 0.0, 2e4)),
    Coefficient(
        "series_viscous", "c1", "N s/m", "dashpot in series, roll-off at low speed", 3e4, 1e3, 3e5, (6e4, 0.0, 4e5), log=True
    ),
    Coefficient("stiffness", "k0", "N/m", "stiffness in parallel with the element", 500.0, 0.0, 1e4),
    replace(STIFFNESS, name="accumulator_stiffness", symbol="k1", meaning="stiffness of the accumulator", default=1000.0),
    replace(OFFSET, meaning="constant force (gas preload), -k1 x0"),
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before, y = state[0], state[1], state[2]
    if dt[0] == 0.0:
        before, y = x[0], x[0]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        travel = x[k] - before
        if dt[k] > 0.0:
            step, w = internal_step(w, travel, 0.5 * (x[k] + before) - y, dt[k], c)
            y += step
        before = x[k]
        y_speed = (c.yield_force * w + c.viscous * v[k] + c.stiffness * (x[k] - y)) / (c.viscous + c.series_viscous)
        force[k] = c.series_viscous * y_speed + c.accumulator_stiffness * x[k] + c.offset
    state[0], state[1], state[2] = w, before, y


@njit(cache=True, nogil=True, forceinline=True)
def internal_step(w: float, travel: float, middle: float, dt: float, c: Row) -> tuple[float, float]:
    """Return the displacement d of the internal node over one step, and the hysteretic state after it.

    ``w`` is the state before, ``travel`` the rod's displacement, ``middle`` the distance of the middle of the rod's path
    from the node, ``dt`` the step in s and ``c`` the model's `Coefficients`.

    The node's velocity is balanced with the exact hysteresis over the travel that is left to the element:
    d (c0 + c1) = dt (F_y ((1 - theta) w + theta w+(travel - d)) + k0 (middle - d / 2)) + c0 travel. The left side minus the
    right side grows strictly with d, so there is one root. Newton's method, kept within a bracket, finds it at any speed.
    """
    scale = c.viscous + c.series_viscous + 0.5 * dt * c.stiffness
    per_scale, per_travel = 1.0 / scale, 1.0 / c.yield_travel
    whole = dt * c.yield_force
    push = implicit_weight(whole * per_travel * per_scale) * whole
    fixed = c.viscous * travel + dt * c.stiffness * middle + (whole - push) * w
    d = (fixed + push * w) * per_scale
    # The state stays within ±1, which bounds the root.
    reach = push * per_scale
    low, high = (d - (1.0 + w) * reach).real, (d + (1.0 - w) * reach).real
    after = w
    last = high - low
    for _ in range(100):
        element = travel - d
        direction = 1.0 if element.real >= 0.0 else -1.0
        after = advance(w, element * per_travel, c.shape, c.exponent)
        balance = scale * d - fixed - push * after
        if balance.real > 0.0:
            high = d.real
        else:
            low = d.real
        bend = slope(after, direction, c.shape, c.exponent) * per_travel
        step = -balance / (scale + push * bend)
        x_y = c.yield_travel.real
        if abs(step.real) <= STATE_TOLERANCE * x_y or high - low <= BRACKET_TOLERANCE * x_y:
            return d + step, after - bend * step
        d, last = next_iterate(d, step, low, high, last)
    return d, after


@njit(cache=True, nogil=True)
def implicit_weight(decay: Any) -> Any:
    """Return the weight theta of a step's end against its beginning, for the rate of a decay times the step.

    With (3 + z) / (6 + z) the step multiplies a decaying mode by the (1, 2) Padé approximant of exp(-z). It is of second
    order at least. The trapezoidal rule, theta = 1/2, would ring where the step is long.
    """
    return (3.0 + decay) / (6.0 + decay)


MODEL = DamperModel(
    id="modified_bouc_wen",
    title="Modified Bouc-Wen (Spencer)",
    equation="F = c1 y' + k1 x + f0, (c0 + c1) y' = F_y w + c0 x' + k0 (x - y), "
    "x_y w' = z' - sigma |z'| w |w|^(n-1) - (1 - sigma) z' |w|^n with z' = x' - y'",
    source="Spencer, Dyke, Sain & Carlson, J. Eng. Mech. 123 (1997) 230",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=3,
    order=2,
    observables=observables,
)
