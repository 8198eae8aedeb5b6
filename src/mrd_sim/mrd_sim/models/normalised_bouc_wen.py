"""Normalised Bouc-Wen model: the state saturates at ±1, so that no parameter is redundant."""

from collections.abc import Mapping
from dataclasses import replace

from numba import njit

from mrd_sim.hysteresis import advance
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import EXPONENT, PRELOAD, SHAPE, STIFFNESS, VISCOUS, YIELD_FORCE
from mrd_sim.named import named_row, tuple_type

COEFFICIENTS = (
    replace(YIELD_FORCE, name="kappa_w", symbol="kappa_w", meaning="yield force", multiplies="term"),
    Coefficient("rho", "rho", "1/m", "1 / yield travel", 2e4, 5e2, 5e5, (-1.2e4, -1e5, 1e5), log=True),
    replace(SHAPE, name="sigma", meaning="share of the hysteresis that opposes motion in either direction"),
    replace(EXPONENT, name="n", free=True),
    replace(VISCOUS, name="kappa_v", symbol="kappa_v"),
    replace(STIFFNESS, name="kappa_x", symbol="kappa_x"),
    PRELOAD,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    w, before = state[0], state[1]
    if dt[0] == 0.0:
        before = x[0]
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        w = advance(w, (x[k] - before) * c.rho, c.sigma, c.n)
        before = x[k]
        force[k] = c.kappa_w * w + c.kappa_v * v[k] + c.kappa_x * x[k] + c.offset
    state[0], state[1] = w, before


def _observables(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    return {
        "kappa_w": (values["kappa_w"], "N"),
        "rho": (values["rho"], "1/m"),
        "sigma": (values["sigma"], ""),
        "kappa_v": (values["kappa_v"], "N s/m"),
        "kappa_x": (values["kappa_x"], "N/m"),
    }


MODEL = DamperModel(
    id="normalised_bouc_wen",
    title="Normalised Bouc-Wen",
    equation="F = kappa_v x' + kappa_x x + kappa_w w + f0, w' = rho (x' - sigma |x'| w |w|^(n-1) + (sigma - 1) x' |w|^n)",
    source="Ikhouane & Rodellar, Systems with Hysteresis (2007); sigma >= 1/2: class I, bounded and dissipative",
    coefficients=COEFFICIENTS,
    kernel=_force,
    states=2,
    observables=_observables,
)
