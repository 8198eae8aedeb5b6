"""Inverse model with a PI controller of the force."""

from typing import Any

from numba import njit

from mrd_control.force_map import current_for_force
from mrd_control.laws.law import Array, Law, Signals
from mrd_control.laws.shared_parameters import SKYHOOK
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    SKYHOOK,
    Parameter("viscous", "N s/m", 0.0, 0.0, 1e6, "dashpot in place of the damper, c", free=False),
    Parameter("proportional_gain", "A/N", 2e-4, 0.0, 1.0, "of the force error", free=False),
    Parameter("integral_gain", "A/(N s)", 0.01, 0.0, 100.0, "of the force error", free=False),
    Parameter("most_correction", "A", 0.2, 0.0, 5.0, "of the integral part, in either direction", free=False),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _current(parameters: Array, memory: Array, signals: Array, force_map: Array) -> Any:
    p, s = named(Parameters, parameters), named(Signals, signals)
    force = p.skyhook_viscous * s.upper_velocity / s.lever_ratio + p.viscous * s.speed
    if force * s.speed <= 0.0:
        return 0.0
    direction = 1.0 if s.speed > 0.0 else -1.0
    error = direction * (force - s.force)
    correction = memory[0] + p.integral_gain * error * s.period
    memory[0] = min(max(correction, -p.most_correction), p.most_correction)
    current = current_for_force(force_map, s.speed, force) + p.proportional_gain * error + memory[0]
    return max(current, 0.0)


LAW = Law(
    id="force_tracking",
    title="Inverse model with PI",
    equation="I = I(F_d, v) + k_p e + k_i int e dt, e = |F_d| - |F|, F_d = c_sky z_s' + c v; 0 where F_d v <= 0",
    source="Sims, Stanway & Beck, J. Vib. Control 3 (1997); inverse of the fitted model",
    parameters=PARAMETERS,
    kernel=_current,
    demands_force=True,
    memory=lambda _system: 1,
)
