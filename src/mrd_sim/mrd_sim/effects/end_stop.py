"""Bump stop near the ends of the stroke."""

from numba import njit

from mrd_sim.dual import absolute, power
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("stiffness", "N/m²", 0.0, 0.0, 3e8, "force over the square of the depth, at the depth d, k"),
    Parameter("limit", "m", 0.024, 0.003, 0.03, "distance from mid-stroke where it begins, x_b"),
    Parameter("exponent", "1", 2.0, 1.0, 3.0, "n; 1 is a linear buffer, 1.5 a contact of spheres"),
    Parameter("depth", "m", 2e-3, 2e-3, 2e-3, "depth d at which the exponent does not change the force", free=False),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        depth = absolute(x[k]) - p.limit
        if depth.real > 0.0:
            stop = p.stiffness * p.depth * p.depth * power(depth / p.depth, p.exponent)
            force[k] += stop if x[k].real > 0.0 else -stop


EFFECT = Effect(
    id="end_stop",
    title="End stop",
    phrase="an end stop acts from {limit} off mid-stroke",
    stage="structure",
    equation="F + sgn(x) k d² (<|x| - x_b> / d)^n",
    source="Hunt & Crossley (1975), with a free exponent, without their damping; RD-8040-1: from ± 25 to 27.5 mm",
    parameters=PARAMETERS,
    typical={"stiffness": 5e6, "limit": 0.008, "exponent": 2.0},
    symptom="a spring acts along the stroke",
    signature="spikes of force near the ends of the stroke only, at any speed and current",
    confused_with=("hardening_spring", "gas_spring", "cavitation", "side_load_friction"),
    separated_by="the same speed on short strokes off the centre",
    shows=("end",),
    imitated_by=("clipped position",),
    kernel=_apply,
)
