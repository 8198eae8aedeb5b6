"""Declaration of an effect of the ground truth: its formulas, their parameters, and how these are drawn."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

Family = Literal["development", "evaluation"]
"""Which trials a formula is for: those on which the diagnosis is developed, or those that evaluate it."""


class PlantValues(Protocol):
    """Parameters of a plant, named EFFECT_PARAMETER or as in its damper form; those of effects that it lacks are 0.

    EFFECT_formula is the place of the effect's formula among its formulas.
    """

    def __getattr__(self, name: str) -> float: ...


LARGEST_SHARE = 0.8
"""Share of the plausible range up to which effects are drawn: of what stands at its end, nobody can say that it is meant."""


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of a formula, in SI units.

    Attributes
    ----------
    name : str
    typical : float
        Value at strength 1 of a parameter that grows with the strength; else the (logarithmic) middle of the range.
    low, high : float
        Plausible range; the magnitude of a parameter that grows with the strength stays within `LARGEST_SHARE` of ``high``.
    grows : bool
        Whether the parameter is a size of the effect, which is 0 without the effect; else it is drawn from its range.
    signed : bool
        Whether a size gets a random sign.
    logarithmic : bool
        Whether the logarithm is drawn evenly from the range.
    """

    name: str
    typical: float
    low: float
    high: float
    grows: bool = True
    signed: bool = False
    logarithmic: bool = False

    def draw(self, rng: np.random.Generator, strength: float) -> float:
        """Draw a value; ``rng`` advances by the same amount at every strength."""
        chance = rng.random()
        if self.grows:
            size = min(self.typical * strength, LARGEST_SHARE * self.high)
            return -size if self.signed and chance < 0.5 else size
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** chance)
        return self.low + (self.high - self.low) * float(chance)


def size(name: str, typical: float, high: float, signed: bool = False) -> EffectParameter:
    """Declare a parameter that grows with the effect's strength."""
    return EffectParameter(name, typical, -high if signed else 0.0, high, signed=signed)


def shape(name: str, low: float, high: float, logarithmic: bool = False) -> EffectParameter:
    """Declare a parameter that does not depend on the effect's strength."""
    middle = float(np.sqrt(low * high)) if logarithmic else (low + high) / 2
    return EffectParameter(name, middle, low, high, grows=False, logarithmic=logarithmic)


@dataclass(frozen=True)
class Formula:
    """One mathematical form of an effect; none is the one that the catalogue fits.

    Attributes
    ----------
    id : str
    source : str
        What it says, with author and year.
    family : {"development", "evaluation"}
    parameters : tuple of EffectParameter
    shared : tuple of str
        Names of the parameters that mean the same in the catalogue, so that a fitted value can be compared with them.
    """

    id: str
    source: str
    family: Family
    parameters: tuple[EffectParameter, ...]
    shared: tuple[str, ...] = ()

    def draw(self, rng: np.random.Generator, strength: float) -> dict[str, float]:
        """Draw the parameters at a strength: 0 is without the effect, 1 is typical; sizes never fall with the strength.

        Parameters
        ----------
        rng : numpy Generator
            The same state gives the same signs and shapes at every strength.
        strength : float
            At least 0.

        Raises
        ------
        ValueError
            When the strength is negative or not finite.
        """
        if not 0.0 <= strength < np.inf:
            raise ValueError(f"strength {strength}: expected a finite number of at least 0")
        return {parameter.name: parameter.draw(rng, strength) for parameter in self.parameters}


def development(id: str, source: str, *parameters: EffectParameter, shared: tuple[str, ...] = ()) -> Formula:
    """Declare a formula for trials on which the diagnosis is developed."""
    return Formula(id, source, "development", parameters, shared)


def evaluation(id: str, source: str, *parameters: EffectParameter, shared: tuple[str, ...] = ()) -> Formula:
    """Declare a formula for trials that evaluate the diagnosis; nobody may tune anything on it."""
    return Formula(id, source, "evaluation", parameters, shared)


@dataclass(frozen=True)
class TrueEffect:
    """An effect that a plant may have.

    Attributes
    ----------
    id : str
        The same id as in the catalogue, where the catalogue has the effect.
    title : str
    formulas : tuple of Formula
        Their places are the codes that the compiled functions branch on.
    in_catalogue : bool
    in_series : bool
        Whether the effect stands between drive and damper, so that the force decides what moves.
    """

    id: str
    title: str
    formulas: tuple[Formula, ...]
    in_catalogue: bool = True
    in_series: bool = False

    def formula(self, id: str = "") -> Formula:
        """Return the formula of an id, the first one by default.

        Raises
        ------
        ValueError
            When the effect has no such formula.
        """
        for formula in self.formulas:
            if id in ("", formula.id):
                return formula
        known = ", ".join(formula.id for formula in self.formulas)
        raise ValueError(f"effect {self.id}: has no formula {id}, expected one of {known}")

    def draw_formula(self, family: Family, rng: np.random.Generator) -> str:
        """Return the id of one formula of a family, each as probable as the others; ``rng`` advances by one number."""
        ids = [formula.id for formula in self.formulas if formula.family == family]
        return ids[int(rng.random() * len(ids))]

    def shared_sizes(self, parameters: Mapping[str, float], formula: str = "") -> dict[str, float]:
        """Return the parameters of a formula that the catalogue has as well, by EFFECT.PARAMETER."""
        return {f"{self.id}.{name}": parameters[name] for name in self.formula(formula).shared}
