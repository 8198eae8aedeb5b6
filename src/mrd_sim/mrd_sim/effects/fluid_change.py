"""Another fluid than before: new, settled out, degraded or diluted."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("gain", "", 0.0, -0.5, 0.5, "relative change of the force, g"),
    Parameter("viscous", "N s/m", 0.0, -6000.0, 6000.0, "change of the viscous coefficient, c"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(force)):
        force[k] = force[k] * (1.0 + p.gain) + p.viscous * v[k]


EFFECT = Effect(
    id="fluid_change",
    title="Change of the fluid",
    phrase="the fluid has changed: the force by {gain:%}, and its viscous coefficient by another {viscous}",
    stage="fluid",
    equation="F (1 + g) + c v",
    source="yield stress and viscosity grow with the share of particles; the parameters of any damper model hold both",
    parameters=PARAMETERS,
    typical={"gain": 0.1, "viscous": 0.0},
    symptom="the whole force has another size",
    signature="a force that differs from that of earlier recordings by one factor, and by a viscous force",
    confused_with=("load_cell_gain", "current_sensor_error", "lvdt_nonlinearity", "thermal_fade"),
    separated_by="dead weights on the load cell and a gauge beside the position transducer, before and after",
    shows=(),  # a factor on the whole force
    imitated_by=(),
    kernel=_apply,
    only_as_change=True,
)
