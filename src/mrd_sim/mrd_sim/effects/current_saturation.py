"""Saturation of the magnetic circuit and of the fluid's yield stress over current."""

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.parameter import Parameter


@njit(cache=True, nogil=True)
def _apply(p: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    for k in range(len(u)):
        z = p[0] * u[k]
        if -0.03 < z.real < 0.03:
            # tanh(z) / z by its series: neutral at s = 0.
            w = z * z
            u[k] = u[k] * (1.0 - w * (1.0 / 3.0 - w * (2.0 / 15.0 - w * (17.0 / 315.0))))
        else:
            u[k] = tanh(z) / p[0]


EFFECT = Effect(
    id="current_saturation",
    title="Saturation over current",
    phrase="the force saturates over the current, on the scale of {inverse_current:inverse}",
    stage="magnetics",
    equation="u = tanh(s I) / s, s = 1 / I_s",
    source="Carlson: yield stress over field is a tanh; I_s of 1 to 2.5 A",
    parameters=(Parameter("inverse_current", "1/A", 0.0, 0.0, 2.0, "s, one over the current I_s of saturation"),),
    typical={"inverse_current": 0.8},
    signature="the force grows less and less with current, at any speed",
    confused_with=("magnetic_hysteresis", "current_sensor_error", "cavitation", "thermal_fade"),
    separated_by="staircase of current up to 2 A, briefly",
    kernel=_apply,
)
