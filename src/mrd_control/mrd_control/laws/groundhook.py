"""Continuous groundhook."""

from typing import Any

from numba import njit

from mrd_control.force_map import current_for_force
from mrd_control.laws.law import Array, Law, Signals
from mrd_control.laws.shared_parameters import GROUNDHOOK
from mrd_sim.named import named, tuple_type

PARAMETERS = (GROUNDHOOK,)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    p, s = named(Parameters, parameters), named(Signals, signals)
    return current_for_force(force_map, s.speed, -p.groundhook_viscous * s.lower_velocity / s.lever_ratio)


LAW = Law(
    id="groundhook",
    title="Groundhook",
    equation="F_d = -c_gnd z_u', as far as the damper can give it",
    source="Valášek et al., Vehicle Syst. Dyn. 27 (1997)",
    parameters=PARAMETERS,
    kernel=_current,
    demands_force=True,
)
