"""Biviscous model: one viscosity below the yield speed, another above."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import clip
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import OFFSET, VISCOUS, YIELD_FORCE

YIELD_SPEED = Quantity(
    "yield_speed",
    "v_y",
    "m/s",
    "speed up to which the fluid has not yielded, F_y / (C_pr - C_po)",
    0.01,
    5e-4,
    0.2,
    (0.01, -0.2, 0.2),
    log=True,
)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = q[k, 0] * clip(v[k] / q[k, 1], -1.0, 1.0) + q[k, 2] * v[k] + q[k, 3]


MODEL = DamperModel(
    id="biviscous",
    title="Biviscous",
    equation="F = C_po x' + F_y clip(x' / v_y, -1, 1) + f0, viscosity C_pr = C_po + F_y / v_y before yield",
    source="Stanway, Sproston & El-Wahed (1996); Wereley, Pang & Kamath, J. Intell. Mater. Syst. Struct. 9 (1998) 642",
    quantities=(
        replace(YIELD_FORCE, multiplies="term", meaning="yield force"),
        YIELD_SPEED,
        replace(VISCOUS, symbol="C_po"),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
)
