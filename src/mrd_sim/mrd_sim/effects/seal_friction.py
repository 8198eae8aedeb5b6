"""Friction of the seals: Coulomb, with the Stribeck excess at low speed."""

from numba import njit

from mrd_sim.dual import exp
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.lag import lagged_direction
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("coulomb", "N", 0.0, 0.0, 400.0, "friction at high speed, F_c"),
    Parameter("stiction", "", 0.3, 0.0, 1.5, "relative excess at rest, s = F_s / F_c - 1"),
    Parameter("stribeck_speed", "m/s", 3e-3, 5e-4, 2e-2, "speed over which the excess vanishes, v_s", log=True),
    Parameter("presliding", "m", 3e-5, 5e-6, 2e-4, "travel over which the seal gives before it slides, x_p", log=True),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        slow = v[k] / p.stribeck_speed
        level = 1.0 + p.stiction * exp(-slow * slow)
        force[k] += p.coulomb * lagged_direction(state, dt[k], x[k], p.presliding, level)


EFFECT = Effect(
    id="seal_friction",
    title="Seal friction",
    phrase="the seal adds a friction of {coulomb}",
    stage="structure",
    equation="F + F_c w, dw / d|x| = (sgn x' - w / g) / x_p, g = 1 + s exp(-(x' / v_s)²)",
    source="as Canudas de Wit, Olsson, Åström & Lischinsky (1995), after Dahl (1968) and Stribeck (1902); 20-60 N",
    parameters=PARAMETERS,
    typical={"coulomb": 40.0, "stiction": 0.5, "stribeck_speed": 4e-3, "presliding": 3e-5},
    symptom="dry friction acts beside the damper",
    signature="a rectangle of force at every current, with a hump at reversals",
    confused_with=("settling", "shear_thinning", "pre_yield_hysteresis", "side_load_friction"),
    separated_by="ramps from 0.1 to 10 mm/s at 0 A",
    shows=("reversal",),
    kernel=_apply,
    states=2,
)
