"""Bump stops near the ends of the stroke, each where it is."""

from numba import njit

from mrd_sim.dual import power
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("stiffness", "N/m²", 0.0, 0.0, 3e8, "force over the square of the depth, at the depth d, k"),
    Parameter("upper", "m", 0.024, 0.003, 0.03, "position beyond which the one for extension acts, x_u", place="centre"),
    Parameter("lower", "m", -0.024, -0.03, -0.003, "position below which the one for compression acts, x_l", place="centre"),
    Parameter("exponent", "1", 2.0, 1.0, 3.0, "n; 1 is a linear buffer, 1.5 a contact of spheres"),
    Parameter("depth", "m", 2e-3, 2e-3, 2e-3, "depth d at which the exponent does not change the force", free=False),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)

DISTANCES = (0.007, 0.0165, 0.026)
"""Distances in m from the middle of the strokes from which fits start, with stops at both ends or at one."""

NEVER_REACHED = 0.028
"""Distance in m from the middle of the strokes at which the other stop stands when a fit of one stop starts."""


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        extended = x[k].real > 0.5 * (p.upper.real + p.lower.real)
        depth = x[k] - p.upper if extended else p.lower - x[k]
        if depth.real > 0.0:
            stop = p.stiffness * p.depth * p.depth * power(depth / p.depth, p.exponent)
            force[k] += stop if extended else -stop


EFFECT = Effect(
    id="end_stop",
    title="End stop",
    phrase="an end stop acts from {upper} where the damper is extended and from {lower} where it is compressed",
    stage="structure",
    equation="F + k d² (<x - x_u> / d)^n - k d² (<x_l - x> / d)^n",
    source="Hunt & Crossley (1975), with a free exponent, without their damping; RD-8040-1: from ± 25 to 27.5 mm",
    parameters=PARAMETERS,
    typical={"stiffness": 5e6, "upper": 0.008, "lower": -0.008, "exponent": 2.0},
    variants=[
        {"upper": upper, "lower": -lower}
        for distance in DISTANCES
        for upper, lower in ((distance, distance), (distance, NEVER_REACHED), (NEVER_REACHED, distance))
    ],
    symptom="a spring acts along the stroke",
    signature="spikes of force near the ends of the stroke only, at any speed and current",
    confused_with=("hardening_spring", "gas_spring", "cavitation", "side_load_friction"),
    separated_by="the same speed on short strokes off the centre",
    shows=("end",),
    imitated_by=("clipped position",),
    kernel=_apply,
)
