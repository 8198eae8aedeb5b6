"""Settled particles: the first cycles after a rest need more force.

The travel goes on from one path to the next, as if there were no rest between them.
"""

from numba import njit

from mrd_sim.dual import absolute, exp, log
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("excess", "", 0.0, -0.05, 0.4, "relative excess of the force after a rest, s0"),
    Parameter("travel", "m", 0.3, 0.03, 2.0, "travel over which the excess would vanish at its first rate, D0", log=True),
    Parameter("order", "", 1.2, 1.01, 3.0, "order of the break-up, q"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    travelled, before = state[0], state[1]
    beyond = p.order - 1.0
    if dt[0] == 0.0:
        before = x[0] + 0.0 * p.excess
    for k in range(len(x)):
        travelled += absolute(x[k] - before)
        before = x[k] + 0.0 * p.excess
        force[k] *= 1.0 + p.excess * exp(-log(1.0 + beyond * travelled / p.travel) / beyond)
    state[0], state[1] = travelled, before


EFFECT = Effect(
    id="settling",
    title="Settled particles",
    phrase="after a rest the force is {excess:%} higher until the particles are stirred up",
    stage="fluid",
    equation="F (1 + s), ds/dD = -(s0 / D0) (s / s0)^q, s = s0 at rest, D = travel since then",
    source="7 % over the first four cycles of a measured damper; s0 0.02-0.2, D0 0.1-0.5 m; q = 1 is exponential",
    parameters=PARAMETERS,
    typical={"excess": 0.15, "travel": 0.3, "order": 1.2},
    symptom="the force changes in the course of a run",
    signature="a higher force in the first cycles after a rest, which falls with travel and not with energy or time",
    confused_with=("thermal_fade", "seal_friction", "load_cell_drift"),
    separated_by="runs after rests of different length; a repetition at the end",
    shows=("time",),
    imitated_by=(),
    kernel=_apply,
    states=2,
    outlasts_run=True,
)
