"""Bouc-Wen model in its observable parameters."""

from collections.abc import Mapping
from dataclasses import replace

from numba import njit

from mrd_sim.hysteresis import advance
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import EXPONENT, OFFSET, SHAPE, STIFFNESS, VISCOUS, YIELD_FORCE, YIELD_TRAVEL
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (replace(YIELD_FORCE, multiplies="term"), YIELD_TRAVEL, SHAPE, EXPONENT, VISCOUS, STIFFNESS, OFFSET)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before = state[0], state[1]
    if dt[0] == 0.0:  # a new path: there was no motion before its first vertex
        before = x[0]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        w = advance(w, (x[k] - before) / c.yield_travel, c.shape, c.exponent)
        before = x[k]
        force[k] = c.yield_force * w + c.viscous * v[k] + c.stiffness * x[k] + c.offset
    state[0], state[1] = w, before


def observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """Return what recordings determine of a Bouc-Wen element. They do not determine A, alpha and z0 one by one."""
    determined = {
        "yield force alpha z0": (values["yield_force"], "N"),
        "rho = A/z0": (1.0 / values["yield_travel"], "1/m"),
        "gamma/(beta+gamma)": (values["shape"], ""),
        "c0": (values["viscous"], "N s/m"),
        "k0": (values["stiffness"], "N/m"),
    }
    if "series_viscous" in values:
        determined["c1"] = (values["series_viscous"], "N s/m")
    return determined


MODEL = DamperModel(
    id="bouc_wen",
    title="Bouc-Wen",
    equation="F = F_y w + c0 x' + k0 x + f0, x_y w' = x' - sigma |x'| w |w|^(n-1) - (1 - sigma) x' |w|^n",
    source="Bouc (1967), Wen (1976); sigma >= 1/2: class I of Ikhouane, Mañosa & Rodellar (2007), bounded and dissipative",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=2,
    observables=observables,
)
