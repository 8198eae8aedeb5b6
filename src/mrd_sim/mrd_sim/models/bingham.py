"""Bingham model: Coulomb friction beside a dashpot."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import OFFSET, VISCOUS, YIELD_FORCE


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = q[k, 0] * tanh(v[k] / q[k, 2]) + q[k, 1] * v[k] + q[k, 3]


MODEL = DamperModel(
    id="bingham",
    title="Bingham",
    equation="F = f_c tanh(x' / v_e) + c0 x' + f0, tanh standing for the sign within the creep speed v_e",
    source="Stanway, Sproston & Stevens (1985, 1987)",
    quantities=(
        replace(YIELD_FORCE, symbol="f_c", meaning="Coulomb force", default=100.0, multiplies="term"),
        replace(VISCOUS, default=1000.0),
        Quantity("creep_speed", "v_e", "m/s", "speed at which friction is 76 % developed", 2e-3, 5e-4, 5e-3, log=True),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
)
