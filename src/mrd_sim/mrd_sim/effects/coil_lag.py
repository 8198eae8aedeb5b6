"""Lag of the yield force behind the coil current: inductance, eddy currents, particles forming chains."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.lag import decay, follow
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("lag", "s", 0.0, 0.0, 0.06, "time constant while the current rises", absolute="electrical"),
    Parameter("falling", "", 0.0, -0.5, 3.0, "relative excess of the time constant while the current falls"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    lagged, before = state[0], state[1]
    for k in range(len(u)):
        now = u[k]
        if dt[k] == 0.0:
            lagged = now + 0.0 * p.lag
        else:
            # The effective current rises while the measured one is above it.
            lag = p.lag if now.real >= lagged.real else p.lag * (1.0 + p.falling)
            lagged = follow(lagged, before, now, lag / dt[k], decay(dt[k], lag))
        before = now + 0.0 * p.lag
        u[k] = lagged
    state[0], state[1] = lagged, before


EFFECT = Effect(
    id="coil_lag",
    title="Lag behind the coil current",
    phrase="the damper's force lags its current by {lag}",
    stage="magnetics",
    equation="u' = (I - u) / tau while the current rises, / (tau (1 + r)) while it falls",
    source="Spencer et al. (1997): 5.3 ms; Koo, Goncalves & Ahmadian (2006)",
    parameters=PARAMETERS,
    typical={"lag": 0.015, "falling": 0.3},
    symptom="the force depends on the current of a moment before",
    signature="the force follows a change of current late, at any speed of the rod",
    confused_with=("magnetic_hysteresis", "channel_delay", "force_sensor_lag"),
    separated_by="steps of current at several constant speeds",
    shows=("step",),
    needs=("changing current",),
    imitated_by=("timing", "clocks"),
    kernel=_apply,
    states=2,
)
