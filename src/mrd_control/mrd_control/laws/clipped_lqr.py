"""Clipped-optimal control with the whole state (LQR)."""

from collections.abc import Mapping
from typing import Any

from numba import njit

from mrd_control.laws.law import STATE, Array, Law, Signals
from mrd_control.laws.optimal import HIGH_CURRENT, WEIGHTS, clipped_current, optimal_gains
from mrd_control.linear import LinearSystem
from mrd_sim.named import named, tuple_type

PARAMETERS = (HIGH_CURRENT, *WEIGHTS)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)
OWN = len(PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    demanded = 0.0
    for i in range(len(parameters) - OWN):
        demanded += parameters[OWN + i] * signals[STATE + i]
    return clipped_current(named(Parameters, parameters).high_current, demanded, named(Signals, signals).force)


def _prepare(values: Mapping[str, float], system: LinearSystem, period: float) -> Array:
    return optimal_gains(values, system)


LAW = Law(
    id="clipped_lqr",
    title="Clipped-optimal, LQR",
    equation="I = high_current H((F_d - F) F), F_d = -K x by LQR",
    source="Dyke, Spencer, Sain & Carlson, Smart Mater. Struct. 5 (1996)",
    parameters=PARAMETERS,
    kernel=_current,
    prepare=_prepare,
)
