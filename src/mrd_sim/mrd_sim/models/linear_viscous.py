"""Linear viscous damper."""

from dataclasses import replace

from numba import njit

from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.quantities import OFFSET, VISCOUS


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = q[k, 0] * v[k] + q[k, 1]


MODEL = DamperModel(
    id="linear_viscous",
    title="Linear viscous",
    equation="F = c x' + f0",
    source="equivalent viscous damping; first row of the table of models in the followed paper, its dashpot set apart",
    quantities=(
        replace(VISCOUS, symbol="c", default=4000.0, upper=5e4, per_ampere=(8000.0, 0.0, 1e5)),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
)
