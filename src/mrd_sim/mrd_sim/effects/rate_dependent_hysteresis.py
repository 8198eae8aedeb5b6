"""Rate-dependent hysteresis: a viscous force that builds up and decays with a relaxation time.

It is a Maxwell element in parallel, a spring k in series with a dashpot c, less the viscous force c x' of the element at
constant speed. That steady part is the damper model's, whose viscosity is refitted. So the effect adds no steady force and
needs to know nothing of the damper model. It is integrated exactly, and dissipates together with a viscosity of c or more.
The alternative, a loop width v_h = v_0 + k_4 v_m that grows with peak speed, would change the equation of each model; at one
frequency both have the same lag with k_4 = 2 pi f tau.
"""

from numba import njit

from mrd_sim.dual import exp
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("viscous", "N s/m", 0.0, 0.0, 1e4, "viscous coefficient that relaxes, at 0 A, c"),
    Parameter("relaxation", "s", 0.015, 1e-3, 0.5, "relaxation time, tau", log=True),
    Parameter("growth", "1/A", 0.0, 0.0, 6.0, "relative growth of c over current, g"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    relaxed, before = state[0], state[1]
    for k in range(len(x)):
        now = v[k] + 0.0 * p.viscous
        if dt[k] == 0.0:
            relaxed = now
        else:
            ramp = (now - before) / dt[k] * p.relaxation
            relaxed = now - ramp + (relaxed - before + ramp) * exp(-dt[k] / p.relaxation)
        before = now
        force[k] += p.viscous * (1.0 + p.growth * u[k]) * (relaxed - now)
    state[0], state[1] = relaxed, before


EFFECT = Effect(
    id="rate_dependent_hysteresis",
    title="Rate-dependent hysteresis",
    phrase="part of the viscous coefficient, {viscous}, acts with a relaxation time of {relaxation}",
    stage="fluid",
    equation="F + c (1 + g u) (v_r - x'), tau v_r' = x' - v_r: a spring c / tau in series with the dashpot c0",
    source="Maxwell element; Gamota & Filisko (1991); loops widening with peak speed: Kwok et al. (2006)",
    parameters=PARAMETERS,
    typical={"viscous": 1000.0, "relaxation": 0.015, "growth": 2.0},
    symptom="the force develops in another way after a reversal",
    signature="a loop of force over velocity that widens with speed and frequency, while steps of current are not late",
    confused_with=("moving_mass", "force_sensor_lag", "channel_delay", "series_compliance", "bypass_flow"),
    separated_by="the same peak speed at different frequencies and strokes; steps of current",
    shows=("reversal", "acceleration"),
    kernel=_apply,
    states=2,
)
