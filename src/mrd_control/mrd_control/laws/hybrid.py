"""Hybrid of skyhook and groundhook."""

from typing import Any

from numba import njit

from mrd_control.force_map import current_for_force
from mrd_control.laws.law import Array, Law, Signals
from mrd_control.laws.shared_parameters import GROUNDHOOK, SKYHOOK
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (SKYHOOK, GROUNDHOOK, Parameter("share", "", 0.7, 0.0, 1.0, "of the skyhook, zeta; the rest is groundhook"))
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    p, s = named(Parameters, parameters), named(Signals, signals)
    # Each part first for itself: where a damper cannot give one of them, that part is nothing.
    sky, ground = p.skyhook_viscous * s.upper_velocity, -p.groundhook_viscous * s.lower_velocity
    force = 0.0
    if sky * s.speed > 0.0:
        force += p.share * sky
    if ground * s.speed > 0.0:
        force += (1.0 - p.share) * ground
    return current_for_force(force_map, s.speed, force / s.lever_ratio)


LAW = Law(
    id="hybrid",
    title="Hybrid skyhook-groundhook",
    equation="F_d = zeta F_sky + (1 - zeta) F_gnd, each clipped for itself",
    source="Ahmadian, SAE Technical Paper 1999-01-0727 (1999)",
    parameters=PARAMETERS,
    kernel=_current,
    demands_force=True,
)
