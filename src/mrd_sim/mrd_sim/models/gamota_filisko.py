"""Gamota-Filisko model: a Bingham element in series with a viscoelastic solid."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.dual import absolute, exp, expm1, log, sqrt
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import PRELOAD, VISCOUS, YIELD_FORCE
from mrd_sim.named import Row, named_row, tuple_type

MOST_EVENTS = 16
"""Number of times the element may yield or stop within one step. At constant rod speed it does so a few times at most."""

COEFFICIENTS = (
    # Neither may be 0: without a yield force the element would never stand, and the equations divide by c0.
    replace(YIELD_FORCE, symbol="f_c", meaning="yield force of the Bingham element", lower=1.0),
    replace(VISCOUS, lower=20.0, multiplies="", log=True),
    Coefficient(
        "solid_stiffness", "k1", "N/m", "Kelvin-Voigt spring", 5e6, 1e5, 1e8, (0.0, -2e7, 2e7), log=True, law="constant"
    ),
    Coefficient(
        "solid_viscous", "c1", "N s/m", "Kelvin-Voigt dashpot", 2e4, 1e2, 1e6, (0.0, -2e5, 2e5), log=True, law="constant"
    ),
    Coefficient(
        "series_stiffness", "k2", "N/m", "spring in series", 5e6, 1e5, 1e8, (0.0, -2e7, 2e7), log=True, law="constant"
    ),
    PRELOAD,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    f, s, before = state[0], state[1], state[2]
    if dt[0] == 0.0:
        before = x[0]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        if dt[k] > 0.0:
            f, s = _step(f, s, (x[k] - before) / dt[k], dt[k], c)
        before = x[k]
        force[k] = f + c.offset
    state[0], state[1], state[2] = f, s, before


@njit(cache=True, nogil=True)
def _step(f: Any, s: Any, speed: Any, dt: Any, c: Row) -> tuple[Any, Any]:
    """Return the force and the elongation of the Kelvin-Voigt pair after the rod moved at constant ``speed`` for ``dt``.

    While the Bingham element stands, and while it slides either way, the two obey y' = M y + b with a constant matrix. Their
    rates then decay as y'(t) = exp(M t) y'(0); both eigenvalues are real, different and not positive. The instants at which
    the element yields or stops are roots in between. The rates are continuous there. So the derivative of such an instant
    does not matter to what follows; nor, to first order, does its error.
    """
    f_c, c0 = c.yield_force, c.viscous
    k1, c1, k2 = c.solid_stiffness, c.solid_viscous, c.series_stiffness
    left = dt
    slides = 0.0 if absolute(f.real) <= f_c.real else 1.0 if f.real > 0.0 else -1.0
    for event in range(MOST_EVENTS + 1):
        # M = [[-p, k2 r], [1 / c1, -r]] with r = k1 / c1.
        yielding = slides * slides / c0
        p = k2 * (yielding + 1.0 / c1)
        r = k1 / c1
        apart = sqrt((p - r) * (p - r) + 4.0 * k2 * r / c1)
        fast = 0.5 * (p + r + apart)
        slow = k2 * r * yielding / fast
        ds = (f - k1 * s) / c1
        df = k2 * (speed - yielding * (f - slides * f_c) - ds)
        # Each rate is the sum of a slow and a fast mode.
        df_slow = ((fast - p) * df + k2 * r * ds) / apart
        ds_slow = (df / c1 + (fast - r) * ds) / apart
        df_fast, ds_fast = df - df_slow, ds - ds_slow
        t = left
        if event < MOST_EVENTS:
            instant = _first_event(f.real, df_slow.real, df_fast.real, slow.real, fast.real, left.real, slides, f_c.real)
            if instant < left.real:
                t = instant + 0.0 * left
        e_slow, e_fast = _integral_of_decay(slow, t), _integral_of_decay(fast, t)
        f = f + df_slow * e_slow + df_fast * e_fast
        s = s + ds_slow * e_slow + ds_fast * e_fast
        if t.real == left.real:
            break
        left = left - t
        slides = 0.0 if slides != 0.0 else 1.0 if f.real > 0.0 else -1.0
    return f, s


@njit(cache=True, nogil=True)
def _integral_of_decay(rate: Any, t: Any) -> Any:
    """Return the integral E(rate) of exp(-rate t) from 0 to t."""
    return -expm1(-rate * t) / rate if rate.real > 0.0 else t + 0.0 * rate


@njit(cache=True, nogil=True)
def _first_event(
    f: float, df_slow: float, df_fast: float, slow: float, fast: float, left: float, slides: float, f_c: float
) -> float:
    """Return the first instant at which the force f + df_slow E(slow) + df_fast E(fast) passes the yield force, or ``left``.

    ``slides`` is the direction in which the Bingham element slides; it is 0 while the element stands.
    """
    # The force has one extremum at most, and is monotone before and after it.
    turn = left
    if df_slow * df_fast < 0.0 and absolute(df_fast) > absolute(df_slow):
        turn = log(-df_fast / df_slow) / (fast - slow)
        if turn > left:
            turn = left
    low, high = 0.0, turn
    for _ in range(2):
        reached = f + df_slow * _integral_of_decay(slow, high) + df_fast * _integral_of_decay(fast, high)
        beyond = absolute(reached) - f_c if slides == 0.0 else f_c - slides * reached
        if beyond > 0.0:
            limit = slides * f_c if slides != 0.0 else f_c if reached > 0.0 else -f_c
            instant: float = _crossing(f - limit, df_slow, df_fast, slow, fast, low, high)
            return instant
        if high == left:
            break
        low, high = high, left
    return left


@njit(cache=True, nogil=True)
def _crossing(f: float, df_slow: float, df_fast: float, slow: float, fast: float, low: float, high: float) -> float:
    """Return the root of f + df_slow E(slow) + df_fast E(fast) where it is monotone, by Newton's method within a bracket."""
    end = high
    sign = 1.0 if f + df_slow * _integral_of_decay(slow, high) + df_fast * _integral_of_decay(fast, high) > 0.0 else -1.0
    t = 0.5 * (low + high)
    for _ in range(80):
        value = f + df_slow * _integral_of_decay(slow, t) + df_fast * _integral_of_decay(fast, t)
        if sign * value > 0.0:
            high = t
        else:
            low = t
        rate = df_slow * exp(-slow * t) + df_fast * exp(-fast * t)
        step = -value / rate if rate != 0.0 else end
        if absolute(step) <= 1e-9 * t or high - low <= 1e-15 * end:
            break
        t = t + step
        if not low <= t <= high:
            t = 0.5 * (low + high)
    return t


def _observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    fast, added = values["series_stiffness"], values["solid_stiffness"]
    return {
        "yield force f_c": (values["yield_force"], "N"),
        "c0": (values["viscous"], "N s/m"),
        "fast stiffness k2": (fast, "N/m"),
        "slow stiffness k1 k2/(k1 + k2)": (fast * added / (fast + added), "N/m"),
        "creep time c1/(k1 + k2)": (values["solid_viscous"] / (fast + added), "s"),
    }


MODEL = DamperModel(
    id="gamota_filisko",
    title="Gamota-Filisko",
    equation="F = f0 + k2 (x - x2) = f0 + k1 (x2 - x1) + c1 (x2' - x1'), "
    "c0 x1' = F - f0 - f_c sgn(F - f0) where |F - f0| > f_c, else x1' = 0",
    source="Gamota & Filisko, J. Rheol. 35 (1991) 399",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=3,
    observables=_observables,
)
