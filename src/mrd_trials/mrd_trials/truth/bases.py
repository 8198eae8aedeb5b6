"""Dampers without any effect: one form that a fitted Bouc-Wen model can take, and forms that it cannot."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from mrd_trials.truth.effects.declare import Values

BOUC_WEN, BENT, KWOK, LUGRE, SPENCER, DAHL = range(6)

COMMON = {"yield_0": 60.0, "yield_1": 800.0, "viscous_0": 800.0, "viscous_1": 1500.0, "stiffness": 1000.0, "offset": -40.0}


@dataclass(frozen=True)
class Base:
    """A form of damper.

    Attributes
    ----------
    id, title : str
    form : int
    perturbed : bool
        Whether a fitted Bouc-Wen model lacks the form.
    own : mapping
        Nominal values of parameters beyond the common ones.
    bounds : mapping
        Of parameters that a draw must not leave.
    """

    id: str
    title: str
    form: int
    perturbed: bool
    own: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def nominal(self) -> dict[str, float]:
        """Yield force (N, N/A), viscosity (N s/m, N s/(m A)), stiffness (N/m), offset (N), the form's own."""
        return {**COMMON, **self.own}


CLASS_I = {"sigma": (0.5, 2.0)}
"""Range in which a Bouc-Wen state stays bounded and dissipates."""

BASES: dict[str, Base] = {
    base.id: base
    for base in (
        Base("bouc_wen", "Bouc-Wen, exponent 2", BOUC_WEN, False, {"travel": 1.5e-4, "sigma": 0.8}, CLASS_I),
        Base(
            "bent",
            "Bouc-Wen, exponent 1.4, yield force that bends at high current",
            BENT,
            True,
            {"travel": 1.5e-4, "sigma": 0.8, "exponent": 1.4, "bend": 1.2},
            {**CLASS_I, "exponent": (1.2, 1.6)},
        ),
        Base(
            "kwok",
            "Hyperbolic tangent of speed and memory",
            KWOK,
            True,
            {"travel": 3e-4, "speed_0": 6e-3, "speed_1": 8e-3, "shift": 0.8},
        ),
        Base("lugre", "Bristles with damping of their own", LUGRE, True, {"travel": 1.2e-4, "micro_time": 3e-4}),
        Base(
            "spencer",
            "Bouc-Wen in series with a dashpot",
            SPENCER,
            True,
            {"travel": 5e-5, "sigma": 0.8, "series_0": 15e3, "series_1": 60e3},
            CLASS_I,
        ),
        Base("dahl", "Dahl, pre-yield slope the same at every current", DAHL, True, {"slope": 3.5e6}),
    )
}
"""By id."""

PARAMETERS = tuple(dict.fromkeys(name for base in BASES.values() for name in base.nominal))


def draw(base: str, rng: np.random.Generator, spread: float = 0.3) -> dict[str, float]:
    """Parameters of one damper, each evenly within ``spread`` of its nominal value.

    Raises
    ------
    ValueError
        For an unknown form.
    """
    found = find_base(base)
    drawn = {name: value * (1.0 + spread * rng.uniform(-1.0, 1.0)) for name, value in found.nominal.items()}
    return {name: float(np.clip(value, *found.bounds.get(name, (-np.inf, np.inf)))) for name, value in drawn.items()}


def find_base(base: str) -> Base:
    """By id.

    Raises
    ------
    ValueError
        For an unknown one.
    """
    if base not in BASES:
        raise ValueError(f"base {base}: unknown, expected one of {', '.join(BASES)}")
    return BASES[base]


@njit(cache=True, nogil=True)
def yield_force(p: Values, current: float) -> float:
    """N."""
    if p.form == BENT:
        current /= math.pow(1.0 + math.pow(max(current, 0.0) / p.bend, 3.0), 1.0 / 3.0)
    return p.yield_0 + p.yield_1 * current


@njit(cache=True, nogil=True)
def deflected(p: Values, w: float, dx: float, current: float) -> float:
    """Hysteretic state (-1 to 1) after a motion by ``dx``."""
    travel = yield_force(p, current) / p.slope if p.form == DAHL else p.travel
    u = abs(dx) / travel
    side = 1.0 if dx > 0.0 else -1.0
    if u > 25.0:
        return side
    if p.form == KWOK or p.form == LUGRE or p.form == DAHL:
        return side + (w - side) * math.exp(-u)
    # Runge-Kutta along the path, in the direction of motion: n' = 1 - sigma |n|^(e-1) n + (sigma - 1) |n|^e.
    pieces = 1 + int(u / 0.4)
    h = u / pieces
    n = side * w
    for _ in range(pieces):
        a = _slope(p, n)
        b = _slope(p, n + 0.5 * h * a)
        c = _slope(p, n + 0.5 * h * b)
        d = _slope(p, n + h * c)
        n += h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return side * n


@njit(cache=True, nogil=True)
def _slope(p: Values, n: float) -> float:
    power = math.pow(abs(n), p.exponent) if p.form == BENT else n * n
    return 1.0 - power if n > 0.0 else 1.0 + (2.0 * p.sigma - 1.0) * power


@njit(cache=True, nogil=True)
def hysteretic(p: Values, w: float, rate: float, v: float, current: float) -> float:
    """Hysteretic force over the yield force; ``rate`` is that of the state (1/s), ``v`` the speed."""
    if p.form == KWOK:
        return math.tanh(v / (p.speed_0 + p.speed_1 * current) + p.shift * w)
    if p.form == LUGRE:
        return w + p.micro_time * rate
    return w


@njit(cache=True, nogil=True)
def viscous(p: Values, current: float) -> float:
    """N s/m."""
    return p.viscous_0 + p.viscous_1 * current


@njit(cache=True, nogil=True)
def dashpot(p: Values, current: float) -> float:
    """N s/m, in series with the fluid; 0 for none."""
    return p.series_0 + p.series_1 * current if p.form == SPENCER else 0.0
