"""On-off skyhook."""

from typing import Any

from numba import njit

from mrd_control.laws.law import Array, Law, Signals
from mrd_control.laws.shared_parameters import HIGH_CURRENT, LOW_CURRENT
from mrd_sim.named import named, tuple_type

PARAMETERS = (LOW_CURRENT, HIGH_CURRENT)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    p, s = named(Parameters, parameters), named(Signals, signals)
    return p.high_current if s.upper_velocity * s.speed >= 0.0 else p.low_current


LAW = Law(
    id="skyhook_on_off",
    title="On-off skyhook",
    equation="I = high_current if z_s' v >= 0, else low_current",
    source="Karnopp, Crosby & Harwood, J. Eng. Ind. 96 (1974)",
    parameters=PARAMETERS,
    kernel=_current,
)
