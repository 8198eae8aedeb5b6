"""Temperature dependence: heat thins the fluid, and lowers its yield stress by another amount.

The temperature is the measured one, so that nothing about heat is guessed. The effect scales the coefficients of the damper
model: those of its viscous part and those of its yield part (`mrd_sim.models.coefficient.Coefficient.part`). Stiffness, gas
force, yield travel and creep speeds stay. A sensor on the body shows the fluid late; the effect does not know by how much.

The reference temperature is that of data sheets, not the mean of the recordings: so the coefficients of fits to different
recordings are at the same temperature, and can be compared.
"""

from numba import njit
from numpy.typing import NDArray

from mrd_sim.dual import at_least, exp
from mrd_sim.effects.effect import VISCOUS, YIELD, Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

_OF_FLUID = "a property of the fluid"
PARAMETERS = (
    Parameter("viscous", "1/K", 0.0, 0.0, 0.1, "relative loss of the viscous coefficient per kelvin, a", absolute=_OF_FLUID),
    Parameter("yield_force", "1/K", 0.0, 0.0, 0.01, "share of the yield force that a kelvin removes, b", absolute=_OF_FLUID),
    Parameter(
        "reference",
        "K",
        298.15,
        298.15,
        298.15,
        "temperature T_r (25 °C) at which the coefficients of the model are unchanged",
        free=False,
        absolute="that of data sheets",
    ),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _scale(parameters: Array, parts: NDArray, temperature: Array, q: Array) -> None:  # type: ignore[type-arg]
    p = named(Parameters, parameters)
    for k in range(len(temperature)):
        warmer = temperature[k] - p.reference
        viscosity = exp(-p.viscous * warmer)
        yield_stress = at_least(0.0, 1.0 - p.yield_force * warmer)
        for j in range(len(parts)):
            if parts[j] == VISCOUS:
                q[k, j] = q[k, j] * viscosity
            elif parts[j] == YIELD:
                q[k, j] = q[k, j] * yield_stress


EFFECT = Effect(
    id="temperature_dependence",
    title="Temperature dependence",
    phrase="the viscous force falls by {viscous:%} and the yield force by {yield_force:%} as the damper warms up",
    stage="fluid",
    equation="viscous part exp(-a (T - T_r)) + yield part (1 - b (T - T_r)) + rest, T as measured",
    source="carrier oils: viscosity falls by 1-4 % per K (Reynolds 1886, eta = eta_r exp(-a (T - T_r))); yield stress of MR "
    "fluids: by some tenths of a per cent per K (Sahin, Wang & Gordaninejad 2009)",
    parameters=PARAMETERS,
    typical={"viscous": 0.015, "yield_force": 0.003},
    symptom="the force changes in the course of a run",
    signature="a force that falls as the recorded temperature rises, by other shares at high speed and at high current",
    confused_with=("thermal_fade", "settling", "load_cell_drift", "load_cell_gain"),
    separated_by="a run repeated hot and cold, the damper being heated from outside",
    shows=("time",),
    needs=("changing temperature",),
    imitated_by=(),
    coefficients=_scale,
)
