"""Remanence of the magnetic circuit: the field lags behind the current by half the width of its loop."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.parameter import Parameter


@njit(cache=True, nogil=True)
def _apply(p: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    # The state of a circuit without history, zero, is demagnetised; what is left of an earlier path stays.
    held = state[0]
    for k in range(len(u)):
        low, high = u[k] - p[0], u[k] + p[0]
        if held.real < low.real:
            held = low
        elif held.real > high.real:
            held = high
        u[k] = held
    state[0] = held


EFFECT = Effect(
    id="magnetic_hysteresis",
    title="Magnetic hysteresis",
    phrase="magnetic hysteresis holds the effective current back by {half_width}",
    stage="magnetics",
    equation="u = min(I + r, max(I - r, u before)), demagnetised at first",
    source="play operator: Krasnosel'skii & Pokrovskii (1989); remanent force 10-60 N",
    parameters=(Parameter("half_width", "A", 0.0, 0.0, 0.12, "half width r of the loop over current"),),
    typical={"half_width": 0.04},
    signature="at one current the force depends on whether the current rose or fell to it; some is left at 0 A",
    confused_with=("coil_lag", "current_sensor_error", "current_saturation", "seal_friction", "thermal_fade"),
    separated_by="staircase of current up and down at constant speed, then demagnetise",
    kernel=_apply,
    states=1,
    carries=True,
)
