"""Flow past the piston beside the controlled gap: mechanically a dashpot in series with the damper."""

from typing import Any

from numba import njit

from mrd_sim.effects.effect import Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("conductance", "m/(N s)", 0.0, 0.0, 1e-3, "speed that the leak takes over the force, 1 / c_1"),
    Parameter("preload", "N", 0.0, -500.0, 500.0, "force that is not the fluid's and drives no leak, F_0"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _elongation(parameters: Any, before: Any, dt: float, force: Any, x: Any) -> Any:
    p = named(Parameters, parameters)
    return before + dt * p.conductance * (force - p.preload)


EFFECT = Effect(
    id="bypass_flow",
    title="Flow past the piston",
    phrase="fluid leaks past the piston, {conductance} of speed over force",
    stage="fluid",
    equation="F = damper(x - e), e' = (F - F_0) / c_1",
    source="Spencer, Dyke, Sain & Carlson (1997), c_1 of the modified Bouc-Wen model",
    parameters=PARAMETERS,
    typical={"conductance": 2e-5, "preload": 0.0},
    starts=lambda _force: [2e-5, 4e-6, 1e-4],
    symptom="the force develops in another way after a reversal",
    signature="the force falls off at low speed, by less the lower the current",
    confused_with=("shear_thinning", "rate_dependent_hysteresis", "series_compliance", "cavitation"),
    separated_by="strokes so slow that the damper does not yield, at several currents",
    shows=("reversal", "velocity"),
    elongation=_elongation,
    coefficient="series_viscous",
)
