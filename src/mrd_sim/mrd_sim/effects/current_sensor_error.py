"""Offset and gain of the current sensor."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("offset", "A", 0.0, -0.2, 0.2, "reading without current, b"),
    Parameter("gain", "", 0.0, -0.1, 0.1, "relative excess of the reading, g"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(u)):
        u[k] = (u[k] - p.offset) / (1.0 + p.gain)


EFFECT = Effect(
    id="current_sensor_error",
    title="Error of the current sensor",
    phrase="the current sensor has an offset of {offset} and a gain error of {gain:%}",
    stage="magnetics",
    equation="I = (I_m - b) / (1 + g), from the measured current I_m to the true one",
    source="Allegro ACS714: ±1.5 %, zero ±30 mA",
    parameters=PARAMETERS,
    typical={"offset": 0.03, "gain": 0.03},
    symptom="the force grows in another way with the current",
    signature="the force of another current, most visible where the force grows fastest with current",
    confused_with=("magnetic_hysteresis", "current_saturation", "load_cell_gain", "seal_friction"),
    separated_by="a recording without current; a reading of the current by a shunt",
    shows=("current",),
    needs=("several currents",),
    imitated_by=("clipped current",),
    kernel=_apply,
)
