"""Linear viscous damper."""

from numba import njit

from mrd_sim.models.model import Array, DamperModel, Quantity


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
        Quantity("viscous", "c", "N s/m", "viscous coefficient", 4000.0, 0.0, 5e4, (8000.0, 0.0, 1e5)),
        Quantity("offset", "f0", "N", "constant force (gas preload)", 0.0, -300.0, 300.0),
    ),
    kernel=_force,
)
