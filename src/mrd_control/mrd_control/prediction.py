"""Compensation of the actuator's delay: what to command so that the rod is where it should be when it gets there.

A predictor is a compiled function ``predictor(parameters, memory, position, velocity, acceleration, measured)``: from the
motion wanted now and the measured position of the rod, the position in m to command now. ``memory`` is carried on.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import unknown_key

Array = NDArray[np.float64]

PREDICTOR = types.FunctionType(
    types.float64(types.float64[::1], types.float64[::1], types.float64, types.float64, types.float64, types.float64)
)
"""Compiled type of a predictor."""

MODEL = "model"
"""Id of the prediction by the emulated system itself, which `mrd_control.online.OnlineLoop` makes: it knows its state and
how its base will move, and lets the force stay as it is."""
ORDER = 3
"""Of the extrapolating polynomial: Horiuchi et al. (1999) found the third order best."""
FORGETTING_TIME = 1.0
"""s, over which the adaptive predictor forgets."""
SMOOTHING_TIME = 2e-3
"""s, time constant of each of the three lags behind which the adaptive predictor sees rod and command alike."""
LEAST_SPEED = 1e-3
"""m/s of the rod, below which the adaptive predictor does not learn."""
TRUST = 0.3
"""Standard deviation of the adaptive coefficients, about 1, before anything is measured."""
COMMAND_ERROR = 2e-5
"""m rms, to which a command is known from the measured motion."""
MOST_VARIANCE = 3.0 * (TRUST / COMMAND_ERROR) ** 2
"""Sum of the variances of the coefficients above which they are not forgotten further, in 1/m²."""
LEAST, MOST = (0.7, 0.0, -1.0), (1.3, 2.0, 3.0)
"""Limits of the adaptive coefficients."""


@dataclass(frozen=True, eq=False)
class Predictor:
    """A predictor and how to prepare it.

    Attributes
    ----------
    id, title, source : str
    kernel : callable
    prepare : callable
        ``prepare(period, ahead)``: parameters and memory for a sampling period and a delay, both in s.
    """

    id: str
    title: str
    source: str
    kernel: Callable[[Any, Any, Any, Any, Any, Any], float]
    prepare: Callable[[float, float], tuple[Array, Array]]


@njit(cache=True, nogil=True)
def _uncompensated(
    parameters: Array, memory: Array, position: float, velocity: float, acceleration: float, measured: float
) -> float:
    return position


@njit(cache=True, nogil=True)
def polynomial_prediction(
    parameters: Array, memory: Array, position: float, velocity: float, acceleration: float, measured: float
) -> float:
    """Extrapolate the polynomial through past positions: Horiuchi et al., Earthq. Eng. Struct. Dyn. 28 (1999) 1121.

    ``parameters`` are the weights of the nodes, from now to the past; ``memory`` holds the number of samples so far and the
    past positions, of which every so many-th is a node. Until it is filled the position passes unchanged.
    """
    nodes = len(parameters)
    length = len(memory) - 1
    spacing = (length - 1) // (nodes - 1)
    seen = int(memory[0])
    memory[1 + seen % length] = position
    memory[0] = seen + 1
    if seen < length - 1:
        return position
    predicted = 0.0
    for i in range(nodes):
        predicted += parameters[i] * memory[1 + (seen - i * spacing) % length]
    return predicted


@njit(cache=True, nogil=True)
def adaptive_prediction(
    parameters: Array, memory: Array, position: float, velocity: float, acceleration: float, measured: float
) -> float:
    """Command a0 x + a1 x' + a2 x'' with coefficients learnt from the rod: adaptive time series, Chae, Kazemibidokhti &
    Ricles, Earthq. Eng. Struct. Dyn. 42 (2013) 1697.

    The coefficients are those that give the past commands from the measured motion. They follow by recursive least squares
    with exponential forgetting, where Chae et al. solve over a moving window; and they stay within `LEAST` and `MOST`. Rod
    and command are seen behind the same lags, which change nothing of what is between them: the derivatives of a noisy
    position would be noise, and coefficients learnt from them too small.

    ``parameters`` are the period, the delay guessed at first, the forgetting factor and what each lag keeps from sample to
    sample; ``memory`` holds coefficients (3,), covariance (3, 3), room for products (3,), the lags of rod (3,) and command
    (3,), the last two positions and the last command behind them, the last command, and the number of samples.
    """
    period, guess, forgetting, kept = parameters[0], parameters[1], parameters[2], parameters[3]
    coefficients, covariance, products = memory[:3], memory[3:12].reshape((3, 3)), memory[12:15]
    now, commanded = _behind_lags(memory[15:18], measured, kept), _behind_lags(memory[18:21], memory[24], kept)
    last, before = memory[21], memory[22]
    speed = (now - before) / (2.0 * period)
    if memory[25] >= 3.0 and abs(speed) > LEAST_SPEED:
        # In the middle of three positions; scaled so that all coefficients are about one.
        bend = (now - 2.0 * last + before) / (period * period)
        regressor = (last, guess * speed, 0.5 * guess * guess * bend)
        error, scale = memory[23], forgetting
        for i in range(3):
            error -= coefficients[i] * regressor[i]
            products[i] = 0.0
            for j in range(3):
                products[i] += covariance[i, j] * regressor[j]
            scale += products[i] * regressor[i]
        growth = 1.0 / forgetting if covariance[0, 0] + covariance[1, 1] + covariance[2, 2] < MOST_VARIANCE else 1.0
        for i in range(3):
            coefficients[i] = min(max(coefficients[i] + products[i] * error / scale, LEAST[i]), MOST[i])
            for j in range(3):
                covariance[i, j] = growth * (covariance[i, j] - products[i] * products[j] / scale)
    predicted = (
        coefficients[0] * position
        + coefficients[1] * guess * velocity
        + coefficients[2] * 0.5 * guess * guess * acceleration
    )
    memory[21], memory[22] = now, last
    memory[23], memory[24] = commanded, predicted
    memory[25] += 1.0
    return float(predicted)


@njit(cache=True, nogil=True)
def _behind_lags(lags: Array, value: float, kept: float) -> float:
    """Return a value behind equal lags, which it moves."""
    for i in range(len(lags)):
        lags[i] = value + kept * (lags[i] - value)
        value = lags[i]
    return value


def _prepare_none(period: float, ahead: float) -> tuple[Array, Array]:
    return np.zeros(0), np.zeros(0)


def _prepare_polynomial(period: float, ahead: float) -> tuple[Array, Array]:
    spacing = max(round(ahead / period), 1)
    nodes = -spacing * period * np.arange(ORDER + 1)
    others = [np.delete(nodes, i) for i in range(ORDER + 1)]
    weights = [math.prod((ahead - other) / (node - other)) for node, other in zip(nodes, others, strict=True)]
    return np.array(weights), np.zeros(2 + ORDER * spacing)


def _prepare_adaptive(period: float, ahead: float) -> tuple[Array, Array]:
    memory = np.zeros(26)
    memory[:3] = 1.0
    memory[3:12] = np.ravel(np.eye(3) * (TRUST / COMMAND_ERROR) ** 2)
    decays = math.exp(-period / FORGETTING_TIME), math.exp(-period / SMOOTHING_TIME)
    return np.array([period, max(ahead, period), *decays]), memory


PREDICTORS = {
    predictor.id: predictor
    for predictor in (
        Predictor("none", "no compensation", "", _uncompensated, _prepare_none),
        Predictor("polynomial", "polynomial", "Horiuchi et al. (1999)", polynomial_prediction, _prepare_polynomial),
        Predictor("adaptive", "adaptive time series", "Chae et al. (2013)", adaptive_prediction, _prepare_adaptive),
    )
}
"""Catalogue, by id."""


def find_predictor(name: str) -> Predictor:
    """Return a predictor by its id.

    Raises
    ------
    InputError
        For an unknown predictor; lists the known ones.
    """
    if name not in PREDICTORS:
        raise InputError(f"unknown predictor {unknown_key(name, PREDICTORS)}")
    return PREDICTORS[name]
