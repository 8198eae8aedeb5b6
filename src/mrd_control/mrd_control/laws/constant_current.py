"""Constant current: the passive damper that every law has to beat."""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_control.laws.law import Array, Law
from mrd_control.laws.shared_parameters import LOW_CURRENT
from mrd_sim.named import named, tuple_type

PARAMETERS = (replace(LOW_CURRENT, name="current", meaning="current of the coil"),)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    return named(Parameters, parameters).current


LAW = Law(
    id="constant_current",
    title="Constant current",
    equation="I = current",
    source="passive reference",
    parameters=PARAMETERS,
    kernel=_current,
)
