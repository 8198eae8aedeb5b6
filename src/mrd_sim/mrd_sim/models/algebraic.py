"""Algebraic model of Guo, Yang & Pan: a hyperbolic tangent of velocity and position."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import CENTRE, PRELOAD, STIFFNESS, VISCOUS, YIELD_FORCE
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (
    replace(YIELD_FORCE, symbol="f_I", meaning="yield force", default=100.0, multiplies="term"),
    Coefficient(
        "steepness", "a1", "s/m", "slope of the yielding over velocity", 100.0, 5.0, 1000.0, (-40.0, -500.0, 500.0), log=True
    ),
    Coefficient(
        "position_weight", "a2", "1/m", "width of the hysteresis over position", 50.0, 0.0, 500.0, (0.0, -500.0, 500.0)
    ),
    replace(VISCOUS, symbol="b1"),
    replace(STIFFNESS, symbol="b2"),
    PRELOAD,
    CENTRE,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        force[k] = (
            c.yield_force * tanh(c.steepness * v[k] + c.position_weight * (x[k] - c.centre))
            + c.viscous * v[k]
            + c.stiffness * x[k]
            + c.offset
        )


MODEL = DamperModel(
    id="algebraic",
    title="Algebraic (Guo)",
    equation="F = f_I tanh(a1 x' + a2 (x - x_m)) + b1 x' + b2 x + f0, x_m the middle of the strokes",
    source="Guo, Yang & Pan, Veh. Syst. Dyn. 44 (2006); a1 and a2 constant over current there",
    coefficients=COEFFICIENTS,
    kernel=_force,
)
