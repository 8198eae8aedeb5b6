"""Forms of dampers without any effect: one that a fitted Bouc-Wen model can take, and five that it cannot."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues

BOUC_WEN, BENT, KWOK, LUGRE, SPENCER, DAHL = range(6)

COMMON = {"yield_0": 60.0, "yield_1": 800.0, "viscous_0": 800.0, "viscous_1": 1500.0, "stiffness": 1000.0, "offset": -40.0}


@dataclass(frozen=True)
class DamperForm:
    """A form of a damper.

    Attributes
    ----------
    id, title : str
    code : int
        What the compiled functions branch on.
    perturbed : bool
        Whether a fitted Bouc-Wen model cannot take this form.
    specific : mapping
        Nominal values of the parameters beyond the common ones.
    bounds : mapping
        Bounds that drawn parameters must not leave.
    """

    id: str
    title: str
    code: int
    perturbed: bool
    specific: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal yield force (N, N/A), viscosity (N s/m, N s/(m A)), stiffness (N/m), offset (N), specific parameters."""
        return {**COMMON, **self.specific}


DISSIPATIVE = {"sigma": (0.5, 2.0)}
"""Range in which a Bouc-Wen state stays bounded and dissipates."""

DAMPER_FORMS: dict[str, DamperForm] = {
    form.id: form
    for form in (
        DamperForm("bouc_wen", "Bouc-Wen, exponent 2", BOUC_WEN, False, {"travel": 1.5e-4, "sigma": 0.8}, DISSIPATIVE),
        DamperForm(
            "bent",
            "Bouc-Wen, exponent 1.4, yield force that bends at high current",
            BENT,
            True,
            {"travel": 1.5e-4, "sigma": 0.8, "exponent": 1.4, "bend": 1.2},
            {**DISSIPATIVE, "exponent": (1.2, 1.6)},
        ),
        DamperForm(
            "kwok",
            "Hyperbolic tangent of speed and hysteretic state",
            KWOK,
            True,
            {"travel": 3e-4, "speed_0": 6e-3, "speed_1": 8e-3, "shift": 0.8},
        ),
        DamperForm("lugre", "Bristles with micro-damping", LUGRE, True, {"travel": 1.2e-4, "micro_time": 3e-4}),
        DamperForm(
            "spencer",
            "Bouc-Wen in series with a dashpot",
            SPENCER,
            True,
            {"travel": 5e-5, "sigma": 0.8, "series_0": 15e3, "series_1": 60e3},
            DISSIPATIVE,
        ),
        DamperForm("dahl", "Dahl, pre-yield slope the same at every current", DAHL, True, {"slope": 3.5e6}),
    )
}
"""Damper forms by id."""

PARAMETERS = tuple(dict.fromkeys(name for form in DAMPER_FORMS.values() for name in form.nominal))


def draw_parameters(form: str, rng: np.random.Generator, spread: float = 0.3) -> dict[str, float]:
    """Draw the parameters of one damper, each evenly within ``spread`` of its nominal value.

    Raises
    ------
    ValueError
        When the form is unknown.
    """
    damper = find_form(form)
    drawn = {name: value * (1.0 + spread * rng.uniform(-1.0, 1.0)) for name, value in damper.nominal.items()}
    return {name: float(np.clip(value, *damper.bounds.get(name, (-np.inf, np.inf)))) for name, value in drawn.items()}


def find_form(form: str) -> DamperForm:
    """Return the damper form of an id.

    Raises
    ------
    ValueError
        When the id is unknown.
    """
    if form not in DAMPER_FORMS:
        raise ValueError(f"damper form {form}: unknown, expected one of {', '.join(DAMPER_FORMS)}")
    return DAMPER_FORMS[form]


@njit(cache=True, nogil=True)
def yield_force(p: PlantValues, current: float) -> float:
    """Return the yield force in N."""
    if p.form == BENT:
        current /= math.pow(1.0 + math.pow(max(current, 0.0) / p.bend, 3.0), 1.0 / 3.0)
    return p.yield_0 + p.yield_1 * current


@njit(cache=True, nogil=True)
def hysteretic_state(p: PlantValues, state: float, dx: float, current: float) -> float:
    """Return the hysteretic state (-1 to 1) after a motion by ``dx``."""
    travel = yield_force(p, current) / p.slope if p.form == DAHL else p.travel
    u = abs(dx) / travel
    side = 1.0 if dx > 0.0 else -1.0
    if u > 25.0:
        return side
    if p.form == KWOK or p.form == LUGRE or p.form == DAHL:
        return side + (state - side) * math.exp(-u)
    # Runge-Kutta along the path in the direction of motion: n' = 1 - sigma |n|^(e-1) n + (sigma - 1) |n|^e.
    pieces = 1 + int(u / 0.4)
    h = u / pieces
    n = side * state
    for _ in range(pieces):
        a = _slope(p, n)
        b = _slope(p, n + 0.5 * h * a)
        c = _slope(p, n + 0.5 * h * b)
        d = _slope(p, n + h * c)
        n += h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return side * n


@njit(cache=True, nogil=True)
def _slope(p: PlantValues, n: float) -> float:
    power = math.pow(abs(n), p.exponent) if p.form == BENT else n * n
    return 1.0 - power if n > 0.0 else 1.0 + (2.0 * p.sigma - 1.0) * power


@njit(cache=True, nogil=True)
def hysteretic_force(p: PlantValues, state: float, rate: float, v: float, current: float) -> float:
    """Return the hysteretic force over the yield force; ``rate`` is the rate of the state (1/s), ``v`` the velocity."""
    if p.form == KWOK:
        return math.tanh(v / (p.speed_0 + p.speed_1 * current) + p.shift * state)
    if p.form == LUGRE:
        return state + p.micro_time * rate
    return state


@njit(cache=True, nogil=True)
def viscosity(p: PlantValues, current: float) -> float:
    """Return the viscous coefficient in N s/m."""
    return p.viscous_0 + p.viscous_1 * current


@njit(cache=True, nogil=True)
def series_viscosity(p: PlantValues, current: float) -> float:
    """Return the coefficient (N s/m) of the dashpot in series with the fluid; 0 without one."""
    return p.series_0 + p.series_1 * current if p.form == SPENCER else 0.0
