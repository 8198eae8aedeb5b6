"""Mains hum on the force channel."""

import math

import numpy as np
from numba import njit

from mrd_runs.signals.mains import MAINS
from mrd_sim.dual import cos
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter
from mrd_sim.path import Path

_TURN = 2.0 * math.pi

PARAMETERS = (
    Parameter("amplitude", "N", 0.0, 0.0, 200.0, "amplitude a"),
    Parameter("frequency", "Hz", MAINS[0], 45.0, 125.0, "frequency f", free=False),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    # The state holds the time, and the phase at the start for 50 and for 60 Hz.
    time, start = state[0], state[1] if abs(p.frequency - MAINS[0]) <= abs(p.frequency - MAINS[1]) else state[2]
    for k in range(len(force)):
        time = time + dt[k] if dt[k] > 0.0 else 0.0 * time
        force[k] += p.amplitude * cos(_TURN * p.frequency * time + start)
    state[0] = time


def _begin(path: Path) -> Array:
    return np.concatenate([[0.0], path.mains])


EFFECT = Effect(
    id="mains_hum",
    title="Mains hum",
    phrase="the force channel carries a mains hum of {amplitude:size} at {frequency}",
    stage="sensing",
    equation="F + a cos(2 pi f t + phi), t from the start of the recording, phi as recorded, behind all delays",
    source="10-100 µV on 20 µV/N: 0.1-2 N; 50 or 60 Hz and their doubles, folded by slow sampling (50 Hz at 25 Hz: a bias)",
    parameters=PARAMETERS,
    typical={"amplitude": 2.0},
    variants=({"frequency": MAINS[1]},),
    signature="a spectral line at the mains frequency, whatever motion and current",
    confused_with=("servo_ripple", "load_cell_drift"),
    separated_by="a recording at rest, motor on and off; two sampling rates",
    kernel=_apply,
    states=3,
    begin=_begin,
)
