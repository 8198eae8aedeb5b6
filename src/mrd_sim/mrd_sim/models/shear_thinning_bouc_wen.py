"""Modified Bouc-Wen model of a fluid that thins with shear: viscous force by the law of Herschel and Bulkley."""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.dual import power
from mrd_sim.hysteresis import advance, slope
from mrd_sim.models.bouc_wen import observables
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.modified_bouc_wen import MODEL as MODIFIED
from mrd_sim.models.modified_bouc_wen import implicit_share
from mrd_sim.root import settled

REFERENCE_SPEED = 0.1
"""m/s; at this speed the viscous force is c0 times the speed, whatever the flow index."""
CREEP_SPEED = 1e-4
"""m/s; below it the power law gives way to a straight line, so that its slope stays finite."""


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before, y, speed = state[0], state[1], state[2], state[3]
    if dt[0] == 0.0:
        before, y = x[0], x[0]
    for k in range(len(x)):
        f_y, x_y, sigma, n, c0, m, c1, k0 = q[k, 0], q[k, 1], q[k, 2], q[k, 3], q[k, 4], q[k, 5], q[k, 6], q[k, 7]
        if dt[k] > 0.0:
            middle = 0.5 * (x[k] + before) - y
            step, w = _internal_step(w, x[k] - before, middle, dt[k], speed, f_y, x_y, sigma, n, c0, m, c1, k0)
            y += step
        before = x[k]
        inner = f_y * w + k0 * (x[k] - y)
        speed = _element_speed(c1 * v[k] - inner, c0, m, c1)
        force[k] = inner + _viscous(speed, c0, m) * speed + q[k, 8] * x[k] + q[k, 9]
    state[0], state[1], state[2], state[3] = w, before, y, speed


@njit(cache=True, nogil=True)
def _viscous(speed: Any, c0: Any, m: Any) -> Any:
    """Viscous force over speed in N s/m."""
    return c0 * power((speed * speed + CREEP_SPEED * CREEP_SPEED) / (REFERENCE_SPEED * REFERENCE_SPEED), 0.5 * (m - 1.0))


@njit(cache=True, nogil=True)
def _tangent(speed: Any, viscous: Any, m: Any) -> Any:
    """Slope in N s/m of the viscous force over speed; positive for m > 0."""
    square = speed * speed
    return viscous * (m * square + CREEP_SPEED * CREEP_SPEED) / (square + CREEP_SPEED * CREEP_SPEED)


@njit(cache=True, nogil=True)
def _element_speed(drive: Any, c0: Any, m: Any, c1: Any) -> Any:
    """Speed of the element, for which its viscous force and c1 times the speed balance ``drive``.

    Both grow with the speed, which so has the sign of ``drive`` and is at most drive / c1.
    """
    low, high = min(0.0, drive.real) / c1.real, max(0.0, drive.real) / c1.real
    speed = drive / (c1 + _viscous(drive / c1, c0, m))
    last = high - low
    for _ in range(100):
        viscous = _viscous(speed, c0, m)
        balance = (viscous + c1) * speed - drive
        if balance.real > 0.0:
            high = speed.real
        else:
            low = speed.real
        step = -balance / (_tangent(speed, viscous, m) + c1)
        if abs(step.real) <= 1e-13 * (high - low + abs(speed.real)) or high <= low:
            return speed + step
        speed, last = settled(speed, step, low, high, last)
    return speed


@njit(cache=True, nogil=True)
def _internal_step(
    w: Any,
    travel: Any,
    middle: Any,
    dt: float,
    speed: Any,
    f_y: Any,
    x_y: Any,
    sigma: Any,
    n: Any,
    c0: Any,
    m: Any,
    c1: Any,
    k0: Any,
) -> tuple[Any, Any]:
    """Displacement d of the internal node over one step, and the state after it, as in the modified Bouc-Wen model.

    The element moves by travel - d, which its viscous force resists: it pushes the node the way the element moves. So the
    balance c1 d - dt (F_y ((1 - theta) w + theta w+) + k0 (middle - d / 2) + F_v) grows strictly with d, and its sign where
    the element stands still, d = travel, tells on which side of it the root is.
    """
    scale = c1 + 0.5 * dt * k0
    viscous = _viscous(speed, c0, m)
    whole = dt * f_y
    push = implicit_share(whole / (x_y * (scale + viscous))) * whole
    fixed = dt * k0 * middle + (whole - push) * w
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
        after = advance(w, element / x_y, sigma, n)
        viscous = _viscous(element / dt, c0, m)
        balance = scale * d - fixed - push * after - viscous * element
        if balance.real > 0.0:
            high = d.real
        else:
            low = d.real
        bend = slope(after, direction, sigma, n) / x_y
        step = -balance / (scale + push * bend + _tangent(element / dt, viscous, m))
        if abs(step.real) <= 1e-7 * x_y.real or high - low <= 1e-13 * x_y.real:
            return d + step, after - bend * step
        d, last = settled(d, step, low, high, last)
    return d, after


FLOW_INDEX = Quantity("flow_index", "m", "", "exponent of the viscous force over speed; 1 does not thin", 0.7, 0.3, 1.0)

MODEL = DamperModel(
    id="shear_thinning_bouc_wen",
    title="Modified Bouc-Wen with shear thinning",
    equation="F = c1 y' + k1 x + f0 with c1 y' = F_y w + c0 z' |z' / v_r|^(m-1) + k0 (x - y), "
    "x_y w' = z' - sigma |z'| w |w|^(n-1) - (1 - sigma) z' |w|^n, z' = x' - y', v_r = 0.1 m/s",
    source="Spencer, Dyke, Sain & Carlson, J. Eng. Mech. 123 (1997) 230, with the law of Herschel & Bulkley (1926)",
    quantities=(
        *MODIFIED.quantities[:4],
        replace(MODIFIED.quantities[4], meaning="viscous force over speed at 0.1 m/s"),
        FLOW_INDEX,
        *MODIFIED.quantities[5:],
    ),
    kernel=_force,
    states=4,
    order=2,
    observables=observables,
)
