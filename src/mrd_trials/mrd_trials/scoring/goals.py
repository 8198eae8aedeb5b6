"""Goals of a trial: which figures of which tier should lie in which range."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mrd_trials.excitation import BEFORE_AFTER, BLACK_BOX, SEMIREAL
from mrd_trials.scoring.gap import LARGE_GAP
from mrd_trials.scoring.rates import Calibration, Distribution, Rate
from mrd_trials.scoring.tier_score import TierScore

Figure = Rate | Distribution | Calibration
"""A figure that a goal is about."""

Range = tuple[float, float]

Judgement = Literal["met", "not met", "undecided"]

TIERS: Mapping[str, str] = {
    "rich": "simulated",
    BLACK_BOX: "black box as simulator",
    SEMIREAL: "measured recordings",
    BEFORE_AFTER: "before and after",
}
"""Tiers that have goals, and what they are called."""

LEAST_CLAIMS = 100
"""Claims from which a calibration error says more than chance does."""


@dataclass(frozen=True)
class Goal:
    """A figure with the ranges that it should lie in.

    Attributes
    ----------
    text : str
    figure : callable
        Takes the figure from a `TierScore`.
    wanted : mapping
        Range by tier; in other tiers, the figure has no goal.
    is_share : bool
        Whether the range is written in per cent.
    """

    text: str
    figure: Callable[[TierScore], Figure]
    wanted: Mapping[str, Range]
    is_share: bool = True


def judge(figure: Figure, wanted: Range) -> Judgement:
    """Return whether a figure lies in a range; undecided where one case that had gone the other way would change that."""
    (least, most), (lower, upper) = wanted, _with_one_changed(figure)
    if least <= lower and upper <= most:
        return "met"
    return "not met" if upper < least or lower > most else "undecided"


def _with_one_changed(figure: Figure) -> Range:
    """Return between what a figure would lie if one case had been different; nan where there are too few cases to tell."""
    if isinstance(figure, Calibration):
        error = figure.error if figure.count >= LEAST_CLAIMS else np.nan
        return error, error
    if isinstance(figure, Rate):
        ends = max(figure.hits - 1, 0), min(figure.hits + 1, figure.total)
        return (ends[0] / figure.total, ends[1] / figure.total) if figure.total else (np.nan, np.nan)
    if not figure.values:
        return np.nan, np.nan
    ordered = sorted(figure.values)
    return float(np.median([-np.inf, *ordered[:-1]])), float(np.median([*ordered[1:], np.inf]))


def _wanted(
    rich: Range | None = None, black_box: Range | None = None, semireal: Range | None = None, change: Range | None = None
) -> dict[str, Range]:
    ranges = zip(TIERS, (rich, black_box, semireal, change), strict=True)
    return {tier: wanted for tier, wanted in ranges if wanted}


def _least(value: float) -> Range:
    return value, np.inf


def _most(value: float) -> Range:
    return -np.inf, value


GOALS = (
    Goal(
        "detectable single effects: class named",
        lambda score: score.classes.right,
        _wanted(_least(0.92), _least(0.85), _least(0.85), _least(0.95)),
    ),
    Goal(
        "right effect, of those named by themselves",
        lambda score: score.classes.effect,
        _wanted(semireal=_least(0.8), change=_least(0.8)),
    ),
    Goal(
        "detectable single effects: cause named, by itself or first of its class",
        lambda score: score.classes.cause,
        _wanted(semireal=_least(0.6), change=_least(0.8)),
    ),
    Goal(
        "wrong class named, beyond the background",
        lambda score: score.classes.wrong,
        _wanted(semireal=_most(0.1), change=_most(0.1)),
    ),
    Goal("pairs: both classes named", lambda score: score.classes.both, _wanted(_least(0.8), _least(0.8))),
    Goal(
        "something named where nothing is wrong, or nothing has changed",
        lambda score: score.classes.null,
        _wanted(_most(0.05), _most(0.05), None, _most(0.05)),
    ),
    Goal("absent effects with a wrong name", lambda score: score.classes.absent, _wanted(*4 * [_most(0.1)])),
    Goal(
        "the set of 90 % holds the cause, where the class is right",
        lambda score: score.classes.covered,
        _wanted(semireal=(0.87, 0.95), change=(0.87, 0.95)),
    ),
    Goal(
        "effects in a set, median (quartiles)",
        lambda score: score.classes.set_sizes,
        _wanted(semireal=_most(2.0), change=_most(2.0)),
        is_share=False,
    ),
    Goal(
        f"calibration error of the names, from {LEAST_CLAIMS} claims on",
        lambda score: score.calibration,
        _wanted(*4 * [_most(0.08)]),
        is_share=False,
    ),
    Goal(
        "share closed, over that of the oracle, median (quartiles)",
        lambda score: score.relative_closure,
        _wanted(semireal=_least(0.9)),
        is_share=False,
    ),
    Goal(
        f"a place is named, where the squared error is {LARGE_GAP:g} times the noise",
        lambda score: score.places,
        _wanted(semireal=_least(0.98), change=_least(0.98)),
    ),
    Goal("95 % intervals of sizes that hold the true one", lambda score: score.coverage, _wanted((0.9, 0.99), (0.9, 0.99))),
    Goal(
        "overlap of the map with the true one, median (quartiles)",
        lambda score: score.maps.overlap,
        _wanted(_least(0.9)),
        is_share=False,
    ),
    Goal(
        "causes named around one of several models: around all",
        lambda score: score.around_models,
        _wanted(_least(0.9), None, _least(0.9), _least(0.9)),
    ),
)
"""All goals."""
