"""Polynomial in velocity with one branch for rising and one for falling velocity."""

from numba import njit

from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel

DEGREE = 5
TERMS = DEGREE + 1
SPEED = Coefficient(
    "reference_speed", "v_r", "m/s", "speed to which powers of velocity are relative", 0.1, 0.1, 0.1, free=False
)
"""With it, all other coefficients are forces of like size."""


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    # The branch for rising velocity comes first, each with its coefficients by rising power.
    for k in range(len(x)):
        first = 0 if a[k].real >= 0.0 else TERMS
        s = v[k] / q[k, 2 * TERMS]
        total = 0.0 * q[k, 0]
        for i in range(TERMS - 1, -1, -1):
            total = total * s + q[k, first + i]
        force[k] = total


def _branch(name: str, condition: str) -> tuple[Coefficient, ...]:
    return tuple(
        Coefficient(
            f"a{i}_{name}",
            f"a{i}^{name}",
            "N",
            f"coefficient of (x'/v_r)^{i} while velocity {condition}",
            100.0 if i == 1 else 0.0,
            -2000.0,
            2000.0,
            (500.0 if i == 1 else 0.0, -4000.0, 4000.0),
            multiplies="term",
            part="viscous" if i else "yield",
        )
        for i in range(TERMS)
    )


MODEL = DamperModel(
    id="polynomial",
    title="Two-branch polynomial",
    equation="F = sum_i a_i^± (x' / v_r)^i, + for x'' >= 0 and - for x'' < 0",
    source="Choi, Lee & Park (2001), degree 6; Tianjun & Changfu (2009), degree 5 as here",
    coefficients=(*_branch("rising", "rises"), *_branch("falling", "falls"), SPEED),
    kernel=_force,
    dissipative=False,
    odd=False,
)
