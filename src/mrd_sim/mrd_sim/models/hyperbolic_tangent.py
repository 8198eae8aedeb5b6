"""Hyperbolic tangent model of Kwok et al."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import OFFSET, STIFFNESS, VISCOUS, YIELD_FORCE


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        side = 1.0 if x[k].real > 0.0 else -1.0 if x[k].real < 0.0 else 0.0
        force[k] = q[k, 0] * tanh(q[k, 1] * v[k] + q[k, 2] * side) + q[k, 3] * v[k] + q[k, 4] * x[k] + q[k, 5]


MODEL = DamperModel(
    id="hyperbolic_tangent",
    title="Hyperbolic tangent (Kwok)",
    equation="F = alpha tanh(beta x' + delta sgn x) + c x' + k x + f0, x from the middle of the stroke",
    source="Kwok et al., Sens. Actuators A 132 (2006) 441; alpha quadratic and beta constant over current there",
    quantities=(
        replace(
            YIELD_FORCE,
            name="hysteretic_force",
            symbol="alpha",
            meaning="height of the hysteresis",
            default=100.0,
            multiplies="term",
            law="quadratic",
        ),
        Quantity(
            "steepness",
            "beta",
            "s/m",
            "slope of the hysteresis over velocity",
            100.0,
            5.0,
            1000.0,
            (-40.0, -500.0, 500.0),
            log=True,
        ),
        Quantity("loop_width", "delta", "", "width of the hysteresis", 0.58, 0.0, 3.0, (0.3, -3.0, 3.0)),
        replace(VISCOUS, symbol="c", meaning="viscous coefficient", default=1200.0),
        replace(STIFFNESS, symbol="k", law="affine"),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
)
