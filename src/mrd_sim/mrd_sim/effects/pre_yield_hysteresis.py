"""Pre-yield hysteresis, for damper models whose force is a function of speed: the force develops over travel."""

from numba import njit

from mrd_sim.dual import absolute
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.lag import decay, follow
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("yield_travel", "m", 0.0, 0.0, 3e-3, "travel over which the force develops at 0 A, x_y"),
    Parameter("growth", "1/A", 0.0, 0.0, 6.0, "relative growth of that travel over current, g"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    reached, before, place = state[0], state[1], state[2]
    for k in range(len(x)):
        now, here = force[k], x[k] + 0.0 * p.yield_travel
        travel = absolute(here - place)
        span = p.yield_travel * (1.0 + p.growth * u[k])
        if dt[k] == 0.0:
            reached = now
        elif travel.real > 0.0:
            reached = follow(reached, before, now, span / travel, decay(travel, span))
        before, place = now, here
        force[k] = reached
    state[0], state[1], state[2] = reached, before, place


EFFECT = Effect(
    id="pre_yield_hysteresis",
    title="Pre-yield hysteresis",
    stage="fluid",
    equation="dF_h / d|x| = (F - F_h) / (x_y (1 + g u)): the force follows the model's over some travel",
    source="Dahl (1968); around a Coulomb force it is Dahl's friction",
    parameters=PARAMETERS,
    typical={"yield_travel": 3e-4, "growth": 0.5},
    symptom="the force develops in another way after a reversal",
    signature="a force that develops with travel after a reversal: a loop around zero speed, wider with current",
    confused_with=("series_compliance", "joint_play", "backlash", "rate_dependent_hysteresis", "seal_friction"),
    separated_by="small strokes; the same peak speed at different frequencies",
    shows=("reversal", "step"),
    kernel=_apply,
    states=3,
    phrase="the force needs {yield_travel} of travel to develop after a reversal",
    structural=True,
)
