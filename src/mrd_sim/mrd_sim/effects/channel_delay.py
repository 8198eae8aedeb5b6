"""Delay of the force channel against the others."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

_ROOM = 1024
"""Vertices in the ring buffer: the longest delay at 20 kHz, or at 2.5 kHz with the most vertices between samples."""
_TIMES = 3
_FORCES = _TIMES + _ROOM
"""Index in the state at which the ring buffer begins: times, then forces."""
_SAME_INSTANT = 1e-9
"""s. Vertices that are closer together count as one."""

PARAMETERS = (
    Parameter("delay", "s", 0.0, 0.0, 0.05, "delay T of the force behind position and current", absolute="electronic"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    # Vertices are numbered from the start of the path; `later` is the first that is not before the instant wanted.
    time, count, later = state[0].real, int(state[1].real), int(state[2].real)
    for k in range(len(force)):
        if dt[k] == 0.0:
            time, count, later = 0.0, 0, 0
        time += dt[k]
        if count > 0 and dt[k] < _SAME_INSTANT:
            # The vertex takes the place of the one before.
            state[_FORCES + (count - 1) % _ROOM] = force[k]
        else:
            state[_TIMES + count % _ROOM] = time
            state[_FORCES + count % _ROOM] = force[k]
            count += 1
        oldest = count - _ROOM if count > _ROOM else 0
        if later < oldest:
            later = oldest
        due = time - p.delay
        while later < count - 1 and state[_TIMES + later % _ROOM].real < due.real:
            later += 1
        end, at_end = state[_TIMES + later % _ROOM].real, state[_FORCES + later % _ROOM]
        if later == oldest or end < due.real:
            force[k] = at_end
        else:
            start, at_start = state[_TIMES + (later - 1) % _ROOM].real, state[_FORCES + (later - 1) % _ROOM]
            force[k] = at_end - (at_end - at_start) * (end - due) / (end - start)
    state[0], state[1], state[2] = time, count, later


EFFECT = Effect(
    id="channel_delay",
    title="Delay of the force channel",
    phrase="the force channel is late by {delay}",
    stage="sensing",
    equation="y(t) = F(t - T), F linear between samples; before the start, the first F",
    source="multiplexed scans 2.5-50 µs; channels read one after the other by software 5-40 ms",
    parameters=PARAMETERS,
    typical={"delay": 0.0085},
    symptom="the measured force is late",
    signature="force loops that open in proportion to the rate of force; a phase proportional to frequency",
    confused_with=("force_sensor_lag", "series_compliance", "moving_mass", "coil_lag", "rate_dependent_hysteresis"),
    separated_by="one event that all channels show; a chirp (phase over frequency); steps of current during fast motion",
    shows=("reversal", "step"),
    imitated_by=("timing", "clocks"),
    kernel=_apply,
    follows_force=True,
    states=_FORCES + _ROOM,
)
