"""Bingham model: Coulomb friction in parallel with a dashpot."""

from dataclasses import replace

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import PRELOAD, VISCOUS, YIELD_FORCE
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (
    replace(YIELD_FORCE, symbol="f_c", meaning="Coulomb force", default=100.0, multiplies="term"),
    replace(VISCOUS, default=1000.0),
    Coefficient("creep_speed", "v_e", "m/s", "speed at which friction is 76 % developed", 2e-3, 5e-4, 5e-3, log=True),
    PRELOAD,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        force[k] = c.yield_force * tanh(v[k] / c.creep_speed) + c.viscous * v[k] + c.offset


MODEL = DamperModel(
    id="bingham",
    title="Bingham",
    equation="F = f_c tanh(x' / v_e) + c0 x' + f0, tanh standing for the sign within the creep speed v_e",
    source="Stanway, Sproston & Stevens (1985, 1987)",
    coefficients=COEFFICIENTS,
    kernel=_force,
)
