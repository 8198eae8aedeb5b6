"""Design of a trial: which plants it has, of which kinds, with which effects at which strengths."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeVar, get_args

import numpy as np

from mrd_base import InputError
from mrd_trials.excitation import (
    BEFORE_AFTER,
    BLACK_BOX,
    FRESH_RUNS,
    FROM_RECORDINGS,
    SEMIREAL,
    Tier,
    parse_tier,
    recorded_checksums,
    recorded_files,
)
from mrd_trials.records import GroundTruth, Kind
from mrd_trials.size import Size, draw_size
from mrd_trials.truth import ALTERATIONS, DAMPER_FORMS, EFFECTS, Family

T = TypeVar("T")

SHARES: Mapping[str, float] = {"null": 0.25, "single": 0.40, "pair": 0.15, "absent": 0.20}
"""Share of each kind among the plants of a tier; half of each kind have a form that the fitted model cannot take."""

STRATA = {"1-3": (1.2, 2.8), "3-10": (3.3, 9.0), ">10": (11.0, 40.0)}
"""Range from which the target of the signal to floor is drawn, by stratum."""

RECORDED_STRATA = {"10-25 %": (0.13, 0.3), "25-50 %": (0.37, 0.9), "50-75 %": (1.1, 2.7)}
"""The same for effects put into recordings, by the share of the squared error that refitting without them would remove."""

SIGNAL_LIMITS = ((1.0, "<1"), (3.0, "1-3"), (10.0, "3-10"), (np.inf, ">10"))
SHARE_LIMITS = ((1 / 9, "<10 %"), (1 / 3, "10-25 %"), (1.0, "25-50 %"), (3.0, "50-75 %"), (np.inf, ">75 %"))
"""Upper end and name of each stratum of the signal to floor, and of the added error."""

RECORDED_DETECTABLE = 1 / 3
"""Added error above which an effect put into recordings should be found: it is then a quarter of the squared error."""

ALTERED_TIERS = (SEMIREAL, BEFORE_AFTER)
"""Tiers of measured recordings into which effects are put."""

SUBSTITUTES = 3
"""Effects that may take the place of one that cannot be made strong enough in measured recordings. With all of them, the few
that can always be made strong, such as an end stop, were half of all plants."""

LEAST_RECORDINGS = FRESH_RUNS + 4
"""Recordings that a damper of these tiers needs: two for each half of a comparison."""

FAMILIES: tuple[Family, ...] = get_args(Family)

DETECTABLE = 3.0
"""Signal to floor above which an effect should be found: its energy is then three times that of the noise."""

MODEL, MODEL_FORM = "bouc_wen", "bouc_wen"
"""Damper model that is fitted, and the damper form that it can take."""

Sizes = Literal["drawn", "reference"]
Starts = Literal["drawn", "rest"]

SIZES: tuple[Sizes, ...] = get_args(Sizes)
STARTS: tuple[Starts, ...] = get_args(Starts)

IN_MOTION = 0.5
"""Share of the plants whose recordings begin in mid-motion."""

SIZE_STREAM, BACKGROUND_SIZE_STREAM = 9, 10
"""Numbers of the random streams, beside those of a plant's design, that give size and start of a plant or a background."""

RECORDED_MODELS = (MODEL, "shear_thinning_bouc_wen")
"""Damper models that are fitted to backgrounds, in turn: the better a model, the smaller are the errors that can be seen."""


@dataclass(frozen=True)
class Recipe:
    """Inputs from which a trial is made.

    Attributes
    ----------
    seed : int
    plants : mapping
        Number of plants by tier, such as ``rich@500``.
    shares : mapping
        Share of each kind of plant.
    recorded : str
        Folder with recordings of measured dampers, one folder for each damper; for the tiers
        ``replay``, ``semireal`` and ``before_after``.
    family : {"development", "evaluation"}
        Family of the formulas and damper forms. The same seed gives other plants in the other family.
    sizes : {"drawn", "reference"}
        Whether every plant has a size of its own, or that of the reference damper; measured dampers keep theirs then. The
        same seed gives the same plants in other units.
    starts : {"drawn", "rest"}
        Whether the recordings of half of the plants begin in mid-motion, or all begin as they were recorded.
    checksums : mapping, optional
        SHA-256 of the recordings of each measured damper (`with_recordings`): with others, the same seed gives other plants.
    """

    seed: int
    plants: Mapping[str, int]
    shares: Mapping[str, float] = field(default_factory=lambda: dict(SHARES))
    recorded: str = ""
    family: Family = "development"
    sizes: Sizes = "drawn"
    starts: Starts = "drawn"
    checksums: Mapping[str, str] | None = None


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
        Effects, in this order, for those that cannot be made strong enough; where none can, the strongest is taken.
    model : str
        Id of the damper model to be fitted.
    background : int
        Number of the untouched recordings into which the effects are put; 0 for a simulated plant.
    same_runs : bool
        Whether a comparison has the same runs before and after; else the two share none.
    family : {"development", "evaluation"}
        Family from which the formulas of the effects are drawn.
    size : Size or None
        Size of the plant; None where simulated dampers have the reference size and measured ones their own.
    start_seed : int or None
        Seed of what is cut off at the start of the runs; None where nothing is.
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
    model: str = MODEL
    background: int = 0
    family: Family = "development"
    size: Size | None = None
    start_seed: int | None = None
    same_runs: bool = False

    @property
    def background_key(self) -> tuple[int, ...]:
        """Key of the random streams that all plants on one background share, and no others."""
        return (*self.seed[:2], ALTERED_TIERS.index(self.tier.excitation), self.background)


def with_recordings(recipe: Recipe) -> Recipe:
    """Return a recipe with the full path and the checksums of its recordings."""
    if not recipe.recorded:
        return recipe
    folder = Path(recipe.recorded).resolve()
    return replace(recipe, recorded=str(folder), checksums=recorded_checksums(folder))


def design_trial(recipe: Recipe) -> tuple[list[PlantDesign], list[str]]:
    """Return the plants of a trial in random order, and one line for each tier that is left out.

    Raises
    ------
    InputError
        When the recipe cannot be made, or the recordings are not those of its checksums.
    """
    wrong = {kind: share for kind, share in recipe.shares.items() if kind not in SHARES or not 0 <= share <= 1}
    if wrong or abs(sum(recipe.shares.values()) - 1) > 1e-6:
        raise InputError(f"shares {dict(recipe.shares)}: expected shares of {', '.join(SHARES)} that add up to 1")
    if recipe.family not in FAMILIES:
        raise InputError(f"family {recipe.family}: expected one of {', '.join(FAMILIES)}")
    for what, value, known in (("sizes", recipe.sizes, SIZES), ("starts", recipe.starts, STARTS)):
        if value not in known:
            raise InputError(f"{what} {value}: expected one of {', '.join(known)}")
    stream = FAMILIES.index(recipe.family)
    rng = np.random.default_rng([recipe.seed, stream])
    files = recorded_files(Path(recipe.recorded)) if recipe.recorded else {}
    if recipe.checksums is not None:
        _require_recordings(recipe.recorded, recipe.checksums)
    designs: list[PlantDesign] = []
    left_out = []
    for text, count in recipe.plants.items():
        tier = parse_tier(text)
        least = LEAST_RECORDINGS if tier.excitation in ALTERED_TIERS else 0
        recorded = [name for name, of_damper in files.items() if len(of_damper) >= least]
        left_out += [
            f"damper {name} in the tier {tier}: has {len(of_damper)} recordings, expected {least} at least"
            for name, of_damper in files.items()
            if len(of_damper) < least
        ]
        if tier.excitation in FROM_RECORDINGS and not recorded:
            left_out.append(f"{count} plants of the tier {tier}: no recordings in {recipe.recorded or 'any folder'}")
            continue
        design_tier = _design_altered_tier if tier.excitation in ALTERED_TIERS else _design_tier
        designs += design_tier(tier, count, recipe, recorded, rng)
    shuffled = [designs[place] for place in rng.permutation(len(designs))]
    return [
        _with_size_and_start(replace(design, plant=f"p{number:04d}", seed=(recipe.seed, stream, number)), recipe)
        for number, design in enumerate(shuffled, 1)
    ], left_out


def _require_recordings(recorded: str, expected: Mapping[str, str]) -> None:
    """Refuse recordings with other checksums: the plants would be other ones."""
    found = recorded_checksums(Path(recorded))
    if other := sorted(name for name in found.keys() | expected.keys() if found.get(name) != expected.get(name)):
        raise InputError(
            f"{recorded}: the recordings of {', '.join(other)} are not those of the trial, expected the dampers "
            f"{', '.join(expected) or 'none'} as they were when it was made"
        )


def _with_size_and_start(design: PlantDesign, recipe: Recipe) -> PlantDesign:
    """Draw size and start of a plant; all plants on one background have the same ones."""
    key = (*design.background_key, BACKGROUND_SIZE_STREAM) if design.background else (*design.seed, SIZE_STREAM)
    rng = np.random.default_rng(key)
    size, begins_in_motion, seed = draw_size(rng), rng.random() < IN_MOTION, int(rng.integers(2**62))
    return replace(
        design,
        size=size if recipe.sizes == "drawn" else None,
        start_seed=seed if begins_in_motion and recipe.starts == "drawn" else None,
    )


def untouched_plants(designs: Iterable[PlantDesign]) -> dict[tuple[str, int], str]:
    """Return the name of the plant whose recordings are untouched, by tier and background."""
    return {
        (str(design.tier), design.background): design.plant
        for design in designs
        if design.background and design.kind == "null"
    }


def stratum(strength: float, excitation: str) -> str:
    """Return the name of the stratum of a signal to floor or an added error; empty for 0, without effects."""
    if strength == 0.0:
        return ""
    limits = SHARE_LIMITS if excitation in ALTERED_TIERS else SIGNAL_LIMITS
    return next(name for limit, name in limits if strength < limit)


def is_detectable(truth: GroundTruth) -> bool:
    """Whether the effects of a plant are strong enough to be found."""
    return truth.signal_to_floor > (RECORDED_DETECTABLE if truth.excitation in ALTERED_TIERS else DETECTABLE)


def _design_tier(
    tier: Tier, count: int, recipe: Recipe, recorded: Sequence[str], rng: np.random.Generator
) -> Iterator[PlantDesign]:
    """Yield as many plants of each kind as its share says; effects and strata take turns so that all occur equally often."""
    known = [name for name, effect in EFFECTS.items() if effect.in_catalogue]
    absent = [name for name, effect in EFFECTS.items() if not effect.in_catalogue]
    next_form = _turns([name for name, form in DAMPER_FORMS.items() if form.family == recipe.family], rng)
    next_known, next_absent = _turns(known, rng), _turns(absent, rng)
    target = _targets(STRATA, rng)
    dampers = itertools.cycle(recorded or [""])
    for kind, number in _numbers(recipe.shares, count):
        for place in range(number):
            damper = str(next(dampers)) if tier.excitation == "replay" else ""
            form = next_form() if place % 2 or tier.excitation == BLACK_BOX else MODEL_FORM
            design = PlantDesign("", kind, tier, (), form, (), (), damper, family=recipe.family)
            if kind == "single":
                effect = next_known()
                design = replace(design, effects=(effect,), targets=(target(effect),))
            elif kind == "absent":
                effect = next_absent()
                design = replace(design, effects=(effect,), targets=(target(effect),))
            elif kind == "pair":
                first = next_known()
                effects = (first, str(rng.choice([name for name in known if name != first])))
                targets = tuple(target(effect, DETECTABLE) for effect in effects)
                (substitution,) = rng.spawn(1)  # so that what is drawn next does not depend on this
                others = substitution.permutation([name for name in known if name not in effects])
                design = replace(design, effects=effects, targets=targets, substitutes=tuple(map(str, others)))
            yield design


def _design_altered_tier(
    tier: Tier, count: int, recipe: Recipe, recorded: Sequence[str], rng: np.random.Generator
) -> Iterator[PlantDesign]:
    """Yield plants of measured recordings: the untouched ones are the null plants, and the others are based on them."""
    backgrounds = dict(_numbers(recipe.shares, count))["null"]
    if count and not backgrounds:
        raise InputError(
            f"tier {tier}: {count} plants without a null plant, expected one at least: it is what others change"
        )
    target = _targets(RECORDED_STRATA, rng)
    names = {
        "absent": [name for name in ALTERATIONS if not EFFECTS[name].in_catalogue],
        "single": [name for name in ALTERATIONS if EFFECTS[name].in_catalogue],
    }
    names["pair"] = names["single"]
    turns = {kind: _turns(of_kind, rng) for kind, of_kind in names.items()}
    next_substitute = {kind: _turns(of_kind, rng) for kind, of_kind in names.items()}
    next_same_runs = _turns((True, False), rng)
    background = itertools.cycle(range(1, backgrounds + 1))
    for kind, number in _numbers(recipe.shares, count):
        for _ in range(number):
            place = next(background)
            turn, which = divmod(place - 1, len(recorded))
            damper, model = recorded[which], RECORDED_MODELS[(turn + which) % len(RECORDED_MODELS)]
            design = PlantDesign("", kind, tier, (), damper, (), (), damper, (), model, place, recipe.family)
            if kind != "null":
                first = turns[kind]()
                if kind == "pair":
                    others = [str(name) for name in rng.permutation(names[kind]) if name != first]
                    effects: tuple[str, ...] = (first, others.pop())
                else:
                    others, effects = _others(first, next_substitute[kind]), (first,)
                targets = tuple(target(effect, RECORDED_DETECTABLE if kind == "pair" else 0.0) for effect in effects)
                same_runs = tier.excitation == BEFORE_AFTER and next_same_runs()
                design = replace(design, effects=effects, targets=targets, substitutes=tuple(others), same_runs=same_runs)
            yield design


def _others(effect: str, next_other: Callable[[], str]) -> list[str]:
    """Return the next `SUBSTITUTES` different effects in turn that are not this one."""
    others: list[str] = []
    while len(others) < SUBSTITUTES:
        other = next_other()
        if other not in (effect, *others):
            others.append(other)
    return others


def _numbers(shares: Mapping[str, float], count: int) -> list[tuple[Kind, int]]:
    """Return the number of plants of each kind."""
    edges = np.rint(np.cumsum([0.0, *(shares.get(kind, 0.0) for kind in get_args(Kind))]) * count).astype(int)
    return list(zip(get_args(Kind), map(int, np.diff(edges)), strict=True))


def _targets(ranges: Mapping[str, tuple[float, float]], rng: np.random.Generator) -> Callable[..., float]:
    """Return a function that draws a target for an effect, from those above a least one if it is given.

    Each effect has the strata in turn, and as many effects begin with one as with another.
    """
    strata = list(ranges.values())
    begin = _turns(range(len(strata)), rng)
    turns: dict[str, Iterator[tuple[float, float]]] = {}

    def target(effect: str, least: float = 0.0) -> float:
        if effect not in turns:
            place = begin()
            turns[effect] = itertools.cycle([*strata[place:], *strata[:place]])
        low, high = next((low, high) for low, high in turns[effect] if high >= least)
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return target


def _turns(items: Sequence[T], rng: np.random.Generator) -> Callable[[], T]:
    """Return a function that gives the items again and again, each time in another random order."""

    def in_turn() -> Iterator[T]:
        while True:
            yield from (items[place] for place in rng.permutation(len(items)))

    return in_turn().__next__
