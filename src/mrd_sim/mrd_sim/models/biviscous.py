"""Biviscous model: one viscosity below the yield speed, another above."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import clip
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import PRELOAD, VISCOUS, YIELD_FORCE
from mrd_sim.named import named_row, tuple_type

YIELD_SPEED = Coefficient(
    "yield_speed", "v_y", "m/s", "speed at which the fluid yields", 0.01, 5e-4, 0.2, (0.01, -0.2, 0.2), log=True
)

COEFFICIENTS = (
    replace(YIELD_FORCE, multiplies="term", meaning="yield force"),
    YIELD_SPEED,
    replace(VISCOUS, symbol="C_po"),
    PRELOAD,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        force[k] = c.yield_force * clip(v[k] / c.yield_speed, -1.0, 1.0) + c.viscous * v[k] + c.offset


MODEL = DamperModel(
    id="biviscous",
    title="Biviscous",
    equation="F = C_po x' + F_y clip(x' / v_y, -1, 1) + f0, viscosity C_pr = C_po + F_y / v_y before yield",
    source="Stanway, Sproston & El-Wahed (1996); Wereley, Pang & Kamath, J. Intell. Mater. Syst. Struct. 9 (1998) 642",
    coefficients=COEFFICIENTS,
    kernel=_force,
)
