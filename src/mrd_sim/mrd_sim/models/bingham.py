"""Bingham model: Coulomb friction beside a dashpot."""

import math

from numba import njit

from mrd_sim.models.model import Array, DamperModel, Quantity


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = q[k, 0] * math.tanh(v[k] / q[k, 2]) + q[k, 1] * v[k] + q[k, 3]


MODEL = DamperModel(
    id="bingham",
    title="Bingham",
    equation="F = f_c tanh(x' / v_e) + c0 x' + f0, tanh standing for the sign within the creep speed v_e",
    source="Stanway, Sproston & Stevens (1985, 1987)",
    quantities=(
        Quantity("yield_force", "f_c", "N", "Coulomb force", 100.0, 0.0, 1500.0, (900.0, 0.0, 3000.0)),
        Quantity("viscous", "c0", "N s/m", "post-yield viscous coefficient", 1000.0, 0.0, 2e4, (2500.0, 0.0, 2e4)),
        Quantity("creep_speed", "v_e", "m/s", "speed at which friction is 76 % developed", 2e-3, 5e-4, 5e-3, log=True),
        Quantity("offset", "f0", "N", "constant force (gas preload)", 0.0, -300.0, 300.0),
    ),
    kernel=_force,
)
