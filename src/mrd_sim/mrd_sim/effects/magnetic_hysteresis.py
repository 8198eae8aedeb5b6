"""Remanence of the magnetic circuit: the field lags behind the current by half the width of its loop."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

# Widths of the domains over their mean at full spread: middles of the quintiles of an exponential distribution.
_WIDEST = (0.113, 0.382, 0.742, 1.289, 2.474)
_DOMAINS = len(_WIDEST)

PARAMETERS = (
    Parameter("half_width", "A", 0.0, 0.0, 0.4, "half width r of the loop over current"),
    Parameter("spread", "", 0.5, 0.0, 1.0, "relative spread of the domains' widths, s: how round the loop is"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    # A state of zero is that of a demagnetised circuit. What an earlier path has left stays.
    for k in range(len(u)):
        total = 0.0 * p.half_width
        for i in range(_DOMAINS):
            width = p.half_width * (1.0 + p.spread * (_WIDEST[i] - 1.0))
            low, high = u[k] - width, u[k] + width
            if state[i].real < low.real:
                state[i] = low
            elif state[i].real > high.real:
                state[i] = high
            total += state[i]
        u[k] = total / _DOMAINS


EFFECT = Effect(
    id="magnetic_hysteresis",
    title="Magnetic hysteresis",
    phrase="magnetic hysteresis holds the effective current back by {half_width}",
    stage="magnetics",
    equation="u: mean of five plays w = min(I + r_i, max(I - r_i, w before)), r_i of mean r and spread s; demagnetised",
    source="play operators: Krasnosel'skii & Pokrovskii (1989); Prandtl-Ishlinskii; remanent force 10-60 N",
    parameters=PARAMETERS,
    typical={"half_width": 0.04, "spread": 0.5},
    symptom="the force depends on the current of a moment before",
    signature="a force that depends on whether the current rose or fell to its value; some of it is left at 0 A",
    confused_with=("coil_lag", "current_sensor_error", "current_saturation", "seal_friction", "thermal_fade"),
    separated_by="a staircase of current up and down at constant speed, with demagnetisation afterwards",
    shows=("step", "current"),
    needs=("changing current",),
    imitated_by=("timing", "clipped current"),
    kernel=_apply,
    states=_DOMAINS,
    outlasts_run=True,
)
