"""From measured current to the coefficients of a model: coil lag, then a law over current for each coefficient."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim.dual import at_least, exp, tanh
from mrd_sim.lag import decay, ramp_share

Array = NDArray[np.float64]

SAME_STEP = 1e-9
"""Relative. Steps that differ by less differ by rounding only, and share one exponential."""


@dataclass(frozen=True)
class CurrentLaw:
    """A law by which a coefficient p depends on the effective coil current u.

    Attributes
    ----------
    id, equation : str
        In the equation, ``p0`` is the value at 0 A and ``p1`` the slope there.
    code : int
        Number of the law in `evaluate_coefficients` and `slope_factors`.
    third : str
        Suffix that makes a coefficient's name that of the law's third parameter; empty where the law has none.
    """

    id: str
    equation: str
    code: int
    third: str = ""


LAWS = {
    law.id: law
    for law in (
        CurrentLaw("constant", "p = p0", 0),
        CurrentLaw("affine", "p = p0 + p1 u", 1),
        CurrentLaw("quadratic", "p = p0 + p1 u + p2 u²", 2, "_per_A2"),
        CurrentLaw("exponential", "p = p0 + p1 I_s (1 - exp(-u / I_s))", 3, "_saturation"),
        CurrentLaw("tanh", "p = p0 + p1 I_s tanh(u / I_s)", 4, "_saturation"),
    )
}


def parse_laws(text: str, where: str) -> str | dict[str, str]:
    """Read current laws: ``LAW`` for all coefficients, or ``COEFFICIENT=LAW,...``; ``where`` names the text in errors.

    Raises
    ------
    InputError
        When it is neither. The model checks the names (`mrd_sim.models.find_model`).
    """
    if "=" not in text:
        return text.strip()
    parts = [part.partition("=") for part in text.split(",")]
    if not all(name.strip() and law.strip() for name, _, law in parts):
        raise InputError(f"{where}: {text} is not a current law, expected LAW or COEFFICIENT=LAW,... of {', '.join(LAWS)}")
    return {name.strip(): law.strip() for name, _, law in parts}


@njit(cache=True, nogil=True)
def lagged_current(lags: Array, state: Array, dt: Array, current: Array, effective: Array) -> None:
    """Fill in the effective current u in A after a first-order lag, u' = (I - u) / lag, exact for I linear between vertices.

    ``state`` holds u and I at the previous vertex and is updated. ``lags`` (1,) is in s; 0 changes nothing.
    """
    lag = lags[0]
    u, before = state[0], state[1]
    step, left, share = 0.0, 0.0 * lag, 0.0 * lag
    for k in range(len(current)):
        now = current[k]
        if dt[k] == 0.0:
            u = now + 0.0 * lag
        else:
            # Samples are equally spaced but for rounding, so few exponentials have to be computed.
            if abs(dt[k] - step) > SAME_STEP * step:
                step = dt[k]
                left = decay(step, lag)
                share = ramp_share(lag / step, left)
            u = now - (now - before) * share + (u - before) * left
        effective[k] = u
        before = now + 0.0 * lag
    state[0], state[1] = u, before


@njit(cache=True, nogil=True)
def slope_factor(code: int, third: Any, u: Any) -> Any:
    """Return what the law ``code`` multiplies its slope with, in A: the current, or less where the law saturates."""
    if code < 3:
        return u + 0.0 * third
    return third * (1.0 - exp(-u / third) if code == 3 else tanh(u / third))


@njit(cache=True, nogil=True)
def slope_factors(code: int, third: float, current: Array) -> Array:
    """Return what the law ``code`` multiplies its slope with, (m,) in A, along the effective current."""
    factors = np.empty_like(current)
    for k in range(len(current)):
        factors[k] = slope_factor(code, third, current[k])
    return factors


@njit(cache=True, nogil=True)
def evaluate_coefficients(
    theta: Array, codes: NDArray[np.intp], columns: NDArray[np.intp], floors: Array, current: Array, values: Array
) -> None:
    """Evaluate the coefficients on the vertices.

    Parameters
    ----------
    theta : ndarray (parameters,)
    codes : ndarray (coefficients,) of int
        Law of each coefficient.
    columns : ndarray (coefficients, 3) of int
        Where in ``theta`` its parameters are; -1 for one that its law does not have.
    floors : ndarray (coefficients,)
        Least value of each: a law that falls with current stops there.
    current : ndarray (m,)
        Effective current in A, of the same type as ``theta``.
    values : ndarray (m, coefficients)
        Filled. Column-major, for speed.
    """
    for j in range(len(codes)):
        code, floor = codes[j], floors[j]
        value = theta[columns[j, 0]]
        slope = theta[columns[j, 1]] if code > 0 else 0.0 * value
        third = theta[columns[j, 2]] if columns[j, 2] >= 0 else 0.0 * value
        if code == 0:
            for k in range(len(current)):
                values[k, j] = value
        elif code == 1:
            for k in range(len(current)):
                values[k, j] = at_least(floor, value + slope * current[k])
        else:
            for k in range(len(current)):
                u = current[k]
                bent = value + slope * slope_factor(code, third, u)
                if code == 2:
                    bent = bent + third * u * u
                values[k, j] = at_least(floor, bent)
