"""What an effect of the truth declares: its quantities, and how they are drawn."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Values(Protocol):
    """Parameters of a plant, as EFFECT_PARAMETER or as its form names them; those of effects that it lacks are 0."""

    def __getattr__(self, name: str) -> float: ...


@dataclass(frozen=True)
class Quantity:
    """One parameter of an effect, SI.

    Attributes
    ----------
    name : str
    typical : float
        At strength 1, for a quantity that grows with strength; in the middle (of the logarithms), for another.
    low, high : float
        Plausible range; one that grows with strength stays within ``high``, whatever its sign.
    grows : bool
        Whether it is the effect's size, 0 without the effect; else it is drawn from its range.
    signed : bool
        Whether a size has either sign, by chance.
    logarithmic : bool
        Whether the range is drawn from evenly in the logarithm.
    """

    name: str
    typical: float
    low: float
    high: float
    grows: bool = True
    signed: bool = False
    logarithmic: bool = False

    def drawn(self, rng: np.random.Generator, strength: float) -> float:
        """One draw; takes the same from ``rng`` at every strength."""
        chance = rng.random()
        if self.grows:
            size = min(self.typical * strength, self.high)
            return -size if self.signed and chance < 0.5 else size
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** chance)
        return self.low + (self.high - self.low) * float(chance)


def size(name: str, typical: float, high: float, signed: bool = False) -> Quantity:
    """A quantity that grows with the effect's strength."""
    return Quantity(name, typical, -high if signed else 0.0, high, signed=signed)


def within(name: str, low: float, high: float, logarithmic: bool = False) -> Quantity:
    """A quantity that has no say in the strength."""
    middle = float(np.sqrt(low * high)) if logarithmic else (low + high) / 2
    return Quantity(name, middle, low, high, grows=False, logarithmic=logarithmic)


@dataclass(frozen=True)
class TrueEffect:
    """An effect that a plant may have.

    Attributes
    ----------
    id : str
        As in the catalogue, where that has it.
    title : str
    quantities : tuple of Quantity
    same : tuple of str
        Names of those quantities that mean exactly the same in the catalogue.
    in_catalogue : bool
    in_series : bool
        Whether it stands between drive and damper, so that the force decides what moves.
    """

    id: str
    title: str
    quantities: tuple[Quantity, ...]
    same: tuple[str, ...] = ()
    in_catalogue: bool = True
    in_series: bool = False

    def drawn(self, rng: np.random.Generator, strength: float) -> dict[str, float]:
        """Parameters at a strength: 0 is without the effect, 1 typical; sizes never fall with it.

        Parameters
        ----------
        rng : numpy Generator
            The same state gives the same signs and secondary parameters at every strength.
        strength : float
            At least 0.

        Returns
        -------
        dict of str to float

        Raises
        ------
        ValueError
            For a strength that is not.
        """
        if not 0.0 <= strength < np.inf:
            raise ValueError(f"strength {strength}: expected a finite number of at least 0")
        return {quantity.name: quantity.drawn(rng, strength) for quantity in self.quantities}

    def sizes(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """What of the parameters the catalogue's terms can say, by EFFECT.PARAMETER."""
        return {f"{self.id}.{name}": parameters[name] for name in self.same}
