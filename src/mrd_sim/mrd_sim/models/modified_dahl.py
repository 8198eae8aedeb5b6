"""Modified Dahl model: a friction element of constant stiffness in parallel with a dashpot and a spring."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.dual import absolute, expm1
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import OFFSET, STIFFNESS, VISCOUS, YIELD_FORCE
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (
    # A few newtons at least, because k_s is divided by it.
    replace(YIELD_FORCE, symbol="F_d", meaning="yield force", lower=5.0),
    Coefficient(
        "series_stiffness", "k_s", "N/m", "stiffness before yield", 2e6, 2e5, 2e7, (0.0, -1e7, 1e7), log=True, law="constant"
    ),
    VISCOUS,
    STIFFNESS,
    OFFSET,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def dahl_state(w: Any, travel: Any) -> Any:
    """Return the state after the rod moved by ``travel``, in yield travels, without reversal: dw = dx - |dx| w, exactly."""
    direction = 1.0 if travel.real >= 0.0 else -1.0
    return w - (direction - w) * expm1(-absolute(travel))


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before = state[0], state[1]
    if dt[0] == 0.0:
        before = x[0]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        w = dahl_state(w, (x[k] - before) * c.series_stiffness / c.yield_force)
        before = x[k]
        force[k] = c.yield_force * w + c.viscous * v[k] + c.stiffness * x[k] + c.offset
    state[0], state[1] = w, before


def _observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    return {
        "yield force F_d": (values["yield_force"], "N"),
        "rho = k_s/F_d": (values["series_stiffness"] / values["yield_force"], "1/m"),
        "c0": (values["viscous"], "N s/m"),
        "k0": (values["stiffness"], "N/m"),
    }


MODEL = DamperModel(
    id="modified_dahl",
    title="Modified Dahl",
    equation="F = k0 x + c0 x' + F_d w + f0, w' = rho (x' - |x'| w) with rho = k_s / F_d",
    source="Dahl (1968); Zhou & Qu (2002); here by the stiffness k_s before yield, which stays when F_d grows with current",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=2,
    observables=_observables,
)
