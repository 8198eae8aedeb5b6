"""Modified Bouc-Wen model of a fluid that thins with shear: its viscous force follows the law of Herschel and Bulkley."""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.dual import power
from mrd_sim.hysteresis import advance, slope
from mrd_sim.models import modified_bouc_wen
from mrd_sim.models.bouc_wen import observables
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.modified_bouc_wen import BRACKET_TOLERANCE, implicit_weight
from mrd_sim.named import Row, named_row, tuple_type
from mrd_sim.root import next_iterate

REFERENCE_SPEED = 0.1
"""m/s. At this speed the viscous force is c0 times the speed, whatever the flow index."""
CREEP_SPEED = 1e-4
"""m/s. Below it the power law gives way to a straight line, so that its slope stays finite."""
STATE_TOLERANCE = 1e-7
"""Share of the yield travel. Newton's last step leaves an error of the order of the square of it."""
SPEED_TOLERANCE = 1e-13
"""Share of the speed and of its bracket. Smaller steps are rounding."""

FLOW_INDEX = Coefficient("flow_index", "m", "", "exponent of the viscous force over speed; 1 does not thin", 0.7, 0.3, 1.0)


def _with_flow_index() -> tuple[Coefficient, ...]:
    """Return the coefficients of the modified Bouc-Wen model, the flow index after the viscous one."""
    viscous = next(c for c in modified_bouc_wen.COEFFICIENTS if c.name == "viscous")
    thinning = (replace(viscous, meaning="viscous force over speed at 0.1 m/s"), FLOW_INDEX)
    return tuple(item for c in modified_bouc_wen.COEFFICIENTS for item in (thinning if c is viscous else (c,)))


COEFFICIENTS = _with_flow_index()
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before, y, speed = state[0], state[1], state[2], state[3]
    if dt[0] == 0.0:
        before, y = x[0], x[0]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        if dt[k] > 0.0:
            middle = 0.5 * (x[k] + before) - y
            step, w = _internal_step(w, x[k] - before, middle, dt[k], speed, c)
            y += step
        before = x[k]
        inner = c.yield_force * w + c.stiffness * (x[k] - y)
        speed = _element_speed(c.series_viscous * v[k] - inner, c)
        force[k] = inner + _viscous(speed, c) * speed + c.accumulator_stiffness * x[k] + c.offset
    state[0], state[1], state[2], state[3] = w, before, y, speed


@njit(cache=True, nogil=True)
def _viscous(speed: Any, c: Row) -> Any:
    """Viscous force over speed in N s/m."""
    square = (speed * speed + CREEP_SPEED * CREEP_SPEED) / (REFERENCE_SPEED * REFERENCE_SPEED)
    return c.viscous * power(square, 0.5 * (c.flow_index - 1.0))


@njit(cache=True, nogil=True)
def _viscous_slope(speed: Any, viscous: Any, c: Row) -> Any:
    """Slope in N s/m of the viscous force over speed; positive for a positive flow index."""
    square = speed * speed
    return viscous * (c.flow_index * square + CREEP_SPEED * CREEP_SPEED) / (square + CREEP_SPEED * CREEP_SPEED)


@njit(cache=True, nogil=True)
def _element_speed(drive: Any, c: Row) -> Any:
    """Return the speed of the element at which its viscous force and c1 times the speed balance ``drive``.

    Both grow with the speed. So the speed has the sign of ``drive`` and is at most drive / c1.
    """
    c1 = c.series_viscous
    low, high = min(0.0, drive.real) / c1.real, max(0.0, drive.real) / c1.real
    speed = drive / (c1 + _viscous(drive / c1, c))
    last = high - low
    for _ in range(100):
        viscous = _viscous(speed, c)
        balance = (viscous + c1) * speed - drive
        if balance.real > 0.0:
            high = speed.real
        else:
            low = speed.real
        step = -balance / (_viscous_slope(speed, viscous, c) + c1)
        if abs(step.real) <= SPEED_TOLERANCE * (high - low + abs(speed.real)) or high <= low:
            return speed + step
        speed, last = next_iterate(speed, step, low, high, last)
    return speed


@njit(cache=True, nogil=True)
def _internal_step(w: Any, travel: Any, middle: Any, dt: float, speed: Any, c: Row) -> tuple[Any, Any]:
    """Return the displacement d of the internal node over one step, and the hysteretic state after it.

    The balance is that of the modified Bouc-Wen model with another viscous force. That force resists the element's
    motion travel - d: it pushes the node the way the element moves. So the balance
    c1 d - dt (F_y ((1 - theta) w + theta w+) + k0 (middle - d / 2) + F_v) grows strictly with d. Its sign where the element
    stands still, d = travel, tells on which side the root lies.
    """
    scale = c.series_viscous + 0.5 * dt * c.stiffness
    viscous = _viscous(speed, c)
    whole = dt * c.yield_force
    push = implicit_weight(whole / (c.yield_travel * (scale + viscous))) * whole
    fixed = dt * c.stiffness * middle + (whole - push) * w
    if (scale * travel - fixed - push * w).real > 0.0:
        low, high = (fixed - push).real / scale.real, travel.real
    else:
        low, high = travel.real, (fixed + push).real / scale.real
    d = (fixed + push * w + viscous * travel) / (scale + viscous)
    if not low <= d.real <= high:
        d = 0.5 * (low + high) + 0.0 * d
    after = w
    last = high - low
    for _ in range(100):
        element = travel - d
        direction = 1.0 if element.real >= 0.0 else -1.0
        after = advance(w, element / c.yield_travel, c.shape, c.exponent)
        viscous = _viscous(element / dt, c)
        balance = scale * d - fixed - push * after - viscous * element
        if balance.real > 0.0:
            high = d.real
        else:
            low = d.real
        bend = slope(after, direction, c.shape, c.exponent) / c.yield_travel
        step = -balance / (scale + push * bend + _viscous_slope(element / dt, viscous, c))
        x_y = c.yield_travel.real
        if abs(step.real) <= STATE_TOLERANCE * x_y or high - low <= BRACKET_TOLERANCE * x_y:
            return d + step, after - bend * step
        d, last = next_iterate(d, step, low, high, last)
    return d, after


MODEL = DamperModel(
    id="shear_thinning_bouc_wen",
    title="Modified Bouc-Wen with shear thinning",
    equation="F = c1 y' + k1 x + f0 with c1 y' = F_y w + c0 z' |z' / v_r|^(m-1) + k0 (x - y), "
    "x_y w' = z' - sigma |z'| w |w|^(n-1) - (1 - sigma) z' |w|^n, z' = x' - y', v_r = 0.1 m/s",
    source="Spencer, Dyke, Sain & Carlson, J. Eng. Mech. 123 (1997) 230, with the law of Herschel & Bulkley (1926)",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=4,
    order=2,
    observables=observables,
)
