"""Spring beside the damper that hardens with its deflection, such as a rubber bush or a guide that bends."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (Parameter("stiffness", "N/m³", 0.0, 0.0, 3e9, "force over the cube of the distance from mid-stroke, k_3"),)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        force[k] += p.stiffness * x[k] * x[k] * x[k]


EFFECT = Effect(
    id="hardening_spring",
    title="Hardening spring",
    phrase="a spring of {stiffness} hardens with the distance from mid-stroke",
    stage="structure",
    equation="F + k_3 x³",
    source="Duffing (1918); the linear part is the damper model's stiffness",
    parameters=PARAMETERS,
    typical={"stiffness": 2e8},
    signature="force over position that bends up evenly on both sides of mid-stroke, at any speed and current",
    confused_with=("end_stop", "gas_spring", "side_load_friction", "lvdt_nonlinearity"),
    separated_by="slow strokes of several lengths, of which the short ones stay clear of any stop",
    kernel=_apply,
)
