"""Algebraic model of Guo, Yang & Pan: a hyperbolic tangent of velocity and position."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import OFFSET, STIFFNESS, VISCOUS, YIELD_FORCE


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = q[k, 0] * tanh(q[k, 1] * v[k] + q[k, 2] * x[k]) + q[k, 3] * v[k] + q[k, 4] * x[k] + q[k, 5]


MODEL = DamperModel(
    id="algebraic",
    title="Algebraic (Guo)",
    equation="F = f_I tanh(a1 x' + a2 x) + b1 x' + b2 x + f0, x from the middle of the stroke",
    source="Guo, Yang & Pan, Veh. Syst. Dyn. 44 (2006); a1 and a2 constant over current there",
    quantities=(
        replace(YIELD_FORCE, symbol="f_I", meaning="yield force", default=100.0, multiplies="term"),
        Quantity(
            "steepness",
            "a1",
            "s/m",
            "slope of the yielding over velocity",
            100.0,
            5.0,
            1000.0,
            (-40.0, -500.0, 500.0),
            log=True,
        ),
        Quantity(
            "position_weight",
            "a2",
            "1/m",
            "width of the hysteresis, per distance from the middle",
            50.0,
            0.0,
            500.0,
            (0.0, -500.0, 500.0),
        ),
        replace(VISCOUS, symbol="b1"),
        replace(STIFFNESS, symbol="b2"),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
)
