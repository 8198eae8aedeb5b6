"""The options of an identification, and how they are read from texts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

from mrd_base import InputError
from mrd_identification.effect_selection import AUTO, selects
from mrd_identification.problem import Loss
from mrd_identification.recording import Weights
from mrd_sim.current import parse_laws

SELECTION_SEARCHES = 30
"""Searches that take about as long as a selection of effects."""

LEAST_POPULATION = 8
"""Candidates; the genetic operators of NSGA-II need several parents."""


@dataclass(frozen=True)
class Method:
    """Options of an identification.

    Attributes
    ----------
    laws : str or mapping
        Current laws, see `mrd_sim.models.DamperModel.with_laws`.
    effects : sequence of str
        Ids of effects that are identified together with the model. ``"auto"`` among them stands for those that
        `mrd_identification.effect_selection` adds to the others.
    fixed : mapping
        Values of parameters that are not searched, by name.
    freed : collection of str
        Names of parameters that are searched although they keep their default otherwise.
    offsets : bool
        Let each fitted run have its own force offset; held-out runs are predicted without one.
    weights : {"samples", "runs", "force"} or sequence of float
        Weights of the runs, see `mrd_identification.recording.run_weights`.
    loss : {"linear", "soft_l1", "huber"}
        Loss function of the residuals in least squares.
    population, generations : int
        Size of the population of NSGA-II, and number of its generations.
    seed, seeds : int
        First seed of the random numbers, and number of searches, each with the next seed.
    least_squares : bool
        Continue by least squares from the Pareto front; without it the knee of the first front is the result.
    profile : bool
        Compute intervals from profiles of the objective in addition to those from the covariance.
    """

    laws: str | Mapping[str, str] = field(default_factory=dict)
    effects: Sequence[str] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    freed: Collection[str] = ()
    offsets: bool = False
    weights: Weights | Sequence[float] = "samples"
    loss: Loss = "linear"
    population: int = 40
    generations: int = 25
    seed: int = 0
    seeds: int = 3
    least_squares: bool = True
    profile: bool = True

    @property
    def search_seeds(self) -> range:
        """Seed of each search; without least squares there is one search only."""
        return range(self.seed, self.seed + (self.seeds if self.least_squares else 1))

    @property
    def total_generations(self) -> int:
        """Number of generations of all searches together; the selection of effects counts as so many more."""
        searches = len(self.search_seeds)
        return self.generations * (2 * searches + SELECTION_SEARCHES if selects(self.effects) else searches)

    @property
    def given_effects(self) -> tuple[str, ...]:
        """Ids of the effects that are not selected."""
        return tuple(effect for effect in self.effects if effect != AUTO)

    def check(self) -> None:
        """Raise `InputError` for options that do not exist or exclude each other, and for numbers that are too small."""
        if selects(self.effects) and not self.least_squares:
            raise InputError(f"effect {AUTO}: effects are selected by least squares; name the effects, or use least squares")
        if self.loss not in get_args(Loss):
            raise InputError(f"loss {self.loss!r}: expected {', '.join(get_args(Loss))}")
        if self.population < LEAST_POPULATION or self.generations < 1 or self.seeds < 1:
            raise InputError(
                f"population {self.population}, generations {self.generations}, seeds {self.seeds}: "
                f"expected at least {LEAST_POPULATION}, 1 and 1"
            )
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}, expected a whole number of 0 or more")


def parse_method(*, laws: str = "", fixed: Sequence[str] = (), **options: Any) -> Method:
    """Make a method from the texts and numbers of a command line or of an action's goal.

    Parameters
    ----------
    laws : str
        ``LAW`` for all coefficients, or ``COEFFICIENT=LAW,...``.
    fixed : sequence of str
        ``PARAMETER=VALUE``, the value in SI units.
    **options
        Other fields of `Method`.

    Raises
    ------
    InputError
        For a text that is not of its form, and for what `Method.check` refuses.
    """
    values = {}
    for text in fixed:
        name, _, value = text.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            raise InputError(f"fixed parameter {text}: expected PARAMETER=VALUE with a number in SI units") from None
    method = Method(laws=parse_laws(laws, "current law"), fixed=values, **options)
    method.check()
    return method
