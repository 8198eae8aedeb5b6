"""Hyperbolic tangent model of Kwok et al."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import CENTRE, PRELOAD, STIFFNESS, VISCOUS, YIELD_FORCE
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (
    replace(
        YIELD_FORCE,
        name="hysteretic_force",
        symbol="alpha",
        meaning="height of the hysteresis",
        default=100.0,
        multiplies="term",
        law="quadratic",
    ),
    Coefficient("steepness", "beta", "s/m", "slope over velocity", 100.0, 5.0, 1000.0, (-40.0, -500.0, 500.0), log=True),
    Coefficient("loop_width", "delta", "", "width of the hysteresis", 0.58, 0.0, 3.0, (0.3, -3.0, 3.0)),
    replace(VISCOUS, symbol="c", meaning="viscous coefficient", default=1200.0),
    replace(STIFFNESS, symbol="k", law="affine"),
    PRELOAD,
    CENTRE,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        place = x[k].real - c.centre.real
        side = 1.0 if place > 0.0 else -1.0 if place < 0.0 else 0.0
        force[k] = (
            c.hysteretic_force * tanh(c.steepness * v[k] + c.loop_width * side)
            + c.viscous * v[k]
            + c.stiffness * x[k]
            + c.offset
        )


MODEL = DamperModel(
    id="hyperbolic_tangent",
    title="Hyperbolic tangent (Kwok)",
    equation="F = alpha tanh(beta x' + delta sgn(x - x_m)) + c x' + k x + f0, x_m the middle of the strokes",
    source="Kwok et al., Sens. Actuators A 132 (2006) 441; alpha quadratic and beta constant over current there",
    coefficients=COEFFICIENTS,
    kernel=_force,
)
