"""Bouc-Wen model in its observable parameters."""

from collections.abc import Mapping
from dataclasses import replace

from numba import njit

from mrd_sim.hysteresis import advance
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.quantities import EXPONENT, OFFSET, SHAPE, STIFFNESS, VISCOUS, YIELD_FORCE, YIELD_TRAVEL


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before = state[0], state[1]
    if dt[0] == 0.0:  # a new path: there was no motion before its first vertex
        before = x[0]
    for k in range(len(x)):
        w = advance(w, (x[k] - before) / q[k, 1], q[k, 2], q[k, 3])
        before = x[k]
        force[k] = q[k, 0] * w + q[k, 4] * v[k] + q[k, 5] * x[k] + q[k, 6]
    state[0], state[1] = w, before


def observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """What recordings determine of a Bouc-Wen element; A, alpha and z0 apart are not among it."""
    found = {
        "yield force alpha z0": (values["yield_force"], "N"),
        "rho = A/z0": (1.0 / values["yield_travel"], "1/m"),
        "gamma/(beta+gamma)": (values["shape"], ""),
        "c0": (values["viscous"], "N s/m"),
        "k0": (values["stiffness"], "N/m"),
    }
    if "series_viscous" in values:
        found["c1"] = (values["series_viscous"], "N s/m")
    return found


MODEL = DamperModel(
    id="bouc_wen",
    title="Bouc-Wen",
    equation="F = F_y w + c0 x' + k0 x + f0, x_y w' = x' - sigma |x'| w |w|^(n-1) - (1 - sigma) x' |w|^n",
    source="Bouc (1967), Wen (1976); sigma >= 1/2: class I of Ikhouane, Mañosa & Rodellar (2007), bounded and dissipative",
    quantities=(replace(YIELD_FORCE, multiplies="term"), YIELD_TRAVEL, SHAPE, EXPONENT, VISCOUS, STIFFNESS, OFFSET),
    kernel=_force,
    states=2,
    observables=observables,
)
