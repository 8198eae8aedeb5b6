"""Lag of load cell and amplifier."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.lag import decay, follow
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (Parameter("lag", "s", 0.0, 0.0, 0.03, "time constant tau", absolute="electronic"),)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    lag = p.lag
    read, before = state[0], state[1]
    for k in range(len(force)):
        now = force[k]
        read = now if dt[k] == 0.0 else follow(read, before, now, lag / dt[k], decay(dt[k], lag))
        before = now
        force[k] = read
    state[0], state[1] = read, before


EFFECT = Effect(
    id="force_sensor_lag",
    title="Lag of the force sensor",
    phrase="the force sensor lags by {lag}",
    stage="sensing",
    equation="y' = (F - y) / tau",
    source="amplifiers of load cells: 0.2-16 ms",
    parameters=PARAMETERS,
    typical={"lag": 0.005},
    symptom="the measured force is late",
    signature="force loops that open with frequency; rounded corners of the force",
    confused_with=("channel_delay", "coil_lag", "series_compliance", "moving_mass", "rate_dependent_hysteresis"),
    separated_by="chirp against a stiff spring; steps of current during fast motion",
    shows=("reversal", "step"),
    imitated_by=("timing", "clocks"),
    kernel=_apply,
    follows_force=True,
    states=2,
)
