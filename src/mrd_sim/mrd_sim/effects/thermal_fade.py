"""Thermal fade: dissipated heat lowers the whole force, yield force included.

The heat capacity is one lump. Heat goes on from one path to the next; pauses between them do not count.
"""

from numba import njit

from mrd_sim.dual import exp
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("fade", "1/J", 0.0, 0.0, 1e-3, "share of the force that a unit of heat removes, b"),
    Parameter("cooling_time", "s", 400.0, 30.0, 3000.0, "time constant of cooling, t_c", log=True, absolute="thermal"),
    Parameter("coil_resistance", "Ohm", 5.0, 5.0, 5.0, "R; 5 Ohm of a RD-8040-1 at room temperature", free=False),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    heat = state[0]
    for k in range(len(x)):
        force[k] *= exp(-p.fade * heat)
        heat += dt[k] * (force[k] * v[k] + p.coil_resistance * u[k] * u[k] - heat / p.cooling_time)
        if heat.real < 0.0:  # power that springs give back does not cool
            heat *= 0.0
    state[0] = heat


EFFECT = Effect(
    id="thermal_fade",
    title="Thermal fade",
    phrase="the force falls by {fade:%} as the damper heats up",
    stage="fluid",
    equation="F exp(-b E), E' = F x' + R u² - E / t_c, E = C (T - T_a) >= 0",
    source="Sahin, Cesmeci & Wereley; C 300-600 J/K, loss 0.5-1.5 W/K, 0.1-2.5 % of the force per K",
    parameters=PARAMETERS,
    typical={"fade": 6e-5, "cooling_time": 400.0},
    symptom="the force changes in the course of a run",
    signature="a force that falls over minutes with the dissipated energy, faster in hard runs",
    confused_with=("settling", "load_cell_drift", "load_cell_gain"),
    separated_by="a reference run repeated hot and cold, with a rest in between",
    shows=("time",),
    imitated_by=(),
    kernel=_apply,
    states=1,
    outlasts_run=True,
)
