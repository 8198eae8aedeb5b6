"""Mass between damper and load cell, and inertia of the fluid."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (Parameter("mass", "kg", 0.0, -40.0, 40.0, "moving mass and inertance, m"),)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        force[k] += p.mass * a[k]


EFFECT = Effect(
    id="moving_mass",
    title="Moving mass",
    phrase="the model leaves out a moving mass of {mass}",
    stage="structure",
    equation="F + m x''",
    source="rod and clevis 0.3-1.5 kg; inertance of the fluid rho L A_p² / A_g 0.2-1 kg",
    parameters=PARAMETERS,
    typical={"mass": 1.5},
    signature="force in phase with acceleration, growing with the square of frequency",
    confused_with=("gas_spring", "channel_delay", "force_sensor_lag"),
    separated_by="three or more frequencies at one amplitude",
    shows=("acceleration",),
    kernel=_apply,
)
