"""Mains hum on the force channel."""

import math

import numpy as np
from numba import njit

from mrd_runs.signals.mains import MAINS_LINES
from mrd_sim.dual import cos
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter
from mrd_sim.path import Path

_TURN = 2.0 * math.pi
_STATES = 1 + 3 * len(MAINS_LINES)

PARAMETERS = (
    Parameter("amplitude", "N", 0.0, 0.0, 200.0, "amplitude a"),
    Parameter("frequency", "Hz", MAINS_LINES[0], 45.0, 125.0, "frequency f", free=False, absolute="that of the grid"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    # The state holds the time and, for each line of the mains, its frequency, the recorded deviation and phase.
    time, nearest = state[0], 1
    for line in range(1, _STATES, 3):
        if abs((p.frequency - state[line]).real) < abs((p.frequency - state[nearest]).real):
            nearest = line
    frequency, start = p.frequency + state[nearest + 1], state[nearest + 2]
    for k in range(len(force)):
        time = time + dt[k] if dt[k] > 0.0 else 0.0 * time
        force[k] += p.amplitude * cos(_TURN * frequency * time + start)
    state[0] = time


def _begin(path: Path) -> Array:
    lines = zip(MAINS_LINES, path.mains, strict=True)
    return np.concatenate([[0.0], *([nominal, line.frequency - nominal, line.phase] for nominal, line in lines)])


EFFECT = Effect(
    id="mains_hum",
    title="Mains hum",
    phrase="the force channel carries a mains hum of {amplitude:size} at {frequency}",
    stage="sensing",
    equation="F + a cos(2 pi f t + phi), t from the start of the recording, phi and the deviation of f as recorded, "
    "behind all delays",
    source="10-100 µV on 20 µV/N: 0.1-2 N; 50 or 60 Hz and their doubles, folded by slow sampling (50 Hz at 25 Hz: a bias)",
    parameters=PARAMETERS,
    typical={"amplitude": 2.0},
    variants=[{"frequency": frequency} for frequency in MAINS_LINES[1:]],
    signature="a spectral line at the mains frequency, whatever motion and current",
    confused_with=("servo_ripple", "load_cell_drift"),
    separated_by="a recording at rest, motor on and off; two sampling rates",
    shows=("frequency",),
    needs=("mains frequency",),
    kernel=_apply,
    states=_STATES,
    begin=_begin,
)
