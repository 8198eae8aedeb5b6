"""Design of a trial: which plants it has, of which kinds, with which effects at which strengths."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np

from mrd_base import InputError
from mrd_trials.excitation import Tier, parse_tier, read_recorded_dampers
from mrd_trials.records import Kind
from mrd_trials.truth import DAMPER_FORMS, EFFECTS, Family

SHARES: Mapping[str, float] = {"null": 0.25, "single": 0.40, "pair": 0.15, "absent": 0.20}
"""Share of each kind among the plants of a tier; half of each kind have a form that the fitted model cannot take."""

STRATA = {"1-3": (1.2, 2.8), "3-10": (3.3, 9.0), ">10": (11.0, 40.0)}
"""Range from which the target of the signal to floor is drawn, by stratum."""

FAMILIES: tuple[Family, ...] = get_args(Family)

DETECTABLE = 3.0
"""Signal to floor above which an effect should be found: its energy is then three times that of the noise."""

MODEL, MODEL_FORM = "bouc_wen", "bouc_wen"
"""Damper model that is fitted, and the damper form that it can take."""


@dataclass(frozen=True)
class Recipe:
    """What a trial is made from.

    Attributes
    ----------
    seed : int
    plants : mapping
        Number of plants by tier, such as ``rich@500``.
    shares : mapping
        Share of each kind of plant.
    recorded : str
        Folder with recordings of measured dampers, one folder for each damper; for the tier ``replay``.
    family : {"development", "evaluation"}
        Family of the formulas and damper forms. The same seed gives other plants in the other family.
    """

    seed: int
    plants: Mapping[str, int]
    shares: Mapping[str, float] = field(default_factory=lambda: dict(SHARES))
    recorded: str = ""
    family: Family = "development"


@dataclass(frozen=True)
class PlantDesign:
    """One plant to be made.

    Attributes
    ----------
    plant : str
    kind : str
    tier : Tier
    seed : tuple of int
    form : str
        Id of the damper form.
    effects : tuple of str
    targets : tuple of float
        Signal to floor to be reached by each effect.
    damper : str
        Measured damper whose recorded motion is replayed.
    substitutes : tuple of str
        Effects, in this order, for those of a pair that cannot be made detectable.
    family : {"development", "evaluation"}
        Family from which the formulas of the effects are drawn.
    """

    plant: str
    kind: Kind
    tier: Tier
    seed: tuple[int, ...]
    form: str
    effects: tuple[str, ...]
    targets: tuple[float, ...]
    damper: str = ""
    substitutes: tuple[str, ...] = ()
    family: Family = "development"


def design_trial(recipe: Recipe) -> tuple[list[PlantDesign], list[str]]:
    """Return the plants of a trial in random order, and one line for each tier that is left out.

    Raises
    ------
    InputError
        When the recipe cannot be made.
    """
    wrong = {kind: share for kind, share in recipe.shares.items() if kind not in SHARES or not 0 <= share <= 1}
    if wrong or abs(sum(recipe.shares.values()) - 1) > 1e-6:
        raise InputError(f"shares {dict(recipe.shares)}: expected shares of {', '.join(SHARES)} that add up to 1")
    if recipe.family not in FAMILIES:
        raise InputError(f"family {recipe.family}: expected one of {', '.join(FAMILIES)}")
    stream = FAMILIES.index(recipe.family)
    rng = np.random.default_rng([recipe.seed, stream])
    recorded = sorted(read_recorded_dampers(Path(recipe.recorded))) if recipe.recorded else []
    designs: list[PlantDesign] = []
    left_out = []
    for text, count in recipe.plants.items():
        tier = parse_tier(text)
        if tier.excitation == "replay" and not recorded:
            left_out.append(f"{count} plants of the tier replay: no recordings in {recipe.recorded or 'any folder'}")
            continue
        designs += _design_tier(tier, count, recipe, recorded, rng)
    shuffled = [designs[place] for place in rng.permutation(len(designs))]
    return [
        replace(design, plant=f"p{number:04d}", seed=(recipe.seed, stream, number))
        for number, design in enumerate(shuffled, 1)
    ], left_out


def stratum(signal_to_floor: float) -> str:
    """Return the name of the stratum of a signal to floor; empty for 0, without effects."""
    if signal_to_floor == 0.0:
        return ""
    return next((name for limit, name in ((1.0, "<1"), (3.0, "1-3"), (10.0, "3-10")) if signal_to_floor < limit), ">10")


def _design_tier(
    tier: Tier, count: int, recipe: Recipe, recorded: Sequence[str], rng: np.random.Generator
) -> Iterator[PlantDesign]:
    """Yield as many plants of each kind as its share says; effects and strata take turns so that all occur equally often."""
    edges = np.rint(np.cumsum([0.0, *(recipe.shares.get(kind, 0.0) for kind in get_args(Kind))]) * count).astype(int)
    known = [name for name, effect in EFFECTS.items() if effect.in_catalogue]
    absent = [name for name, effect in EFFECTS.items() if not effect.in_catalogue]
    next_form = _turns([name for name, form in DAMPER_FORMS.items() if form.family == recipe.family], rng)
    next_known, next_absent = _turns(known, rng), _turns(absent, rng)
    strata = itertools.cycle(STRATA.values())
    dampers = itertools.cycle(recorded or [""])

    def target(least: float = 0.0) -> float:
        low, high = next((low, high) for low, high in strata if high >= least)
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    for kind, number in zip(get_args(Kind), np.diff(edges), strict=True):
        for place in range(number):
            damper = str(next(dampers)) if tier.excitation == "replay" else ""
            form = next_form() if place % 2 else MODEL_FORM
            design = PlantDesign("", kind, tier, (), form, (), (), damper, family=recipe.family)
            if kind == "single":
                design = replace(design, effects=(next_known(),), targets=(target(),))
            elif kind == "absent":
                design = replace(design, effects=(next_absent(),), targets=(target(),))
            elif kind == "pair":
                first = next_known()
                effects = (first, str(rng.choice([name for name in known if name != first])))
                targets = (target(DETECTABLE), target(DETECTABLE))
                (substitution,) = rng.spawn(1)  # so that what is drawn next does not depend on this
                others = substitution.permutation([name for name in known if name not in effects])
                design = replace(design, effects=effects, targets=targets, substitutes=tuple(map(str, others)))
            yield design


def _turns(names: Sequence[str], rng: np.random.Generator) -> Callable[[], str]:
    """Return a function that gives the names in a random order, again and again."""
    order = itertools.cycle(rng.permutation(names))
    return lambda: str(next(order))
