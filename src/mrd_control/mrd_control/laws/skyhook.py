"""Continuous skyhook."""

from typing import Any

from numba import njit

from mrd_control.force_map import current_for_force
from mrd_control.laws.law import Array, Law, Signals
from mrd_control.laws.shared_parameters import SKYHOOK
from mrd_sim.named import named, tuple_type

PARAMETERS = (SKYHOOK,)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    p, s = named(Parameters, parameters), named(Signals, signals)
    return current_for_force(force_map, s.speed, p.skyhook_viscous * s.upper_velocity / s.lever_ratio)


LAW = Law(
    id="skyhook",
    title="Continuous skyhook",
    equation="F_d = c_sky z_s', as far as the damper can give it",
    source="Karnopp, Crosby & Harwood, J. Eng. Ind. 96 (1974)",
    parameters=PARAMETERS,
    kernel=_current,
    demands_force=True,
)
