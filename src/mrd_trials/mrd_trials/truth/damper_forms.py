"""Forms of dampers without any effect: one that a fitted Bouc-Wen model can take, and two families that it cannot."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from mrd_trials.truth.effects.true_effect import Family, PlantValues

(
    BOUC_WEN,
    BENT,
    KWOK,
    LUGRE,
    SPENCER,
    DAHL,
    BIVISCOUS,
    FROHLICH,
    GAMOTA_FILISKO,
    SIGMOID,
    POLYNOMIAL,
    HERSCHEL_BULKLEY,
    ARCTANGENT,
) = range(13)

COMMON = {"yield_0": 60.0, "yield_1": 800.0, "viscous_0": 800.0, "viscous_1": 1500.0, "stiffness": 1000.0, "offset": -40.0}

POWER_SPEED, LEAST_SPEED = 0.1, 2e-3
"""Speed in m/s at which a power law of the viscosity is 1, and below which it levels off."""


@dataclass(frozen=True)
class DamperForm:
    """A form of a damper.

    Attributes
    ----------
    id : str
    source : str
        What it is, with author and year.
    code : int
        What the compiled functions branch on.
    family : {"development", "evaluation"} or None
        Which trials it is for; None for the form that a fitted Bouc-Wen model can take, which all trials have.
    specific : mapping
        Nominal values of the parameters beyond the common ones.
    bounds : mapping
        Bounds that drawn parameters must not leave.
    implied : tuple of str
        Effects of the catalogue that the form contains, so that naming them is not wrong.
    """

    id: str
    source: str
    code: int
    family: Family | None
    specific: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    implied: tuple[str, ...] = ()

    @property
    def perturbed(self) -> bool:
        """Whether a fitted Bouc-Wen model cannot take this form."""
        return self.family is not None

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal yield force (N, N/A), viscosity (N s/m, N s/(m A)), stiffness (N/m), offset (N), specific parameters."""
        return {**COMMON, **self.specific}


DISSIPATIVE = {"sigma": (0.5, 2.0)}
"""Range in which a Bouc-Wen state stays bounded and dissipates."""

LOOP = {"travel": 1.5e-4, "sigma": 0.8}
SPEEDS = {"speed_0": 6e-3, "speed_1": 8e-3}

PRE_YIELD_FLOW = ("bypass_flow",)
"""Contained in forms whose force rises with the speed before they yield, as where fluid flows past the piston."""

DAMPER_FORMS: dict[str, DamperForm] = {
    form.id: form
    for form in (
        DamperForm("bouc_wen", "Bouc-Wen, exponent 2 (Wen 1976)", BOUC_WEN, None, LOOP, DISSIPATIVE),
        DamperForm(
            "bent",
            "Bouc-Wen, exponent 1.4, yield force that bends at high current (Wen 1976)",
            BENT,
            "development",
            {**LOOP, "exponent": 1.4, "saturation": 1.2},
            {**DISSIPATIVE, "exponent": (1.2, 1.6)},
            ("current_saturation",),
        ),
        DamperForm(
            "kwok",
            "hyperbolic tangent of speed and hysteretic state (Kwok et al. 2006)",
            KWOK,
            "development",
            {"travel": 3e-4, **SPEEDS, "shift": 0.8},
            implied=PRE_YIELD_FLOW,
        ),
        DamperForm(
            "lugre",
            "bristles with micro-damping (Sakai et al. 2003)",
            LUGRE,
            "development",
            {"travel": 1.2e-4, "micro_time": 3e-4},
        ),
        DamperForm(
            "spencer",
            "Bouc-Wen in series with a dashpot (Spencer et al. 1997)",
            SPENCER,
            "development",
            {"travel": 5e-5, "sigma": 0.8, "series_0": 15e3, "series_1": 60e3},
            DISSIPATIVE,
            PRE_YIELD_FLOW,
        ),
        DamperForm("dahl", "pre-yield slope the same at every current (Dahl 1968)", DAHL, "development", {"slope": 3.5e6}),
        DamperForm(
            "biviscous",
            "two viscosities with a smooth knee over the lagged speed (Wereley, Pang & Kamath 1998)",
            BIVISCOUS,
            "development",
            {**SPEEDS, "motion_lag": 4e-3, "knee": 2.5},
            {"knee": (2.0, 3.2)},
            PRE_YIELD_FLOW,
        ),
        DamperForm(
            "frohlich",
            "Bouc-Wen, yield force that saturates over the current (Fröhlich 1881, Kennelly 1891)",
            FROHLICH,
            "development",
            {**LOOP, "saturation": 1.8},
            DISSIPATIVE,
            ("current_saturation",),
        ),
        DamperForm(
            "gamota_filisko",
            "Bingham element in series with a standard linear solid (Gamota & Filisko 1991)",
            GAMOTA_FILISKO,
            "evaluation",
            {"spring": 6e6, "creep_spring": 5e6, "creep_time": 8e-3, "bingham": 300.0},
            implied=("rate_dependent_hysteresis", "series_compliance"),
        ),
        DamperForm(
            "sigmoid",
            "sigmoid of the speed, displaced by the acceleration, that grows with the speed (Wang et al. 2003)",
            SIGMOID,
            "evaluation",
            {**SPEEDS, "motion_lag": 5e-3, "growth": 1.0},
            implied=PRE_YIELD_FLOW,
        ),
        DamperForm(
            "polynomial",
            "polynomial of degree 5 with unlike branches for rising and falling speed (Choi, Lee & Park 2001)",
            POLYNOMIAL,
            "evaluation",
            {"speed_0": 15e-3, "speed_1": 20e-3, "motion_lag": 5e-3},
            implied=PRE_YIELD_FLOW,
        ),
        DamperForm(
            "herschel_bulkley",
            "Bouc-Wen with a power law of the speed after yield (Herschel & Bulkley 1926)",
            HERSCHEL_BULKLEY,
            "evaluation",
            {**LOOP, "power": 0.65},
            {**DISSIPATIVE, "power": (0.5, 0.8)},
            ("shear_thinning",),
        ),
        DamperForm(
            "arctangent",
            "Bouc-Wen of exponent 1, yield force an arc tangent of the current (Trutt, Erdélyi & Hopkins 1968)",
            ARCTANGENT,
            "evaluation",
            {"travel": 1.5e-4, "saturation": 1.4},
            implied=("current_saturation",),
        ),
    )
}
"""Damper forms by id."""

PARAMETERS = tuple(dict.fromkeys(name for form in DAMPER_FORMS.values() for name in form.nominal))


def draw_parameters(
    form: str, rng: np.random.Generator, spread: float = 0.3, around: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Draw the parameters of one damper, each evenly within ``spread`` of its nominal value, or of that in ``around``.

    Raises
    ------
    ValueError
        When the form is unknown.
    """
    damper = find_form(form)
    drawn = {name: value * (1.0 + spread * rng.uniform(-1.0, 1.0)) for name, value in (around or damper.nominal).items()}
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
        current /= math.pow(1.0 + math.pow(max(current, 0.0) / p.saturation, 3.0), 1.0 / 3.0)
    elif p.form == FROHLICH:
        current /= 1.0 + max(current, 0.0) / p.saturation
    elif p.form == ARCTANGENT:
        current = 2.0 / math.pi * p.saturation * math.atan(0.5 * math.pi * current / p.saturation)
    return p.yield_0 + p.yield_1 * current


@njit(cache=True, nogil=True)
def hysteretic_state(p: PlantValues, state: float, creep: float, dx: float, step: float, current: float) -> float:
    """Return the hysteretic state after a motion by ``dx``.

    It is -1 to 1 where the force follows the travel, the lagged speed (m/s) where it follows the speed, and the force (N) of
    a Bingham element behind a solid that has crept by ``creep`` (m).
    """
    if p.form == SIGMOID or p.form == POLYNOMIAL or p.form == BIVISCOUS:
        v = dx / step
        return v + (state - v) * math.exp(-step / p.motion_lag)
    if p.form == GAMOTA_FILISKO:
        return float(_bingham_force(p, state, creep, dx, step, current))
    travel = yield_force(p, current) / p.slope if p.form == DAHL else p.travel
    u = abs(dx) / travel
    side = 1.0 if dx > 0.0 else -1.0
    if u > 25.0:
        return side
    if p.form == KWOK or p.form == LUGRE or p.form == DAHL or p.form == ARCTANGENT:
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
def creep_after(p: PlantValues, creep: float, before: float, after: float, step: float) -> float:
    """Return the creep (m) of the solid behind a Bingham element after a step under its force (N) before and after it."""
    if p.form != GAMOTA_FILISKO:
        return 0.0
    keep = math.exp(-step / p.creep_time)
    return keep * creep + (1.0 - keep) * 0.5 * (before + after) / p.creep_spring


@njit(cache=True, nogil=True)
def _bingham_force(p: PlantValues, force: float, creep: float, dx: float, step: float, current: float) -> float:
    """Return the force (N) through spring, creeping spring and Bingham element after they moved by ``dx`` together."""
    crept = creep_after(p, creep, force, 0.0, step) - creep
    softening = 0.5 * (1.0 - math.exp(-step / p.creep_time)) / p.creep_spring
    compliance = 1.0 / p.spring + softening
    moved = dx + force / p.spring - crept
    elastic = moved / compliance
    yielding = yield_force(p, current)
    if abs(elastic) <= yielding:
        return float(elastic)
    side = 1.0 if elastic > 0.0 else -1.0
    flow = step / p.bingham
    return float((moved + side * yielding * flow) / (compliance + flow))


@njit(cache=True, nogil=True)
def hysteretic_force(p: PlantValues, state: float, rate: float, v: float, current: float) -> float:
    """Return the hysteretic force over the yield force; ``rate`` is the rate of the state (1/s), ``v`` the velocity."""
    if p.form == KWOK:
        return math.tanh(v / (p.speed_0 + p.speed_1 * current) + p.shift * state)
    if p.form == LUGRE:
        return state + p.micro_time * rate
    if p.form == GAMOTA_FILISKO:
        return float(state / yield_force(p, current))
    if p.form == SIGMOID or p.form == POLYNOMIAL or p.form == BIVISCOUS:
        over = state / (p.speed_0 + p.speed_1 * current)
        if p.form == SIGMOID:
            return math.tanh(over) * (1.0 + p.growth * abs(state))
        if p.form == BIVISCOUS:
            return over / math.pow(1.0 + math.pow(abs(over), p.knee), 1.0 / p.knee)
        over = min(max(over, -1.0), 1.0)
        return over * (15.0 - 10.0 * over**2 + 3.0 * over**4) / 8.0
    return state


@njit(cache=True, nogil=True)
def viscous_force(p: PlantValues, v: float, current: float) -> float:
    """Return the viscous force in N."""
    coefficient = p.viscous_0 + p.viscous_1 * current
    if p.form == HERSCHEL_BULKLEY:
        square = (v * v + LEAST_SPEED * LEAST_SPEED) / (POWER_SPEED * POWER_SPEED)
        coefficient *= math.pow(square, 0.5 * (p.power - 1.0))
    return coefficient * v


@njit(cache=True, nogil=True)
def series_viscosity(p: PlantValues, current: float) -> float:
    """Return the coefficient (N s/m) of the dashpot in series with the fluid; 0 without one."""
    return p.series_0 + p.series_1 * current if p.form == SPENCER else 0.0
