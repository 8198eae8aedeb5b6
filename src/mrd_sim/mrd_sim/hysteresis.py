"""The Bouc-Wen state, advanced exactly.

The state is normalised, w = z / z0, so that it saturates at ±1 (Ikhouane & Rodellar, Systems with Hysteresis, 2007):

    dw/dx = rho (1 - sigma sgn(x') w |w|^(n-1) - (1 - sigma) |w|^n)   for motion in either direction,

with rho = A / z0 in 1/m and sigma = gamma / (beta + gamma) where, as in Spencer et al. (1997), gamma multiplies |x'|. Class
I (bounded, dissipative) is rho > 0 and sigma >= 1/2; the functions below need it. Between reversals the equation separates:
over the travel u in units of 1/rho, v = |w| rises by dv/du = 1 - v^n while loading, and p = |w| falls by dp/du =
-(1 + b p^n), b = 2 sigma - 1, while unloading. For n = 1 and n = 2 the solutions are written out. For other exponents the
travel is a Gauss hypergeometric function of the state, which Newton's method inverts. So there is no step size to choose,
and no speed at which the integration fails. All functions take numbers with derivatives (`mrd_sim.dual`).
"""

from typing import Any

from numba import njit

from mrd_sim.dual import atan, exp, expm1, log, log1p, power, sqrt, tan

_EULER = 0.5772156649015329
_ACCURACY = 1e-13
"""Of the state or its logarithm; smaller steps of Newton's method are rounding."""


@njit(cache=True, nogil=True)
def slope(w: Any, direction: float, sigma: Any, n: Any) -> Any:
    """Return the slope dw/d(rho x) of the state while the rod moves in ``direction`` (±1)."""
    v = direction * w
    if v.real >= 0.0:
        return 1.0 - (v * v if n == 2.0 else v if n == 1.0 else power(v, n))
    p = -v
    return 1.0 + (2.0 * sigma - 1.0) * (p * p if n == 2.0 else p if n == 1.0 else power(p, n))


@njit(cache=True, nogil=True)
def advance(w: Any, travel: Any, sigma: Any, n: Any) -> Any:
    """Return the state after the rod moved by ``travel`` = rho dx without reversal.

    Parameters
    ----------
    w : float
        State before, |w| <= 1.
    travel : float
        Displacement in units of the yield travel 1/rho, with sign.
    sigma : float
        gamma / (beta + gamma), at least 1/2.
    n : float
        Exponent, at least 1.
    """
    direction = 1.0 if travel.real >= 0.0 else -1.0
    h = direction * travel
    v = direction * w
    if n == 2.0 and v.real >= 0.0:
        # By far the most frequent case. This function is small enough for the compiler to inline it into the models' loops.
        rest = (1.0 - v) * exp(-2.0 * h)
        return direction * (1.0 + v - rest) / (1.0 + v + rest)
    return direction * _advanced(v, h, sigma, n)


@njit(cache=True, nogil=True, fastmath={"contract"})
def advance_twice(w: Any, travel: Any, sigma: Any, n: Any) -> tuple[Any, Any]:
    """Return the states after ``travel`` and after twice as much; arguments as of `advance`.

    For n = 2 and up to half a yield travel the error is below 1e-10. The state is (v + t) / (1 + b v t) with the tangent t,
    hyperbolic while loading, of the travel. Its continued fraction (Lambert, 1768) stands for it: quick, and one form for
    both.
    """
    direction = 1.0 if travel.real >= 0.0 else -1.0
    h = direction * travel
    v = direction * w
    if n == 2.0:
        b = 1.0 + 0.0 * sigma if v.real >= 0.0 else 1.0 - 2.0 * sigma
        z = b * h * h
        if abs(z.real) <= 0.25:
            p = h * (945.0 + z * (105.0 + z))
            q = 945.0 + z * (420.0 + 15.0 * z)
            after_p, after_q = 2.0 * p * q, q * q + b * p * p
            after = (v * after_q + after_p) / (after_q + b * v * after_p)
            if v.real >= 0.0 or after.real <= 0.0:
                return direction * (v * q + p) / (q + b * v * p), direction * after
    middle, after = v, v
    for i in range(2):  # one call in the code, because the compiler copies what is called
        middle, after = after, _advanced(v, (i + 1.0) * h, sigma, n)
    return direction * middle, direction * after


@njit(cache=True, nogil=True)
def _advanced(v: Any, h: Any, sigma: Any, n: Any) -> Any:
    """Return the state after the travel h >= 0 towards positive states."""
    if h.real == 0.0:
        return v + h * slope(v, 1.0, sigma, n)
    if v.real < 0.0:
        p = -v
        b = 2.0 * sigma - 1.0
        if n == 2.0 and b.real >= 1e-12:
            # The same as the branches below by the tangent of a difference, which saves an arc tangent.
            root = sqrt(b)
            if root.real * h.real < 1.5:
                travelled, start = tan(root * h), root * p
                if travelled.real < start.real:
                    return (travelled - start) / (root * (1.0 + start * travelled))
        crossing = _unloading_travel(p, b, n)
        if h.real < crossing.real:
            return -_unloaded(p, b, n, h, crossing)
        h = h - crossing
        v = 0.0 * v
    return _loaded(v, n, h)


@njit(cache=True, nogil=True)
def _loaded(v: Any, n: Any, h: Any) -> Any:
    """Return the state after loading from v >= 0 over the travel h."""
    if n == 2.0:
        rest = (1.0 - v) * exp(-2.0 * h)
        return (1.0 + v - rest) / (1.0 + v + rest)
    if n == 1.0:
        return 1.0 - (1.0 - v) * exp(-h)
    return _state_at(_loading_travel(v, n) + h, n)


@njit(cache=True, nogil=True)
def _unloading_travel(p: Any, b: Any, n: Any) -> Any:
    """Return the travel from the state p >= 0 back to zero, b >= 0: p F(1, 1/n; 1 + 1/n; -b p^n)."""
    if b.real < 1e-12:
        # The first term of the series in b, which has the right derivative.
        return p - b * power(p, n + 1.0) / (n + 1.0)
    if n == 2.0:
        root = sqrt(b)
        return atan(p * root) / root
    if n == 1.0:
        return log1p(b * p) / b
    # Pfaff's transformation brings the argument to at most 2/3 for sigma <= 3/2.
    x = b * power(p, n)
    z = x / (1.0 + x)
    term = p / (1.0 + x)
    total = term
    for k in range(1, 400):
        term = term * z * (k / (k + 1.0 / n))
        total = total + term
        if abs(term.real) < 1e-17 * abs(total.real):
            break
    return total


@njit(cache=True, nogil=True)
def _unloaded(p: Any, b: Any, n: Any, h: Any, crossing: Any) -> Any:
    """Return the state after unloading from p over the travel h, which is less than ``crossing``."""
    if b.real < 1e-12:
        return p - h - b * (power(p, n + 1.0) - power(p - h, n + 1.0)) / (n + 1.0)
    if n == 2.0:
        root = sqrt(b)
        return tan(root * (crossing - h)) / root
    if n == 1.0:
        return expm1(b * (crossing - h)) / b
    left = crossing - h
    # The travel is a concave function of the state and never exceeds it, so Newton's method rises from here to the root.
    state = left
    for _ in range(60):
        step = (left - _unloading_travel(state, b, n)) * (1.0 + b * power(state, n))
        state = state + step
        if abs(step.real) < _ACCURACY:
            break
    return state


@njit(cache=True, nogil=True)
def _loading_travel(v: Any, n: Any) -> Any:
    """Return the travel from zero to the state 0 <= v < 1: v F(1, 1/n; 1 + 1/n; v^n)."""
    x = power(v, n)
    if x.real > 0.5:
        return _travel_near_saturation(log(1.0 - x) if x.real < 1.0 else -40.0 + 0.0 * x, v, n)
    term = v
    total = v
    for k in range(1, 200):
        term = term * x
        total = total + term / (1.0 + n * k)
        if term.real < 1e-17 * total.real:
            break
    return total


@njit(cache=True, nogil=True)
def _travel_near_saturation(log_rest: Any, v: Any, n: Any) -> Any:
    """Return the same travel from ln(1 - v^n), by the series about 1 (Abramowitz & Stegun, 1964, 15.3.10)."""
    rest = exp(log_rest)
    b = 1.0 / n
    weight = b + 0.0 * v
    digammas = -_EULER - _digamma(b)  # psi(k + 1) - psi(b + k)
    total = 0.0 * v
    for k in range(200):
        term = weight * (digammas - log_rest)
        total = total + term
        weight = weight * rest * ((b + k) / (k + 1.0))
        digammas = digammas + 1.0 / (k + 1.0) - 1.0 / (b + k)
        if abs(weight.real) < 1e-18:
            break
    return v * total


@njit(cache=True, nogil=True)
def _state_at(travel: Any, n: Any) -> Any:
    """Return the state whose travel from zero is ``travel``: the inverse of `_loading_travel`."""
    middle = 0.5 ** (1.0 / n.real)
    split = _loading_travel(middle + 0.0 * travel, n)
    if travel.real <= split.real:
        v = travel * (middle / split.real)
        for _ in range(60):
            step = (travel - _loading_travel(v, n)) * (1.0 - power(v, n))
            v = v + step
            if abs(step.real) < _ACCURACY:
                break
        return v
    # Near saturation the travel is almost linear in the logarithm of 1 - v^n.
    log_rest = -0.6931471805599453 + n * (split - travel)
    v = power(1.0 - exp(log_rest), 1.0 / n)
    for _ in range(60):
        step = (_travel_near_saturation(log_rest, v, n) - travel) * n * power(v, n - 1.0)
        log_rest = log_rest + step
        if log_rest.real > -0.69:
            log_rest = log_rest - (log_rest.real + 0.69)
        v = power(1.0 - exp(log_rest), 1.0 / n)
        if abs(step.real) < _ACCURACY * max(1.0, abs(log_rest.real)):
            break
    return v


@njit(cache=True, nogil=True)
def _digamma(x: Any) -> Any:
    """Return the digamma function of x > 0: recurrence up to 10, then Stirling's series."""
    total = 0.0 * x
    while x.real < 10.0:
        total = total - 1.0 / x
        x = x + 1.0
    r = 1.0 / (x * x)
    series = r * (1.0 / 12 - r * (1.0 / 120 - r * (1.0 / 252 - r * (1.0 / 240 - r / 132))))
    return total + log(x) - 0.5 / x - series
