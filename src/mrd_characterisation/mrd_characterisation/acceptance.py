"""Acceptance of a damper by limits. A number passes where its whole 95 % interval lies within them."""

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

from mrd_base import InputError
from mrd_base.notebook import html_table, text_table
from mrd_characterisation.characterisation import QUANTITIES, Characterisation, Value
from mrd_characterisation.characterise import characterise
from mrd_characterisation.damper_test import DamperTest
from mrd_characterisation.force_speed import SAME_PLATEAU
from mrd_characterisation.limits import Limit, resisting
from mrd_characterisation.units import BENCH, View
from mrd_characterisation.wording import band_text, conditions_text, difference_text, number_text, range_text
from mrd_runs import Run

Outcome = Literal["pass", "fail", "not_decided", "not_measured"]
OUTCOMES: tuple[Outcome, ...] = ("fail", "not_decided", "not_measured", "pass")
"""In the order in which they are listed."""

Verdict = Literal["pass", "fail", "not_decided"]


@dataclass(frozen=True)
class Check:
    """A limit, and the number that it is for.

    Attributes
    ----------
    limit : Limit
    value : Value or None
        A force of a direction as it resists the motion; None where the recordings do not show it.
    """

    limit: Limit
    value: Value | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the value; the value itself for an extreme of the recordings, which has none; else nan."""
        value = self.value
        if value is None:
            return math.nan, math.nan
        return (value.value, value.value) if value.cycles == 0 else (value.lower, value.upper)

    @property
    def outcome(self) -> Outcome:
        """Whether the whole interval lies within the limits (pass), or beyond one (fail), or neither."""
        if self.value is None:
            return "not_measured"
        lower, upper = self.interval
        if lower >= self.limit.lower and upper <= self.limit.upper:
            return "pass"
        return "fail" if upper < self.limit.lower or lower > self.limit.upper else "not_decided"

    @property
    def excess(self) -> float:
        """By how much the value lies above the upper limit (positive) or below the lower one (negative); 0 between them."""
        if self.value is None:
            return math.nan
        return max(self.value.value - self.limit.upper, 0.0) + min(self.value.value - self.limit.lower, 0.0)

    @property
    def severity(self) -> float:
        """The excess over half the width of the band, or over the limit where the band is open; 0 within the limits."""
        lower, upper = self.limit.lower, self.limit.upper
        width = 0.5 * (upper - lower)
        scale = width if math.isfinite(width) else min(abs(lower), abs(upper))
        if self.value is None or not self.excess:
            return 0.0
        return abs(self.excess) / scale if scale else math.inf

    def why(self, view: View = BENCH) -> str:
        """Return what keeps it from passing; empty where it passes."""
        unit = self.limit.unit
        if self.value is None:
            return "not recorded"
        if self.outcome == "fail":
            side = "above" if self.excess > 0.0 else "below"
            return f"{difference_text(abs(self.excess), unit, view)} {side}"
        if self.outcome == "not_decided":
            if math.isnan(self.interval[0]):
                return "no interval"
            return "crosses a limit"
        return ""


@dataclass(frozen=True, eq=False, repr=False)
class Acceptance:
    """The verdict on a damper.

    Attributes
    ----------
    test : DamperTest
    characterisation : Characterisation
    checks : tuple of Check
        At least one.
    reference : str
        What the limits are from, in words.
    golden_sources : tuple of str
        Files of the runs of the golden damper; empty where there is none or they are not known.
    """

    test: DamperTest
    characterisation: Characterisation
    checks: tuple[Check, ...]
    reference: str
    golden_sources: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Fails where one number fails; passes where all pass."""
        outcomes = {check.outcome for check in self.checks}
        return "fail" if "fail" in outcomes else "pass" if outcomes == {"pass"} else "not_decided"

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        counts = {outcome: sum(check.outcome == outcome for check in self.checks) for outcome in OUTCOMES}
        words = {"fail": "failed", "not_decided": "not decided", "not_measured": "not measured", "pass": "passed"}
        listed = ", ".join(f"{counts[outcome]} {words[outcome]}" for outcome in OUTCOMES if counts[outcome])
        verdict = {"pass": "passes", "fail": "fails", "not_decided": "is not decided"}[self.verdict]
        return f"{self.test.serial} {verdict} against {self.reference}: of {len(self.checks)} numbers, {listed}."

    def worst_sentence(self, view: View = BENCH) -> str:
        """Return which of the failed numbers lies furthest beyond its limits; empty where none failed."""
        failed = [check for check in self.checks if check.outcome == "fail"]
        if not failed:
            return ""
        worst = max(failed, key=lambda check: check.severity)
        _, title, at, value, _, limits, _ = check_row(worst, view)
        return f"Furthest out: {title}{f' ({at})' if at else ''} is {value}, allowed {limits}."

    @property
    def by_outcome(self) -> list[Check]:
        """The checks, those that did not pass first."""
        return sorted(self.checks, key=lambda check: OUTCOMES.index(check.outcome))

    def __repr__(self) -> str:
        return f"<Acceptance of {self.test.serial}: {self.verdict}>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(self.sentence)}</p>{html_table([HEAD, *map(check_row, self.by_outcome)])}"

    def summary(self) -> str:
        """Return the verdict and the checks that did not pass as text."""
        open_checks = [check for check in self.by_outcome if check.outcome != "pass"]
        return "\n".join([self.sentence, *(text_table([HEAD, *map(check_row, open_checks)]) if open_checks else [])])


HEAD = ("verdict", "quantity", "conditions", "value", "95 % interval", "limits", "why")
"""Head of the table whose rows `check_row` makes."""


def check_row(check: Check, view: View = BENCH) -> tuple[str, ...]:
    """Return a check as a row of a table."""
    limit, value = check.limit, check.value
    lower, upper = check.interval
    return (
        check.outcome.replace("_", " "),
        QUANTITIES[limit.quantity].title,
        conditions_text(value or limit, view),
        "–" if value is None else number_text(value.value, limit.unit, view),
        "–" if math.isnan(lower) else range_text(lower, upper, limit.unit, view),
        band_text(limit.lower, limit.upper, limit.unit, view),
        check.why(view),
    )


def accept(
    characterisation: Characterisation,
    limits: Sequence[Limit],
    test: DamperTest,
    *,
    reference: str = "limits",
    golden_sources: Sequence[str] = (),
) -> Acceptance:
    """Judge a damper by limits.

    Parameters
    ----------
    characterisation : Characterisation
    limits : sequence of Limit
        See `read_limits` and `golden_limits`.
    test : DamperTest
    reference : str
        What the limits are from, in words.
    golden_sources : sequence of str
        Files of the runs of the golden damper.

    Raises
    ------
    InputError
        Without limits, and where the recordings show none of the numbers, as those of another test: says what was recorded.
    """
    if not limits:
        raise InputError(f"{reference}: holds no limits, expected at least one")
    checks: list[Check] = []
    for limit in limits:
        checks += [Check(limit, value) for value in _values(characterisation, limit)] or [Check(limit)]
    if all(check.value is None for check in checks):
        raise InputError(
            f"{test.serial}: shows none of the {len(limits)} numbers of {reference}: it was recorded at "
            f"{_extent(characterisation.values)}, the limits are for {_extent(limits)}; record the same test"
        )
    return Acceptance(test, characterisation, tuple(checks), reference, tuple(golden_sources))


_AT_SPEEDS = ("force_at_speed", "asymmetry", "dynamic_range")  # the speeds of these are chosen, not those of strokes


def _values(characterisation: Characterisation, limit: Limit) -> list[Value]:
    values = characterisation.alike(limit)
    speed = limit.speed
    if speed and limit.quantity in _AT_SPEEDS:
        # Only strokes of constant speed show no other, and those within this of it.
        off = [abs((value.speed or 0.0) - speed) for value in values]
        most = min([SAME_PLATEAU * speed, *off]) + 1e-9 * speed
        values = [value for value, by in zip(values, off, strict=True) if by <= most]
    return [resisting(value) for value in values]


def _extent(items: Sequence[Value] | Sequence[Limit]) -> str:
    """Return the currents and the speeds of values or limits in words."""
    currents = sorted({round(item.current, 3) for item in items if item.current is not None})
    speeds = [item.speed for item in items if item.speed is not None]
    amperes = ", ".join(f"{current:g}" for current in currents)
    reach = f"{1e3 * min(speeds):.3g} to {1e3 * max(speeds):.3g} mm/s" if speeds else "no speed"
    return f"{amperes + ' A' if amperes else 'no current'} and {reach}"


def characterise_for(runs: Sequence[Run], limits: Sequence[Limit], name: str) -> Characterisation:
    """Characterise a damper, with the forces at the speeds that limits ask for as far as its strokes show them.

    Parameters
    ----------
    runs : sequence of Run
    limits : sequence of Limit
    name : str
        Of the damper.
    """
    usual = characterise(runs, name=name)
    asked = {limit.speed for limit in limits if limit.quantity in _AT_SPEEDS and limit.speed}
    speeds = sorted({value.speed for value in usual.values if value.quantity == "force_at_speed" and value.speed})
    missing = sorted(one for one in asked if not any(math.isclose(one, speed) for speed in speeds))
    for some in (missing, *([speed] for speed in missing)) if missing else ():
        # A speed that no stroke shows is refused; then each is tried alone, and the limit of a refused one is not measured.
        with contextlib.suppress(InputError):
            usual = characterise(runs, name=name, speeds=[*speeds, *some])
            speeds += some
            if some is missing:
                break
    return usual
