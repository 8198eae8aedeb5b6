"""The Bouc-Wen state, advanced exactly.

The state is normalised, w = z / z0, so that it saturates at ±1 (Ikhouane & Rodellar, Systems with Hysteresis, 2007):

    dw/dx = rho (1 - sigma sgn(x') w |w|^(n-1) - (1 - sigma) |w|^n)   for motion in either direction,

with rho = A / z0 in 1/m and sigma = gamma / (beta + gamma) where, as in Spencer et al. (1997), gamma multiplies |x'|.
Class I (bounded, dissipative) is rho > 0 and sigma >= 1/2. On a stretch without reversal the equation separates; its
solutions for n = 1 and n = 2 are written out below, so there is no step size to choose and no speed at which it fails.
"""

import math

from numba import njit


@njit(cache=True, nogil=True)
def slope(w: float, direction: float, sigma: float, n: float) -> float:
    """Slope dw/d(rho x) of the state while the rod moves in ``direction`` (±1)."""
    v = direction * w
    if v >= 0.0:
        return float(1.0 - v**n)
    return float(1.0 + (2.0 * sigma - 1.0) * (-v) ** n)


@njit(cache=True, nogil=True)
def advance(w: float, travel: float, sigma: float, n: float) -> float:
    """State after the rod moved by ``travel`` = rho dx without reversal; exact for n = 1 and n = 2.

    Parameters
    ----------
    w : float
        State before, |w| <= 1.
    travel : float
        Displacement in units of the yield travel 1/rho, with sign.
    sigma : float
        gamma / (beta + gamma), >= 1/2 for a dissipative loop.
    n : float
        Exponent, 1 or 2.
    """
    if travel == 0.0:
        return w
    direction = 1.0 if travel > 0.0 else -1.0
    h = abs(travel)
    v = direction * w
    if v < 0.0:  # unloading towards w = 0
        p = -v
        b = 2.0 * sigma - 1.0
        if n == 1.0:
            crossing = math.log1p(b * p) / b if abs(b) > 1e-12 else p
            if h < crossing:
                return -direction * ((p + 1.0 / b) * math.exp(-b * h) - 1.0 / b if abs(b) > 1e-12 else p - h)
        elif b > 1e-12:
            root = math.sqrt(b)
            angle = math.atan(p * root)
            crossing = angle / root
            if h < crossing:
                return -direction * math.tan(angle - root * h) / root
        elif b < -1e-12:
            root = math.sqrt(-b)
            if p * root >= 1.0:  # outside class I: the state cannot cross zero any more
                return w
            angle = math.atanh(p * root)
            crossing = angle / root
            if h < crossing:
                return -direction * math.tanh(angle - root * h) / root
        else:
            crossing = p
            if h < crossing:
                return -direction * (p - h)
        h -= crossing
        v = 0.0
    if n == 1.0:
        v = 1.0 - (1.0 - v) * math.exp(-h)
    else:
        t = math.tanh(h)
        v = (v + t) / (1.0 + v * t)
    return direction * v
