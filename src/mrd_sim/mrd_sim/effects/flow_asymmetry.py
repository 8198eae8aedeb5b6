"""Flow asymmetry: more force in one direction of motion than in the other."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.lag import lagged_direction
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("asymmetry", "", 0.0, -0.3, 0.3, "relative excess of the force in extension, eps"),
    Parameter("turning", "m", 1.5e-4, 1e-5, 2e-3, "travel after a reversal over which the flow turns, x_t", log=True),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        force[k] *= 1.0 + p.asymmetry * lagged_direction(state, dt[k], x[k], p.turning)


EFFECT = Effect(
    id="flow_asymmetry",
    title="Asymmetry of extension and compression",
    phrase="the force differs by {asymmetry:%} in extension and by as much the other way in compression",
    stage="fluid",
    equation="F (1 + eps w), dw / d|x| = (sgn x' - w) / x_t: the flow turns once the fluid has yielded, not with the rod",
    source="0-15 % between directions in measured dampers of this class",
    parameters=PARAMETERS,
    typical={"asymmetry": 0.1, "turning": 1.5e-4},
    symptom="extension and compression differ",
    signature="the force in one direction is larger by the same share at every speed and current",
    confused_with=("cavitation", "load_cell_drift", "gas_spring"),
    separated_by="both directions at several currents and speeds",
    shows=(),  # once the yield force is the mean of both directions, both err by as much
    imitated_by=("clipped force",),
    kernel=_apply,
    states=2,
)
