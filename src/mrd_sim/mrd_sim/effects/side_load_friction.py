"""Friction that grows away from one place of the stroke: side load on a misaligned rod."""

from numba import njit

from mrd_sim.dual import absolute
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.lag import lagged_direction
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("slope", "N/m", 0.0, 0.0, 12000.0, "friction over the distance from the centre, F_1"),
    Parameter("centre", "m", 0.0, -0.025, 0.025, "position of the least friction, x_c", place="centre"),
    Parameter("presliding", "m", 3e-5, 5e-6, 2e-4, "travel over which the guide gives before it slides, x_p", log=True),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        force[k] += p.slope * absolute(x[k] - p.centre) * lagged_direction(state, dt[k], x[k], p.presliding)


EFFECT = Effect(
    id="side_load_friction",
    title="Side-load friction",
    phrase="side load adds friction that grows along the stroke by {slope}",
    stage="structure",
    equation="F + F_1 |x - x_c| w, dw / d|x| = (sgn x' - w) / x_p",
    source="misaligned clamping: 5-30 N across the stroke of measured dampers; presliding as Dahl (1968)",
    parameters=PARAMETERS,
    typical={"slope": 1500.0, "centre": 0.0, "presliding": 3e-5},
    symptom="dry friction acts beside the damper",
    signature="a bow tie of force over position: friction that varies along the stroke, at every current",
    confused_with=("gas_spring", "end_stop", "seal_friction", "servo_ripple"),
    separated_by="slow ramps over the whole stroke; the damper clamped again",
    shows=("end", "position"),
    imitated_by=(),
    kernel=_apply,
    states=2,
)
