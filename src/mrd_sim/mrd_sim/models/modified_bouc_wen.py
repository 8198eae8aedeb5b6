"""Modified Bouc-Wen model of Spencer et al.: a Bouc-Wen element in series with a dashpot.

The elongation e = x - y of the element obeys e' = r x' - s w - q e with r = c1 / (c0 + c1), s = F_y / (c0 + c1) and q = k0 /
(c0 + c1), and its hysteretic state w is a known function of e between two reversals of the element. So a step over dt has
one unknown, the element's travel d = r x' dt - s dt mean(w) - q dt mean(e). The mean of w over time follows from its values
at half the travel and at its end, by Simpson's rule, and from how much the speed changes meanwhile; where the element
reverses within the step, the step is divided there. This is of fourth order in the motion and of second order in changes of
the current. Where the step is longer than the time in which the element relaxes, x_y / s, it gives way to a rule that
weighs the end of the step. Either way the right side falls with d: there is one root, at any speed and any step.
"""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.dual import absolute, clip
from mrd_sim.hysteresis import advance_twice, slope
from mrd_sim.models.bouc_wen import observables
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import EXPONENT, OFFSET, SHAPE, STIFFNESS, YIELD_FORCE, YIELD_TRAVEL
from mrd_sim.named import named_row, tuple_type
from mrd_sim.root import next_iterate

BRACKET_TOLERANCE = 1e-13
"""Share of the yield travel. A bracket as narrow as this is as narrow as rounding lets it become."""
TRAVEL_TOLERANCE = 3e-5
"""Share of the yield travel. Newton's last step leaves an error of its square in the state, and less in the travel."""
NEARLY_SATURATED = 1e-3
"""Distance of the state from saturation below which the first guess of the travel is good enough."""
SATURATED = 1e-9
"""Distance of the state from saturation that is none."""
STIFF = 6.0
"""Relaxation times of the element: a step as long as this only weighs its end."""

COEFFICIENTS = (
    YIELD_FORCE,
    YIELD_TRAVEL,
    SHAPE,
    EXPONENT,
    Coefficient("viscous", "c0", "N s/m", "viscous coefficient at high speed", 1500.0, 0.0, 2e4, (3000.0, 0.0, 2e4)),
    Coefficient(
        "series_viscous", "c1", "N s/m", "dashpot in series, roll-off at low speed", 3e4, 3e2, 6e5, (6e4, 0.0, 8e5), log=True
    ),
    Coefficient("stiffness", "k0", "N/m", "stiffness in parallel with the element", 500.0, 0.0, 1e4),
    replace(STIFFNESS, name="accumulator_stiffness", symbol="k1", meaning="stiffness of the accumulator", default=1000.0),
    replace(OFFSET, meaning="constant force (gas preload), -k1 x0"),
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before, y = state[0], state[1], state[2]
    share, drive, creep, pull, x_y = state[3], state[4], state[5], state[6], state[7]
    if dt[0] == 0.0:
        before, y = x[0], x[0]
    e = before - y
    speed = drive - creep * w - pull * e
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        per_viscous = 1.0 / (c.viscous + c.series_viscous)
        share_now = c.series_viscous * per_viscous
        drive_now, creep_now, pull_now = share_now * v[k], c.yield_force * per_viscous, c.stiffness * per_viscous
        if dt[k] > 0.0:
            whole = 0.5 * (share + share_now) * (x[k] - before)
            middle = 0.5 * (x_y + c.yield_travel)
            d, after = travel_of_element(
                w, e, dt[k], whole, drive, drive_now, creep, creep_now, pull, pull_now, middle, c.shape, c.exponent
            )
            speed_now = drive_now - creep_now * after - pull_now * (e + d)
            if speed.real * speed_now.real < 0.0:
                part = speed / (speed - speed_now)
                d, after = _travel_with_reversal(
                    part, w, e, dt[k], whole, drive, drive_now, creep, creep_now, pull, pull_now, middle, c.shape, c.exponent
                )
            w = after
            e += d
        else:
            e += x[k] - before
        before, share, drive, creep, pull, x_y = x[k], share_now, drive_now, creep_now, pull_now, c.yield_travel
        speed = drive - creep * w - pull * e
        force[k] = c.series_viscous * (v[k] - speed) + c.accumulator_stiffness * x[k] + c.offset
    state[0], state[1], state[2] = w, before, before - e
    state[3], state[4], state[5], state[6], state[7] = share, drive, creep, pull, x_y


@njit(cache=True, nogil=True, fastmath={"contract"})
def travel_of_element(
    w: Any,
    e: Any,
    dt: Any,
    whole: Any,
    drive: Any,
    drive_now: Any,
    creep: Any,
    creep_now: Any,
    pull: Any,
    pull_now: Any,
    x_y: Any,
    sigma: Any,
    n: Any,
) -> tuple[Any, Any]:
    """Return the travel of the element over one step without reversal, and its state afterwards.

    Parameters
    ----------
    w, e : float
        State and elongation in m before the step.
    dt : float
        s.
    whole : float
        Travel in m that the element would have without resistance.
    drive, drive_now : float
        Speed in m/s that it would have without resistance, before and after the step; likewise the next two pairs.
    creep, creep_now : float
        F_y / (c0 + c1) in m/s.
    pull, pull_now : float
        k0 / (c0 + c1) in 1/s.
    x_y, sigma, n : float
        Coefficients of the hysteresis during the step.
    """
    twelfth = dt * (1.0 / 12.0)
    held = 0.5 * dt * (pull + pull_now)
    per_scale = 1.0 / (1.0 + 0.5 * held)
    held_share = held * per_scale
    change = (creep_now - creep) * twelfth
    bent = (drive_now - drive) * twelfth - change * w
    creeping = 0.5 * dt * (creep + creep_now) * per_scale
    d = (whole * per_scale + held_share * bent) - creeping * w - held_share * e
    if abs(w.real) < 1.0 or not w.real * d.real > 0.0:
        d, w = _solved_travel(w, d, creeping, held_share, bent, change * per_scale, x_y, sigma, n)
    return d, w


@njit(cache=True, nogil=True, fastmath={"contract"})
def _travel_with_reversal(
    part: Any,
    w: Any,
    e: Any,
    dt: Any,
    whole: Any,
    drive: Any,
    drive_now: Any,
    creep: Any,
    creep_now: Any,
    pull: Any,
    pull_now: Any,
    x_y: Any,
    sigma: Any,
    n: Any,
) -> tuple[Any, Any]:
    """Return the same of a step in which the element reverses after a ``part`` of the time.

    The travel without resistance up to there is that of the cubic with the given speeds at both ends of the step. An error
    in the instant of the reversal only counts by its square, as the element's speed is zero there.
    """
    left = 1.0 - part
    first = part * part * (3.0 - 2.0 * part) * whole + part * left * dt * (left * drive - part * drive_now)
    drive_turn = 6.0 * part * left * whole / dt + left * (1.0 - 3.0 * part) * drive + part * (3.0 * part - 2.0) * drive_now
    creep_turn, pull_turn = left * creep + part * creep_now, left * pull + part * pull_now
    total = 0.0 * e
    for i in range(2):  # one call in the code, because the compiler copies what is called
        if i == 1:
            part, first = left, whole - first
            drive, creep, pull = drive_turn, creep_turn, pull_turn
            drive_turn, creep_turn, pull_turn = drive_now, creep_now, pull_now
        d, w = travel_of_element(
            w, e + total, part * dt, first, drive, drive_turn, creep, creep_turn, pull, pull_turn, x_y, sigma, n
        )
        total += d
    return total, w


@njit(cache=True, nogil=True, fastmath={"contract"})
def _solved_travel(
    w: Any, d: Any, creeping: Any, held: Any, bent: Any, change: Any, x_y: Any, sigma: Any, n: Any
) -> tuple[Any, Any]:
    """Return the travel d + creeping (w - mean w) of the element and the state after it.

    ``d`` is the travel in m if the state stayed, ``bent`` a twelfth of the step times the change of the element's speed
    meanwhile, ``change`` a twelfth of the step times the change of F_y / (c0 + c1).

    Over time, the mean state is that over the travel, less a twelfth of the step times the change of speed times the slope
    of the state, dw/de. The slope is taken in the middle of a first guess of the travel.
    """
    per_travel = 1.0 / x_y
    d, creeping, bent, change = d * per_travel, creeping * per_travel, bent * per_travel, change * per_travel
    free = d + creeping * w
    # A guess by two terms of the state's Taylor series, of which the first is weighed as in `implicit_weight`.
    direction = 1.0 if d.real >= 0.0 else -1.0
    loading = direction * w.real >= 0.0
    stiffness = creeping * slope(w, direction, sigma, n)
    per_stiffness = (6.0 + stiffness) / (6.0 + stiffness * (4.0 + stiffness))
    d = d * per_stiffness
    limit = absolute(d) * (1.0 / 3.0)  # more would be a reversal
    bent = clip(bent - held * (1.0 / 12.0) * d, -limit, limit)
    bend = w * (1.0 / 3.0) if loading else w * (1.0 - 2.0 * sigma) * (1.0 / 3.0)
    d = d + stiffness * per_stiffness * (bent + bend * clip(d * d, 0.0, 1.0))
    relaxation = creeping * creeping * (1.0 / STIFF**2)
    smooth = 1.0 - clip(relaxation * relaxation, 0.0, 1.0)
    smooth = smooth * smooth
    half = smooth * creeping * (2.0 / 3.0)
    end, fixed, after = creeping, free, w
    low, high, last = 0.0, 0.0, 0.0
    for attempt in range(100):  # the first time inside, too: a second call in the code would double the time of compiling
        direction = 1.0 if d.real >= 0.0 else -1.0
        middle, after = advance_twice(w, 0.5 * d, sigma, n)
        slope_halfway = slope(middle, direction, sigma, n)
        if attempt == 0:
            if direction * w.real > 1.0 - NEARLY_SATURATED:
                if direction * after.real > 1.0 - SATURATED:
                    after = direction + 0.0 * after
                return d * x_y, after
            stiffness = creeping * slope_halfway
            end = smooth * (creeping * (1.0 / 6.0 + (held + stiffness) * (1.0 / 12.0)) + change)
            end = end + (1.0 - smooth) * implicit_weight(creeping) * creeping
            fixed = free - (creeping - half - end) * w + smooth * stiffness * bent
            # The state stays within ±1, which bounds the root.
            low, high = (fixed - half - end).real, (fixed + half + end).real
            last = high - low
        balance = d - fixed + half * middle + end * after
        if balance.real > 0.0:
            high = d.real
        else:
            low = d.real
        slope_after = slope(after, direction, sigma, n)
        step = -balance / (1.0 + 0.5 * half * slope_halfway + end * slope_after)
        if abs(step.real) <= TRAVEL_TOLERANCE or high - low <= BRACKET_TOLERANCE:
            return (d + step) * x_y, after + slope_after * step
        d, last = next_iterate(d, step, low, high, last)
    return d * x_y, after


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
    states=8,
    order=4,
    observables=observables,
)
