"""Hysteretic biviscous model: the biviscous curve, moved aside by the sign of the acceleration."""

from collections.abc import Mapping
from dataclasses import replace

from numba import njit

from mrd_sim.dual import clip
from mrd_sim.models.biviscous import YIELD_SPEED
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import OFFSET, VISCOUS, YIELD_FORCE


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        branch = 1.0 if a[k].real > 0.0 else -1.0 if a[k].real < 0.0 else 0.0
        force[k] = q[k, 0] * clip((v[k] - branch * q[k, 2]) / q[k, 1], -1.0, 1.0) + q[k, 3] * v[k] + q[k, 4]


def observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """The coefficients of Wereley et al., whose yielding part is bounded by lines through ±v0."""
    before = values["viscous"] + values["yield_force"] / values["yield_speed"]
    share = 1.0 - values["viscous"] / before if before > 0.0 else 0.0
    return {
        "yield force F_y": (values["yield_force"], "N"),
        "C_pr": (before, "N s/m"),
        "C_po": (values["viscous"], "N s/m"),
        "zero-force speed v0": (values["loop_half_width"] * share, "m/s"),
    }


MODEL = DamperModel(
    id="hysteretic_biviscous",
    title="Hysteretic biviscous (Wereley)",
    equation="F = C_po x' + F_y clip((x' - v_h sgn x'') / v_y, -1, 1) + f0, with C_pr = C_po + F_y / v_y and "
    "v_h = v0 C_pr / (C_pr - C_po)",
    source="Wereley, Pang & Kamath, J. Intell. Mater. Syst. Struct. 9 (1998) 642; there in C_pr, C_po, F_y and v0",
    quantities=(
        replace(YIELD_FORCE, multiplies="term", meaning="yield force"),
        YIELD_SPEED,
        Quantity(
            "loop_half_width", "v_h", "m/s", "half the width of the loop over velocity", 0.005, 0.0, 0.1, (0.005, -0.1, 0.2)
        ),
        replace(VISCOUS, symbol="C_po"),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
    dissipative=False,
    observables=observables,
)
