"""Mixed skyhook and acceleration-driven damping (SH-ADD)."""

import math
from typing import Any

from numba import njit

from mrd_control.laws.law import Array, Law, Signals
from mrd_control.laws.shared_parameters import HIGH_CURRENT, LOW_CURRENT
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    LOW_CURRENT,
    HIGH_CURRENT,
    Parameter("crossover", "rad/s", 4.0 * math.pi, 0.0, 1e3, "frequency between skyhook and ADD, alpha"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    p, s = named(Parameters, parameters), named(Signals, signals)
    slow = s.acceleration * s.acceleration <= (p.crossover * s.upper_velocity) ** 2
    guide = s.upper_velocity if slow else s.acceleration
    return p.high_current if guide * s.speed >= 0.0 else p.low_current


LAW = Law(
    id="mixed_skyhook_add",
    title="Mixed skyhook and ADD",
    equation="on-off skyhook where z_s''^2 <= alpha^2 z_s'^2, else ADD",
    source="Savaresi & Spelta, J. Dyn. Syst. Meas. Control 129 (2007)",
    parameters=PARAMETERS,
    kernel=_current,
)
