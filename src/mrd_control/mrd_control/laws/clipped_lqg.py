"""Clipped-optimal control with an estimated state (LQG)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

from mrd_control.laws.law import Array, Law, Signals
from mrd_control.laws.optimal import HIGH_CURRENT, WEIGHTS, clipped_current, kalman_filter, optimal_gains
from mrd_control.linear import LinearSystem
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    HIGH_CURRENT,
    *WEIGHTS,
    Parameter(
        "disturbance",
        "1/Hz",
        1e-3,
        1e-12,
        1e6,
        "density of the velocity, (m/s)²/Hz, or acceleration of the base",
        free=False,
    ),
    Parameter("travel_noise", "m", 1e-4, 1e-9, 1.0, "rms error of the measured travel", free=False),
    Parameter("acceleration_noise", "m/s^2", 0.05, 1e-9, 100.0, "rms error of the measured acceleration", free=False),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)
OWN = len(PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    p, s = named(Parameters, parameters), named(Signals, signals)
    m = len(memory) // 2
    gains, direct = parameters[OWN : OWN + m], parameters[OWN + m]
    matrix = parameters[OWN + m + 1 :].reshape((m, m + 5))
    estimate, following = memory[:m], memory[m:]
    demanded, travel_error, error = 0.0, s.travel, s.acceleration - direct * s.force
    for j in range(m):
        demanded += gains[j] * estimate[j]
        travel_error -= matrix[j, m + 3] * estimate[j]
        error -= matrix[j, m + 4] * estimate[j]
    for i in range(m):
        following[i] = matrix[i, m] * s.force + matrix[i, m + 1] * travel_error + matrix[i, m + 2] * error
        for j in range(m):
            following[i] += matrix[i, j] * estimate[j]
    for i in range(m):
        estimate[i] = following[i]
    return clipped_current(p.high_current, demanded, s.force)


def _prepare(values: Mapping[str, float], system: LinearSystem, period: float) -> Array:
    matrix = kalman_filter(system, period, values["disturbance"], values["travel_noise"], values["acceleration_noise"])
    return np.concatenate([optimal_gains(values, system), system.outputs[:1, -1], matrix.ravel()])


def _memory(system: LinearSystem) -> int:
    return 2 * system.order


LAW = Law(
    id="clipped_lqg",
    title="Clipped-optimal, LQG",
    equation="as clipped_lqr, the state by a Kalman filter from travel, acceleration and force",
    source="Dyke, Spencer, Sain & Carlson, Smart Mater. Struct. 5 (1996)",
    parameters=PARAMETERS,
    kernel=_current,
    memory=_memory,
    prepare=_prepare,
)
