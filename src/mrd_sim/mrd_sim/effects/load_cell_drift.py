"""Offset of the load cell's zero, and its drift.

Time goes on from one path to the next; pauses between them do not count.
"""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("drift", "N/s", 0.0, -0.6, 0.6, "change d of the zero over time"),
    Parameter("offset", "N", 0.0, -150.0, 150.0, "zero b at the start of the first recording"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    time = state[0]
    for k in range(len(force)):
        time += dt[k]
        force[k] += p.offset + p.drift * time
    state[0] = time


EFFECT = Effect(
    id="load_cell_drift",
    title="Drift of the load cell's zero",
    phrase="the load cell's zero is off by {offset} and drifts by {drift}",
    stage="sensing",
    equation="F + b + d t, t from the start of the first recording",
    source="load cells of 100 kg: zero ±5 N after mounting, 0.02-0.05 % of full scale over 10 K, ±0.2 N/min",
    parameters=PARAMETERS,
    typical={"drift": 0.02, "offset": 5.0},
    symptom="the force changes in the course of a run",
    signature="an offset of the force that grows with time, whatever motion and current",
    confused_with=("gas_spring", "thermal_fade", "load_cell_gain", "mains_hum"),
    separated_by="the free rod before and after the runs; dead weights",
    shows=("time",),
    imitated_by=(),
    kernel=_apply,
    states=1,
    outlasts_run=True,
)
