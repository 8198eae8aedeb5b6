"""Bouc-Wen model in its observable parameters."""

from collections.abc import Mapping

import numpy as np
from numba import njit

from mrd_sim.hysteresis import advance
from mrd_sim.models.model import Array, DamperModel, Quantity


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


def dissipative(values: Mapping[str, Array]) -> Array:
    """Class I of Ikhouane, Mañosa & Rodellar (2007): bounded and dissipative, sigma >= 1/2 (rho > 0 by its bounds)."""
    return np.asarray(0.5 - values["shape"])[:, None]


def observables(values: Mapping[str, float], current: float) -> dict[str, tuple[float, str]]:
    """What recordings determine of a Bouc-Wen element at one current; A, alpha and z0 apart are not among it."""

    def at(name: str) -> float:
        return values[name] + values.get(f"{name}_per_A", 0.0) * current

    found = {
        "yield force alpha z0": (at("yield_force"), "N"),
        "rho = A/z0": (1.0 / at("yield_travel"), "1/m"),
        "gamma/(beta+gamma)": (at("shape"), ""),
        "c0": (at("viscous"), "N s/m"),
        "k0": (at("stiffness"), "N/m"),
    }
    if "series_viscous" in values:
        found["c1"] = (at("series_viscous"), "N s/m")
    return found


YIELD = (
    Quantity("yield_force", "F_y", "N", "yield force alpha z0", 80.0, 0.0, 1500.0, (900.0, 0.0, 3000.0)),
    Quantity(
        "yield_travel", "x_y", "m", "travel to yield 1/rho = z0/A", 125e-6, 2e-6, 2e-3, (0.0, 0.0, 2e-3), log=True
    ),
    Quantity("shape", "sigma", "", "gamma / (beta + gamma), gamma multiplying |x'|", 0.8, 0.3, 1.5),
    Quantity("exponent", "n", "", "sharpness of the transition", 2.0, 1.0, 2.0, free=False, choices=(1.0, 2.0)),
)

MODEL = DamperModel(
    id="bouc_wen",
    title="Bouc-Wen",
    equation="F = F_y w + c0 x' + k0 x + f0, x_y w' = x' - sigma |x'| w |w|^(n-1) - (1 - sigma) x' |w|^n",
    source="Bouc (1967), Wen (1976); normalised as by Ikhouane & Rodellar (2007)",
    quantities=(
        *YIELD,
        Quantity("viscous", "c0", "N s/m", "post-yield viscous coefficient", 900.0, 0.0, 2e4, (2500.0, 0.0, 2e4)),
        Quantity("stiffness", "k0", "N/m", "stiffness", 1500.0, 0.0, 1e4),
        Quantity("offset", "f0", "N", "constant force (gas preload), -k0 x0", 0.0, -300.0, 300.0),
    ),
    kernel=_force,
    states=2,
    constraints=dissipative,
    observables=observables,
)
