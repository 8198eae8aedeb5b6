"""Hysteretic biviscous model: the biviscous curve, shifted along velocity by the sign of the acceleration."""

from collections.abc import Mapping
from dataclasses import replace

from numba import njit

from mrd_sim.dual import clip
from mrd_sim.models.biviscous import YIELD_SPEED
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import PRELOAD, VISCOUS, YIELD_FORCE
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (
    replace(YIELD_FORCE, multiplies="term", meaning="yield force"),
    YIELD_SPEED,
    Coefficient(
        "loop_half_width", "v_h", "m/s", "half the width of the loop over velocity", 0.005, 0.0, 0.1, (0.005, -0.1, 0.2)
    ),
    replace(VISCOUS, symbol="C_po"),
    PRELOAD,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        branch = 1.0 if a[k].real > 0.0 else -1.0 if a[k].real < 0.0 else 0.0
        force[k] = (
            c.yield_force * clip((v[k] - branch * c.loop_half_width) / c.yield_speed, -1.0, 1.0)
            + c.viscous * v[k]
            + c.offset
        )


def observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """Return the coefficients of Wereley et al., whose pre-yield lines cross zero force at ±v0."""
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
    coefficients=COEFFICIENTS,
    kernel=_force,
    dissipative=False,
    observables=observables,
)
