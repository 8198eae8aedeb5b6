"""Gain of the load cell."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (Parameter("gain", "", 0.0, -0.2, 0.2, "relative excess of the reading, g"),)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(force)):
        force[k] *= 1.0 + p.gain


EFFECT = Effect(
    id="load_cell_gain",
    title="Gain of the load cell",
    phrase="the load cell's gain is off by {gain:%}",
    stage="sensing",
    equation="(1 + g) F",
    source="2 mV/V ± 10 % uncalibrated, ±2 % calibrated",
    parameters=PARAMETERS,
    typical={"gain": 0.05},
    symptom="the whole force has another size",
    signature="the force multiplied by one factor, whatever motion and current",
    confused_with=("load_cell_drift", "current_sensor_error", "lvdt_nonlinearity", "thermal_fade", "fluid_change"),
    separated_by="dead weights (recordings alone cannot tell it from a stronger damper)",
    shows=(),  # a factor on the whole force
    imitated_by=(),
    kernel=_apply,
)
