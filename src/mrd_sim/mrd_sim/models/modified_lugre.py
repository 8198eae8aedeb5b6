"""Modified LuGre model: damped bristles, whose stiffness grows with the current, in parallel with a dashpot."""

from collections.abc import Mapping
from dataclasses import replace

from numba import njit

from mrd_sim.dual import absolute
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.modified_dahl import dahl_state
from mrd_sim.models.shared_coefficients import PRELOAD, VISCOUS
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (
    Coefficient(
        "bristle_stiffness",
        "sigma_0",
        "N/m",
        "bristle stiffness",
        1e6,
        0.0,
        2e7,
        (8e6, 0.0, 5e7),
        multiplies="term",
        part="yield",
    ),
    Coefficient(
        "a0", "a0", "1/m", "1 / yield travel of the bristles", 1e4, 5e2, 5e5, (0.0, -1e5, 1e5), log=True, law="constant"
    ),
    Coefficient(
        "bristle_viscous",
        "sigma_1",
        "N s/m",
        "viscous coefficient of the bristles",
        200.0,
        0.0,
        5e3,
        (0.0, 0.0, 1e4),
        multiplies="term",
        law="constant",
    ),
    replace(VISCOUS, symbol="sigma_2"),
    PRELOAD,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    z, before = state[0], state[1]
    if dt[0] == 0.0:
        before = x[0]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        z = dahl_state(z * c.a0, (x[k] - before) * c.a0) / c.a0
        before = x[k]
        z_speed = v[k] - c.a0 * absolute(v[k]) * z
        force[k] = c.bristle_stiffness * z + c.bristle_viscous * z_speed + c.viscous * v[k] + c.offset
    state[0], state[1] = z, before


def _observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    return {
        "yield force sigma_0/a0": (values["bristle_stiffness"] / values["a0"], "N"),
        "rho = a0": (values["a0"], "1/m"),
        "sigma_1": (values["bristle_viscous"], "N s/m"),
        "sigma_2": (values["viscous"], "N s/m"),
    }


MODEL = DamperModel(
    id="modified_lugre",
    title="Modified LuGre",
    equation="F = sigma_0 z + sigma_1 z' + sigma_2 x' + f0, z' = x' - a0 |x'| z",
    source="Sakai, Ohmori & Sano (2003); Terasawa, Sakai, Ohmori & Sano (2004), who write sigma_a + sigma_0 u and "
    "sigma_2 + sigma_b u for the two coefficients that grow with current",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=2,
    observables=_observables,
)
