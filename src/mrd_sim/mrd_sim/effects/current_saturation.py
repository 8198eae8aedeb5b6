"""Saturation of the magnetic circuit and of the fluid's yield stress over current."""

from numba import njit

from mrd_sim.dual import absolute, tanh
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

SMALL = 0.03
"""Largest z = s u at which four terms of the series of tanh(z)/z are exact to 1e-14."""

PARAMETERS = (
    Parameter("inverse_current", "1/A", 0.0, 0.0, 2.0, "s, one over the current I_s of saturation"),
    Parameter("circuit", "", 0.0, 0.0, 1.0, "share of the saturation that is the magnetic circuit's, m"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(u)):
        z = p.inverse_current * u[k]
        if -SMALL < z.real < SMALL:
            # The series of tanh(z) / z, which also holds at s = 0.
            w = z * z
            bent = 1.0 - w * (1.0 / 3.0 - w * (2.0 / 15.0 - w * (17.0 / 315.0)))
        else:
            bent = tanh(z) / z
        u[k] *= bent + p.circuit * (1.0 / (1.0 + absolute(z)) - bent)


EFFECT = Effect(
    id="current_saturation",
    title="Saturation over current",
    phrase="the force saturates over the current, with a saturation current of {inverse_current:inverse}",
    stage="magnetics",
    equation="u = (1 - m) tanh(s I) / s + m I / (1 + s |I|), s = 1 / I_s",
    source="Carlson: yield stress over field is a tanh; Fröhlich (1881): flux of a circuit over current; I_s of 1 to 2.5 A",
    parameters=PARAMETERS,
    typical={"inverse_current": 0.8, "circuit": 0.3},
    symptom="the force grows in another way with the current",
    signature="the force grows less and less with current, at any speed",
    confused_with=("magnetic_hysteresis", "current_sensor_error", "cavitation", "thermal_fade"),
    separated_by="a short staircase of current up to 2 A",
    shows=("current",),
    needs=("several currents",),
    imitated_by=("clipped force", "clipped current"),
    kernel=_apply,
)
