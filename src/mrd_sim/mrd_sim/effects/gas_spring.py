"""Gas spring: the accumulator's pressure over the stroke, without the preload, which the damper model has."""

from numba import njit

from mrd_sim.dual import expm1, log
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

_KAPPA = 1.2
"""Polytropic exponent, between isothermal (1) and adiabatic (1.4). At a given curvature it hardly changes the curve."""
_LEAST_VOLUME = 0.1
"""Relative. No stroke compresses the gas to so small a volume; it keeps the logarithm finite."""

PARAMETERS = (
    Parameter("stiffness", "N/m", 0.0, 0.0, 3e4, "slope of the force over position at mid-stroke, k"),
    Parameter("curvature", "1/m", 12.0, 1.0, 30.0, "relative decrease of that slope per metre of extension, b"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    rate = p.curvature / (_KAPPA + 1.0)
    for k in range(len(x)):
        volume = 1.0 + rate * x[k]
        if volume.real < _LEAST_VOLUME:
            volume = _LEAST_VOLUME + 0.0 * volume
        force[k] -= p.stiffness / (_KAPPA * rate) * expm1(-_KAPPA * log(volume))


EFFECT = Effect(
    id="gas_spring",
    title="Gas spring",
    phrase="the gas charge acts as a spring of {stiffness}",
    stage="fluid",
    equation="F + k / (kappa s) [1 - (1 + s x)^-kappa], k = kappa A_r² P0 / V0, s = A_r / V0 = b / (kappa + 1), kappa = 1.2",
    source="polytropic accumulator; RD-8040-1: A_r = 78.5 mm², P0 0.6-2.1 MPa, V0 8-30 cm³",
    parameters=PARAMETERS,
    typical={"stiffness": 2000.0, "curvature": 15.0},
    symptom="a spring acts along the stroke",
    signature="a curved tilt of force over position, the same at every current and speed",
    confused_with=("end_stop", "load_cell_drift", "moving_mass", "side_load_friction"),
    separated_by="slow ramps over the whole stroke at 0 A, by the mean of both directions",
    shows=("end", "position"),
    imitated_by=(),
    kernel=_apply,
)
