"""Linear viscous damper."""

from dataclasses import replace

from numba import njit

from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import PRELOAD, VISCOUS
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (replace(VISCOUS, symbol="c", default=4000.0, upper=5e4, per_ampere=(8000.0, 0.0, 1e5)), PRELOAD)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        force[k] = c.viscous * v[k] + c.offset


MODEL = DamperModel(
    id="linear_viscous",
    title="Linear viscous",
    equation="F = c x' + f0",
    source="equivalent viscous damping; first row of the table of models in the paper that this bench follows, "
    "Characterization and Testing Bench Design for Magnetorheological Dampers, its dashpot set apart",
    coefficients=COEFFICIENTS,
    kernel=_force,
)
