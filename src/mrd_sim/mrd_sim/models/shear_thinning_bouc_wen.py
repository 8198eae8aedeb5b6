"""Modified Bouc-Wen model of a fluid that thins with shear: its viscous force follows the law of Herschel and Bulkley.

The speed u of the element, of elongation e = x - y, balances the forces at the inner node: S(u) = D with
S(u) = c1 u + F_v(u) and the drive D = c1 v - F_y w - k0 e. S grows with u, which so has the sign of D. The speed at the end
of a step is the one unknown; the element's travel d, the integral of u over the step, is a function of it, and the state w a
known function of d.

S bends sharply about u = 0, but D changes almost linearly with time. Along a linear drive, the mean speed is the mean of
the inverse of S between D0 and D1, u1 - L with L = (integral of S - S0 from u0 to u1) / (D1 - D0). What the drive bends
meanwhile follows from the rod's travel and from the stiffness kappa = dD/de at both ends, by the corrected trapezoidal rule.
This is of fourth order in the motion and of second order in changes of the current. A step in which the element reverses is
divided there. Where a step is longer than the time in which the element relaxes, or than its yield travel, it gives way to
a rule that weighs the end of the step.
"""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.dual import absolute, at_least, clip, power
from mrd_sim.hysteresis import advance, slope
from mrd_sim.models import modified_bouc_wen
from mrd_sim.models.bouc_wen import observables
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.modified_bouc_wen import SATURATED
from mrd_sim.named import Row, named_row, tuple_type
from mrd_sim.root import next_iterate

CREEP = 1e-3
"""Share of the reference speed. Below it the power law gives way to a straight line, so that its slope stays finite."""
TOLERANCE = 2e-5
"""Share of the speed and of the yield travel. Newton's last step leaves an error of its square."""
LONG = 3.0
"""Yield travels, or relaxation times of the element, within which the travel of a step is of fourth order."""
ALMOST_STEADY = 1e-3
"""Change of speed, relative to it or to that of `CREEP`, below which the mean speed is that of both ends; the exact
difference would be rounding. Slower elements are not followed through a reversal either. Where nearly nothing moves,
derivatives would enlarge both errors without limit."""
MOST_CORRECTED = 0.5
"""Largest correction, as a share of the travel with a linear drive. A speed that rises from zero with the cube of time needs
this much. With more, as beside a compliance that jumps, the element would move against its speed at both ends, and a step
would have two solutions. It may be larger where the rod's speeds at both ends leave out more than half of its travel."""
RENEWALS = 3
"""Attempts to solve a step after which the corrections of its travel stay, so that the search ends."""

FLOW_INDEX = Coefficient("flow_index", "m", "", "exponent of the viscous force over speed; 1 does not thin", 0.7, 0.3, 1.0)
REFERENCE_SPEED = Coefficient(
    "reference_speed",
    "v_r",
    "m/s",
    "speed at which the viscous force is c0 times the speed, whatever the flow index",
    0.1,
    0.1,
    0.1,
    free=False,
)


def _with_flow_index() -> tuple[Coefficient, ...]:
    """Return the coefficients of the modified Bouc-Wen model, flow index and reference speed after the viscous one."""
    viscous = next(c for c in modified_bouc_wen.COEFFICIENTS if c.name == "viscous")
    thinning = (replace(viscous, meaning="viscous force over speed at the reference speed"), FLOW_INDEX, REFERENCE_SPEED)
    return tuple(item for c in modified_bouc_wen.COEFFICIENTS for item in (thinning if c is viscous else (c,)))


COEFFICIENTS = _with_flow_index()
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, e, u, thinning, bend = state[0], state[1], state[2], state[3], state[4]
    x_before, v_before, yield_travel = state[5], state[6], state[7]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        if dt[k] == 0.0:  # a new path: the speed of the element follows from the forces alone
            e, u, bend = 0.0 * e, 0.0 * u, 0.0 * bend
            thinning = _thinning(u, c)
            x_before, v_before, yield_travel = x[k], v[k], c.yield_travel
        travel, per_yield = x[k] - x_before, 2.0 / (yield_travel + c.yield_travel)
        d, w_now, u_now, thinning_now, bend_now = _step(w, e, u, thinning, bend, dt[k], travel, v_before, v[k], per_yield, c)
        least = ALMOST_STEADY * CREEP * c.reference_speed.real
        if u.real * u_now.real < 0.0 and max(abs(u.real), abs(u_now.real)) > least:
            drive = (c.series_viscous + c.viscous * thinning) * u
            part = drive / (drive - (c.series_viscous + c.viscous * thinning_now) * u_now)
            d, w_now, u_now, thinning_now, bend_now = _step_with_reversal(
                part, w, e, u, thinning, bend, dt[k], travel, v_before, v[k], per_yield, c
            )
        w, u, thinning, bend = w_now, u_now, thinning_now, bend_now
        e += d
        x_before, v_before, yield_travel = x[k], v[k], c.yield_travel
        viscous = c.viscous * thinning * u
        force[k] = c.yield_force * w + c.stiffness * e + viscous + c.accumulator_stiffness * x[k] + c.offset
    state[0], state[1], state[2], state[3], state[4] = w, e, u, thinning, bend
    state[5], state[6], state[7] = x_before, v_before, yield_travel


@njit(cache=True, nogil=True)
def _thinning(u: Any, c: Row) -> Any:
    """Viscous force over c0 times the speed."""
    relative = u / c.reference_speed
    return power(relative * relative + CREEP * CREEP, 0.5 * (c.flow_index - 1.0))


@njit(cache=True, nogil=True, fastmath={"contract"})
def _step_with_reversal(
    part: Any,
    w: Any,
    e: Any,
    u: Any,
    thinning: Any,
    bend: Any,
    dt: Any,
    travel: Any,
    v: Any,
    v_now: Any,
    per_yield: Any,
    c: Row,
) -> tuple[Any, Any, Any, Any, Any]:
    """Return the same as `_step` of a step in which the element reverses after a ``part`` of the time.

    The rod moves along the cubic with the given ``travel`` and speeds at both ends of the step. An error in the instant of
    the reversal only counts by its square, as the element's speed is zero there.
    """
    left = 1.0 - part
    way = part * part * (3.0 - 2.0 * part) * travel + part * left * dt * (left * v - part * v_now)
    v_turn = 6.0 * part * left * travel / dt + left * (1.0 - 3.0 * part) * v + part * (3.0 * part - 2.0) * v_now
    total = 0.0 * e
    for i in range(2):  # one call in the code, because the compiler copies what is called
        if i == 1:
            part, way, v, v_turn = left, travel - way, v_turn, v_now
        d, w, u, thinning, bend = _step(w, e + total, u, thinning, bend, part * dt, way, v, v_turn, per_yield, c)
        total += d
    return total, w, u, thinning, bend


@njit(cache=True, nogil=True, fastmath={"contract"})
def _step(
    w: Any, e: Any, u: Any, thinning: Any, bend: Any, dt: Any, travel: Any, v: Any, v_now: Any, per_yield: Any, c: Row
) -> tuple[Any, Any, Any, Any, Any]:
    """Return the travel of the element over one step without reversal, and its w, u, thinning and bend afterwards.

    With the ``implicit`` share of the speed at the step's end, the step multiplies a mode that decays by exp(-z) by
    (6 - z)^2 / (36 + 24 z + 7 z^2 + z^3). This is of fourth order, and never negative, so that long steps do not ring.

    Parameters
    ----------
    w, e, u, thinning, bend : float
        Before the step: state, elongation in m, speed in m/s, `_thinning`, and slope of the state over the elongation in
        units of the yield travel.
    dt : float
        s.
    travel : float
        Travel of the rod in m.
    v, v_now : float
        Speeds of the rod in m/s before and after the step.
    per_yield : float
        Inverse of the yield travel during the step, in 1/m.
    """
    steepest = c.yield_force * per_yield
    creep_speed = CREEP * c.reference_speed
    creep, less = creep_speed * creep_speed, c.flow_index - 1.0
    energy = c.viscous / (c.flow_index + 1.0)
    drive = (c.series_viscous + c.viscous * thinning) * u
    integral = 0.5 * c.series_viscous * u * u + energy * thinning * (u * u + creep)
    unbalanced = drive + c.yield_force * w + c.stiffness * e - c.series_viscous * v_now
    change, d, share = _first_guess(unbalanced, w, u, thinning, bend, dt, per_yield, c)
    u_now = u + change
    after, bend_now, thinning_now = w, bend, thinning
    implicit, correction = 0.0 * u, 0.0 * u
    low, high, last = 0.0, 0.0, 0.0
    excess = travel - 0.5 * dt * (v + v_now)
    always_corrected = ALMOST_STEADY * creep_speed * dt + at_least(0.0, 2.0 * absolute(excess) - absolute(travel))
    for attempt in range(100):
        thinning_now = _thinning(u_now, c)
        square = u_now * u_now + creep
        thinning_slope = thinning_now * less * u_now / square
        resistance = c.series_viscous + c.viscous * (thinning_now + thinning_slope * u_now)
        change = u_now - u
        rise = (c.series_viscous + c.viscous * thinning_now) * u_now - drive
        # S rises at least as steeply as c1 u, which a state that was moved along its derivatives may contradict.
        rises = change.real * rise.real > c.series_viscous.real * change.real * change.real
        if rises and abs(change.real) > ALMOST_STEADY * max(abs(u_now.real), creep_speed.real):
            per_rise = 1.0 / rise
            mobility = change * per_rise
            area = 0.5 * c.series_viscous * (u_now * u_now) + energy * thinning_now * square - integral - drive * change
            lag = area * per_rise  # the mean speed along a linear drive is u_now - lag
            lag_slope = 1.0 - resistance * lag * per_rise
        else:
            mobility, lag, lag_slope = 1.0 / resistance, 0.5 * change, 0.5 + 0.0 * u
        if attempt >= RENEWALS:
            linear = dt * (u_now - (1.0 - implicit) * lag)
            most = MOST_CORRECTED * absolute(linear) + always_corrected
            d = linear + clip(correction, -most, most)
        direction = 1.0 if d.real >= 0.0 else -1.0
        if direction * w.real >= 1.0:
            after, bend_now = w, 0.0 * bend
        else:
            after = advance(w, d * per_yield, c.shape, c.exponent)
            bend_now = slope(after, direction, c.shape, c.exponent)
        if attempt < RENEWALS:
            stiffness = c.stiffness + steepest * bend_now
            decay = dt * mobility * (share * stiffness + (1.0 - share) * steepest)
            implicit = decay * (6.0 + decay)
            implicit = implicit / (36.0 + implicit)
            softening = steepest * (bend - bend_now) * u
            correction = mobility * (c.series_viscous * excess - share * dt * dt * (1.0 / 12.0) * softening)
        # Newton's method for speed and travel together: so far, d is a guess of the travel that belongs to u_now.
        linear = dt * (u_now - (1.0 - implicit) * lag)
        d_slope = dt * (1.0 - (1.0 - implicit) * lag_slope)
        most = MOST_CORRECTED * absolute(linear) + always_corrected
        if abs(correction.real) > most.real:
            d_slope = d_slope * (1.0 + (MOST_CORRECTED if correction.real * linear.real > 0.0 else -MOST_CORRECTED))
        missing = linear + clip(correction, -most, most) - d
        d = d + missing
        after = after + bend_now * missing * per_yield
        balance = rise + c.yield_force * (after - w) + c.stiffness * d + unbalanced
        step = -balance / (resistance + (c.stiffness + steepest * bend_now) * d_slope)
        d_step = d_slope * step
        in_yields = bend_now.real * (abs(missing.real) + abs(d_step.real)) * per_yield.real
        if abs(step.real) <= TOLERANCE * (abs(u_now.real) + creep_speed.real) and in_yields <= TOLERANCE:
            after = after + bend_now * d_step * per_yield
            if direction * after.real > 1.0 - SATURATED:
                after = direction + 0.0 * after
            return d + d_step, after, u_now + step, thinning_now + thinning_slope * step, bend_now
        if attempt < RENEWALS - 1:
            u_now, d = u_now + step, d + d_step
            continue
        if attempt == RENEWALS - 1:
            # The state stays within +-1 and the mean speed between those at both ends, which bounds the root.
            held = c.stiffness.real * (abs(e.real) + abs((dt * u).real) + abs(correction.real))
            width = (c.yield_force.real + held) / c.series_viscous.real
            low, high = min(0.0, v_now.real - width), max(0.0, v_now.real + width)
            last = high - low
        elif balance.real > 0.0:
            high = u_now.real
        else:
            low = u_now.real
        u_now, last = next_iterate(u_now, step, low, high, last)
    return d, after, u_now, thinning_now, bend_now


@njit(cache=True, nogil=True, fastmath={"contract"})
def _first_guess(
    unbalanced: Any, w: Any, u: Any, thinning: Any, bend: Any, dt: Any, per_yield: Any, c: Row
) -> tuple[Any, Any, Any]:
    """Return the change of the element's speed over a step, its travel, and the share of the rule of fourth order.

    ``unbalanced`` is the force in N by which the step begins out of balance; the other arguments are as of `_step`. The
    viscous force and the state are taken by two terms of their Taylor series.
    """
    less = c.flow_index - 1.0
    creep_speed = CREEP * c.reference_speed
    per_square = 1.0 / (u * u + creep_speed * creep_speed)
    fast = u * u * per_square
    viscous = c.viscous * thinning
    curvature = viscous * less * u * per_square * (3.0 + (less - 2.0) * fast)
    d = dt * u
    steepest = c.yield_force * per_yield
    stiffness = c.stiffness + steepest * bend
    softening = c.exponent * (bend - 1.0) * w / (w * w + SATURATED) * steepest * bend * per_yield * d
    mobility = 1.0 / (c.series_viscous + viscous * (1.0 + less * fast) + 0.5 * dt * (stiffness + softening))
    change = -(unbalanced + d * (stiffness + 0.5 * softening)) * mobility
    change -= 0.5 * curvature * mobility * change * change
    relaxed = dt * mobility * (1.0 / 12.0) * ((stiffness + softening) * change + softening * u)
    lengths = (dt * dt * (1.0 / (LONG * LONG))) * (steepest * steepest * mobility * mobility + u * u * per_yield * per_yield)
    return change, d + dt * (0.5 * change + relaxed), 1.0 / (1.0 + lengths * lengths)


MODEL = DamperModel(
    id="shear_thinning_bouc_wen",
    title="Modified Bouc-Wen with shear thinning",
    equation="F = c1 y' + k1 x + f0 with c1 y' = F_y w + c0 z' |z' / v_r|^(m-1) + k0 (x - y), "
    "x_y w' = z' - sigma |z'| w |w|^(n-1) - (1 - sigma) z' |w|^n, z' = x' - y'",
    source="Spencer, Dyke, Sain & Carlson, J. Eng. Mech. 123 (1997) 230, with the law of Herschel & Bulkley (1926)",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=8,
    order=4,
    observables=observables,
)
