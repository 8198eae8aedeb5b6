"""Position error that repeats with every tooth of rack and pinion."""

import math

import numpy as np
from numba import njit

from mrd_sim.dual import cos, sin
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

_TURN = 2.0 * math.pi  # rad

# In even steps of their number per stroke: between two, the phase at the ends of the stroke is off by less than 1 rad.
_PERIODS = [1.0 / number for number in np.linspace(1 / 0.05, 1 / 3e-3, 31)]

PARAMETERS = (
    Parameter("amplitude", "m", 0.0, 0.0, 4e-4, "amplitude a"),
    Parameter("phase", "rad", 0.0, 0.0, 2 * _TURN, "phase phi at mid-stroke; two turns, so that a fit can pass any"),
    Parameter("period", "m", 2e-3 * math.pi, 3e-3, 0.05, "travel lambda after which it repeats", log=True),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    number = _TURN / p.period
    for k in range(len(x)):
        angle = number * x[k] + p.phase
        error = p.amplitude * cos(angle)
        slope = 1.0 - number * p.amplitude * sin(angle)
        a[k] = slope * a[k] - number * number * error * v[k] * v[k]
        v[k] = slope * v[k]
        x[k] = x[k] + error


EFFECT = Effect(
    id="servo_ripple",
    title="Periodic error of the drive",
    phrase="the drive's position has a periodic error of {amplitude:size} along the travel",
    stage="drive",
    equation="x = x_m + a cos(2 pi x_m / lambda + phi), x_m the measured position",
    source="tooth pitch of module 2: 2 pi mm; pitch errors of racks and gears 1-20 µm",
    parameters=PARAMETERS,
    typical={"amplitude": 1.5e-5, "phase": math.pi, "period": 2e-3 * math.pi},
    variants=[{"period": period} for period in _PERIODS],
    signature="a ripple of speed and force that is locked to the position, so that its frequency grows with speed",
    confused_with=("mains_hum", "side_load_friction", "lvdt_nonlinearity"),
    separated_by="several constant speeds, by the frequency that follows the speed",
    shows=(),  # its period is a small part of any stroke
    kernel=_apply,
)
