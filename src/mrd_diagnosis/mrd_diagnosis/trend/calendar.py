"""Dates of runs: given by the user, stored in the recordings, or replaced by the order of the runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import MAXYEAR, MINYEAR, UTC, datetime, timedelta
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.trend.trend_line import FEWEST_DATES
from mrd_diagnosis.wording.quantities import capitalised
from mrd_runs import Run
from mrd_runs.text import named_run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Calendar:
    """Dates at which runs were recorded; runs of one date are fitted with one value.

    Attributes
    ----------
    source : {"given", "recorded", "order"}
        Where the dates are from; ``order`` counts the runs.
    date_index : tuple of int
        Index of the date of each run.
    times : ndarray (dates,)
        Days since the first date, or the numbers of the runs; increasing.
    labels : tuple of str
        The dates as text.
    start : datetime or None
        Time 0; None where runs are counted.
    timed : bool
        Whether the dates are moments of a day, rather than days.
    undated : str
        Name of the first run without a date, where others have one.
    """

    source: Literal["given", "recorded", "order"]
    date_index: tuple[int, ...]
    times: Array
    labels: tuple[str, ...]
    start: datetime | None
    timed: bool = False
    undated: str = ""

    @property
    def origin(self) -> str:
        """Where the dates are from, as a sentence."""
        if self.undated:
            return f"{capitalised(named_run(self.undated))} has no date, so all runs are counted in the given order."
        return {
            "order": "The runs have no dates, so they are counted in the given order.",
            "given": "The dates are those given by the user.",
            "recorded": "The dates are those stored in the recordings.",
        }[self.source]

    @property
    def unit(self) -> str:
        """Unit of the times: ``day`` or ``run``."""
        return "day" if self.start else "run"

    def label(self, time: float) -> str:
        """Write a time as text."""
        if self.start is None:
            return f"run {time:.0f}"
        try:
            return _label(self.start + timedelta(seconds=round(86400.0 * time)), self.timed)
        except OverflowError:
            return f"after the year {MAXYEAR}" if time > 0 else f"before the year {MINYEAR}"

    def by_date(self, runs: Sequence[Run]) -> list[list[Run]]:
        """Group the runs by date."""
        return [
            [run for run, index in zip(runs, self.date_index, strict=True) if index == date]
            for date in range(len(self.times))
        ]

    def before_and_after(self, runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
        """Return the runs of the first and of the last third of the dates: between them, a change is looked for."""
        by_date = self.by_date(runs)
        # Of single runs, a change cannot be told from the scatter.
        third = max(len(by_date) // 3, min(2, len(by_date) // 2))
        before, after = ([run for date in dates for run in date] for dates in (by_date[:third], by_date[-third:]))
        return before, after

    def check(self) -> None:
        """Check that there are enough dates.

        Raises
        ------
        InputError
            For fewer than `FEWEST_DATES`.
        """
        dates = len(self.times)
        if dates < FEWEST_DATES:
            have = f"{dates} date{'s' * (dates != 1)}"
            raise InputError(f"the runs have {have}, expected at least {FEWEST_DATES} to tell a trend from scatter")


def make_calendar(runs: Sequence[Run], dates: Sequence[str] = ()) -> Calendar:
    """Date the runs: as given, otherwise as recorded, otherwise in their order.

    Runs of one day share a date, unless that leaves too few dates.

    Parameters
    ----------
    runs : sequence of Run
    dates : sequence of str
        A date, or a date and time, in ISO 8601 for each run.

    Raises
    ------
    InputError
        For a text that is no date, or another number of dates than of runs.
    """
    if dates and len(dates) != len(runs):
        raise InputError(f"--dates: found {len(dates)} dates for {len(runs)} runs, expected one date for each run")
    recorded = [_parse_date(text) for text in dates] if dates else [_recorded_date(run) for run in runs]
    moments = [moment for moment in recorded if moment is not None]
    if len(moments) < len(runs):
        numbers = np.arange(1.0, len(runs) + 1.0)
        labels = tuple(f"run {number:.0f}" for number in numbers)
        undated = next(run.name for run, moment in zip(runs, recorded, strict=True) if moment is None) if moments else ""
        return Calendar("order", tuple(range(len(runs))), numbers, labels, None, undated=undated)
    # A day is that of the place where the run was recorded.
    days = [moment.replace(hour=0, minute=0, second=0, microsecond=0, tzinfo=UTC) for moment in moments]
    timed = len(set(days)) < FEWEST_DATES
    keys = [moment.astimezone(moments[0].tzinfo) for moment in moments] if timed else days
    distinct = sorted(set(keys))
    times = np.array([(moment - distinct[0]) / timedelta(days=1) for moment in distinct])
    labels = tuple(_label(moment, timed) for moment in distinct)
    date_index = tuple(distinct.index(key) for key in keys)
    return Calendar("given" if dates else "recorded", date_index, times, labels, distinct[0], timed)


def _label(moment: datetime, timed: bool) -> str:
    return f"{moment:%Y-%m-%d %H:%M:%S}" if timed else f"{moment:%Y-%m-%d}"


def _parse_date(text: str) -> datetime:
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        raise InputError(
            f"--dates: {text!r} is not a date, expected a date such as 2024-05-31 or 2024-05-31T14:00"
        ) from None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def _recorded_date(run: Run) -> datetime | None:
    """Return when a run was recorded, as its bag says; None where it does not say."""
    try:
        return _parse_date(str(run.info.get("started", "")))
    except InputError:
        return None
