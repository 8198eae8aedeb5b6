"""Shear thinning: the post-yield force grows less than in proportion to speed."""

from numba import njit

from mrd_sim.dual import absolute, power
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("viscous", "N s/m", 0.0, 0.0, 1e4, "viscous coefficient that becomes a power law, at 0 A, c"),
    Parameter("exponent", "", 0.7, 0.3, 1.0, "exponent of the speed, m"),
    Parameter("growth", "1/A", 0.0, 0.0, 6.0, "relative growth of c over current, g"),
    Parameter("reference_speed", "m/s", 0.1, 0.1, 0.1, "speed v_r at which the viscous force keeps its value", free=False),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        relative = v[k] / p.reference_speed
        bent = power(absolute(relative), p.exponent)
        if relative.real < 0.0:
            bent = -bent
        force[k] += p.viscous * (1.0 + p.growth * u[k]) * p.reference_speed * (bent - relative)


EFFECT = Effect(
    id="shear_thinning",
    title="Shear thinning",
    phrase="the fluid thins under shear: {viscous} of its viscosity follow a power law with the exponent {exponent}",
    stage="fluid",
    equation="F + c (1 + g u) (|x' / v_r|^(m-1) - 1) x': c0 x' becomes K |x'|^m sgn x' where c(u) = c0(u)",
    source="Herschel-Bulkley fluid; Wang & Gordaninejad (1999): m 0.6-0.95",
    parameters=PARAMETERS,
    typical={"viscous": 1000.0, "exponent": 0.7, "growth": 2.0},
    signature="a force over speed that is concave after yield, in both directions: higher in the middle, lower at top speed",
    confused_with=("seal_friction", "pre_yield_hysteresis", "thermal_fade", "bypass_flow"),
    separated_by="constant speeds from 1 mm/s to top speed, several per decade",
    shows=("velocity",),
    imitated_by=("timing", "clipped force"),
    kernel=_apply,
    coefficient="flow_index",
)
