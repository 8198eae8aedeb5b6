"""Spring beside the damper that hardens with its deflection, such as a rubber bush or a guide that bends."""

from numba import njit

from mrd_sim.dual import absolute, power
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("force", "N", 0.0, 0.0, 3e3, "force at the deflection, F_d"),
    Parameter("exponent", "1", 3.0, 1.5, 7.0, "n; 3 is Duffing's spring"),
    Parameter("deflection", "m", 0.01, 0.01, 0.01, "distance from the centre at which this is the force, d", free=False),
    Parameter("centre", "m", 0.0, -0.025, 0.025, "position at which it is relaxed, x_c", place="centre"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        deflection = x[k] - p.centre
        spring = p.force * power(absolute(deflection) / p.deflection, p.exponent)
        force[k] += spring if deflection.real > 0.0 else -spring


EFFECT = Effect(
    id="hardening_spring",
    title="Hardening spring",
    phrase="a spring that presses with {force} at {deflection} hardens with the distance from where it is relaxed",
    stage="structure",
    equation="F + sgn(x - x_c) F_d (|x - x_c| / d)^n",
    source="Duffing (1918), with a free exponent; the linear part is the damper model's stiffness",
    parameters=PARAMETERS,
    typical={"force": 200.0, "exponent": 3.0, "centre": 0.0},
    symptom="a spring acts along the stroke",
    signature="force over position that bends up evenly on both sides of one place, at any speed and current",
    confused_with=("end_stop", "gas_spring", "side_load_friction", "lvdt_nonlinearity"),
    separated_by="slow strokes of several lengths, of which the short ones stay clear of any stop",
    shows=("end", "position"),
    imitated_by=("clipped position",),
    kernel=_apply,
)
