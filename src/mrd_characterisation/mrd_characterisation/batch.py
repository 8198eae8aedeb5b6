"""A batch of dampers: what their acceptances or characterisations tell together."""

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from mrd_base import InputError
from mrd_base.notebook import html_table, text_table
from mrd_base.text_file import read_text_file
from mrd_characterisation import acceptance_file, characterisation_file
from mrd_characterisation.characterisation import QUANTITIES, SAME_CURRENT, SAME_SPEED
from mrd_characterisation.wording import band_text, conditions_text, difference_text, number_text

Array = NDArray[np.float64]

VERDICTS = {"pass": "passed", "fail": "failed", "not_decided": "not decided", "": "not judged"}
"""Verdicts on a damper, and how they are written; "" where there is only a characterisation."""

FEWEST_DATES = 3
"""Days with tests that a slope needs: there is scatter around it, and it does not make months of minutes."""


class Key(NamedTuple):
    """What a number is of: quantity and conditions, in SI units; None where a condition does not apply."""

    quantity: str
    direction: str | None
    current: float | None
    current_before: float | None
    speed: float | None
    stroke: float | None


@dataclass(frozen=True)
class Number:
    """A number of one test, and the limits for it, which are infinite where there are none."""

    key: Key
    value: float
    lower: float = -math.inf
    upper: float = math.inf
    outcome: str = ""


@dataclass(frozen=True)
class Entry:
    """A test of the batch.

    Attributes
    ----------
    file : Path
        The acceptance.json or characterisation.json.
    serial : str
    date : datetime or None
    verdict : str
        "pass", "fail" or "not_decided"; empty where there is only a characterisation.
    numbers : tuple of Number
    runs : tuple of str
        Files of the recordings, as far as they are known.
    """

    file: Path
    serial: str
    date: datetime | None
    verdict: str
    numbers: tuple[Number, ...]
    runs: tuple[str, ...] = ()

    @property
    def failed(self) -> int:
        """How many numbers failed."""
        return sum(number.outcome == "fail" for number in self.numbers)


@dataclass(frozen=True, eq=False)
class Statistic:
    """One number over the tests of a batch.

    Attributes
    ----------
    key : Key
    values : ndarray (n,)
        In the order of the tests.
    times : ndarray (n,)
        Days since the first test of the batch; nan where a test has no date.
    entries : tuple of Entry
        The tests (n).
    lower, upper : float
        Limits; infinite where there are none, or not the same for all tests.
    """

    key: Key
    values: Array
    times: Array
    entries: tuple[Entry, ...]
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def title(self) -> str:
        """The quantity and its conditions."""
        return ", ".join(filter(None, (QUANTITIES[self.key.quantity].title, conditions_text(self.key))))

    @property
    def unit(self) -> str:
        """SI unit."""
        return QUANTITIES[self.key.quantity].unit

    @property
    def mean(self) -> float:
        """Mean of the values."""
        return float(self.values.mean())

    @property
    def deviation(self) -> float:
        """Standard deviation of the values; nan for a single one."""
        return float(self.values.std(ddof=1)) if len(self.values) > 1 else math.nan

    @property
    def capability(self) -> tuple[float, float]:
        """Cp and Cpk; see `capability`."""
        return capability(self.mean, self.deviation, self.lower, self.upper)

    @property
    def slope(self) -> tuple[float, float, float] | None:
        """Change per day with its 95 % interval; None for tests on fewer than `FEWEST_DATES` dates of the calendar."""
        dates = {entry.date.date() for entry in self.entries if entry.date}
        return slope(self.times, self.values) if len(dates) >= FEWEST_DATES else None


def capability(mean: float, deviation: float, lower: float, upper: float) -> tuple[float, float]:
    """Return the process capability indices Cp and Cpk (Kane, 1986).

    Cp = (upper - lower) / 6 s, and Cpk = min(upper - mean, mean - lower) / 3 s, where s is the standard deviation of all
    dampers of the batch (some call them Pp and Ppk then). Both are nan without scatter or limits; Cp also
    where there is only one limit.
    """
    if not deviation > 0.0:
        return math.nan, math.nan
    nearest = min(upper - mean, mean - lower)
    width = upper - lower
    return (
        width / (6.0 * deviation) if math.isfinite(width) else math.nan,
        nearest / (3.0 * deviation) if math.isfinite(nearest) else math.nan,
    )


def slope(times: Array, values: Array) -> tuple[float, float, float] | None:
    """Return the slope of values over times in days with its 95 % interval; None for fewer than three distinct times."""
    dated = np.isfinite(times)
    if len(np.unique(times[dated])) < 3:
        return None
    if np.ptp(values[dated]) == 0.0:
        return 0.0, 0.0, 0.0
    from scipy.stats import linregress  # a third of a second, which other tools need not wait for

    line = linregress(times[dated], values[dated])
    half = float(stdtrit(np.count_nonzero(dated) - 2, 0.975) * line.stderr)
    return float(line.slope), float(line.slope) - half, float(line.slope) + half


@dataclass(frozen=True, eq=False, repr=False)
class Batch:
    """The tests of a batch and their statistics.

    Attributes
    ----------
    folder : Path
    entries : tuple of Entry
        By date, then by serial number.
    statistics : tuple of Statistic
        In the order of `QUANTITIES`, then by conditions.
    notes : tuple of str
        What was found beside: files that cannot be read, several tests of a damper on one day, limits that differ.
    """

    folder: Path
    entries: tuple[Entry, ...]
    statistics: tuple[Statistic, ...]
    notes: tuple[str, ...] = ()

    def count(self, verdict: str) -> int:
        """Return the number of tests with a verdict."""
        return sum(entry.verdict == verdict for entry in self.entries)

    @property
    def sentence(self) -> str:
        """The batch in one sentence."""
        serials = len({entry.serial for entry in self.entries})
        counts = ", ".join(f"{self.count(verdict)} {word}" for verdict, word in VERDICTS.items() if self.count(verdict))
        tests = f"{len(self.entries)} test" + "s" * (len(self.entries) > 1)
        return f"{tests} of {serials} serial number{'s' * (serials > 1)}: {counts}."

    def __repr__(self) -> str:
        return f"<Batch of {len(self.entries)} tests>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(self.sentence)}</p>{html_table([HEAD, *map(statistic_row, self.statistics)])}"

    def summary(self) -> str:
        """Return the statistics and the notes as text."""
        rows = [HEAD, *map(statistic_row, self.statistics)]
        return "\n".join([self.sentence, *text_table(rows), *(f"note: {note}" for note in self.notes)])


HEAD = ("quantity", "conditions", "tests", "mean", "std", "least", "largest", "limits", "Cp", "Cpk", "change per 30 days")
"""Head of the table whose rows `statistic_row` makes."""

MONTH = 30.0
"""Days over which a slope is stated."""


def statistic_row(statistic: Statistic) -> tuple[str, ...]:
    """Return a statistic as a row of a table."""
    unit, trend = statistic.unit, statistic.slope
    cp, cpk = statistic.capability
    change = "–"
    if trend:
        low, high = (difference_text(MONTH * end, unit) for end in trend[1:])
        change = f"{difference_text(MONTH * trend[0], unit)} ({low} to {high})"
    return (
        QUANTITIES[statistic.key.quantity].title,
        conditions_text(statistic.key),
        str(len(statistic.values)),
        number_text(statistic.mean, unit),
        difference_text(statistic.deviation, unit) if len(statistic.values) > 1 else "–",
        number_text(float(statistic.values.min()), unit),
        number_text(float(statistic.values.max()), unit),
        band_text(statistic.lower, statistic.upper, unit),
        *("–" if math.isnan(index) else f"{index:.2f}" for index in (cp, cpk)),
        change,
    )


def read_batch(folder: str | Path) -> Batch:
    """Read all acceptance.json below a folder; of a folder without one, its characterisation.json.

    A file that cannot be read is told in the notes, so that it does not hide the others. All tests of a damper count.

    Raises
    ------
    InputError
        When the folder does not exist, or holds no such file that can be read.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{folder}: is not a folder, expected one with acceptance.json or characterisation.json in it")
    entries, notes = [], []
    for file in find_tests(root):
        try:
            entries.append(read_entry(file))
        except InputError as error:
            notes.append(str(error))
    if not entries:
        found = f": {notes[0]}" if notes else "; write them by accept or characterise"
        raise InputError(f"{folder}: holds no acceptance.json or characterisation.json that can be read{found}")
    return make_batch(root, entries, notes)


def find_tests(folder: Path) -> list[Path]:
    """Return all acceptance.json below a folder; of a folder without one, its characterisation.json."""
    names = ("acceptance.json", "characterisation.json")
    found = ((parent, next((name for name in names if name in files), "")) for parent, _, files in os.walk(folder))
    return sorted(Path(parent, name) for parent, name in found if name)


def make_batch(folder: Path, entries: Iterable[Entry], notes: Sequence[str] = ()) -> Batch:
    """Return the batch of tests, whose files are below ``folder``; ``notes`` come before those that are found here."""
    entries = sorted(
        entries, key=lambda entry: (entry.date.timestamp() if entry.date else math.inf, entry.serial, str(entry.file))
    )
    statistics, differing = _statistics(entries)
    undated = sum(entry.date is None for entry in entries)
    dates = [f"{undated} of {len(entries)} tests have no date, and do not count for changes over time"] if undated else []
    return Batch(folder, tuple(entries), tuple(statistics), (*notes, *dates, *_repeated(entries), *differing))


def read_entry(file: Path) -> Entry:
    """Return the test that an acceptance.json or characterisation.json describes.

    Raises
    ------
    InputError
        When the file cannot be read, or is not as it was written.
    """
    try:
        content = json.loads(read_text_file(file, f"an {file.name}"))
        # The schema says more, but checking it takes longer than all the rest where there are a thousand files.
        expected = acceptance_file.SCHEMA if file.name == "acceptance.json" else characterisation_file.SCHEMA
        if content["schema"] != expected:
            raise InputError(f"{file}: its schema is {str(content['schema'])[:40]}, expected {expected}")
        date = content.get("date")
        return Entry(
            file,
            str(content["serial" if "serial" in content else "name"]),
            datetime.fromisoformat(date).astimezone() if date else None,
            content.get("verdict", ""),
            tuple(_checked(content["checks"]) if "checks" in content else _characterised(content["values"])),
            tuple(str(run["source"]) for run in content["runs"]),
        )
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"{file}: is damaged ({problem}), expected a file as it was written") from None


def _checked(checks: Sequence[Mapping[str, Any]]) -> Iterator[Number]:
    for check in checks:
        if check["value"] is not None:
            lower, upper = check["lower"], check["upper"]
            yield Number(
                _key(check),
                _finite(check["value"]),
                -math.inf if lower is None else float(lower),
                math.inf if upper is None else float(upper),
                check["outcome"],
            )


def _characterised(values: Sequence[Mapping[str, Any]]) -> Iterator[Number]:
    for value in values:
        key = _key(value)
        if value["value"] is not None and key.quantity in QUANTITIES:
            # As in an acceptance, a force counts as it resists the motion.
            sign = -1.0 if key.direction == "compression" and QUANTITIES[key.quantity].force else 1.0
            yield Number(key, sign * _finite(value["value"]))


def _finite(value: Any) -> float:
    if not math.isfinite(value):
        raise ValueError(f"value {value}")
    return float(value)


def _key(content: Mapping[str, Any]) -> Key:
    names = ("current", "current_before", "speed", "stroke")
    if content["quantity"] not in QUANTITIES:
        raise ValueError(f"quantity {str(content['quantity'])[:40]}")
    return Key(content["quantity"], content["direction"], *(content[name] for name in names))


def _statistics(entries: Sequence[Entry]) -> tuple[list[Statistic], list[str]]:
    """Return the statistics of all numbers, and a sentence where limits differ between the tests."""
    alike = _Alike([number.key for entry in entries for number in entry.numbers])
    members: dict[Key, list[tuple[Entry, Number]]] = {}
    for entry in entries:
        for number in entry.numbers:
            members.setdefault(alike.first(number.key), []).append((entry, number))
    dates = [entry.date for entry in entries if entry.date]
    start = min(dates, default=None)
    statistics, differing = [], 0
    for key, found in members.items():
        limits = {(number.lower, number.upper) for _, number in found if number.outcome}
        lower, upper = limits.pop() if len(limits) == 1 else (-math.inf, math.inf)
        differing += bool(limits)
        times = np.array([_days(entry.date, start) for entry, _ in found])
        values = np.array([number.value for _, number in found])
        statistics.append(Statistic(key, values, times, tuple(entry for entry, _ in found), lower, upper))
    order = list(QUANTITIES)
    statistics.sort(
        key=lambda s: (
            order.index(s.key.quantity),
            *(part if part is not None else -math.inf for part in s.key[2:]),
            s.key.direction != "rebound",
        )
    )
    note = f"the limits of {differing} of {len(members)} numbers differ between the tests, so these have no Cp and Cpk"
    return statistics, [note] if differing else []


def _days(date: datetime | None, start: datetime | None) -> float:
    """Return the time since the start in days; nan without dates."""
    return (date - start).total_seconds() / 86400.0 if date and start else math.nan


class _Alike:
    """Finds numbers whose conditions are the same within the tolerances of a characterisation."""

    def __init__(self, keys: Sequence[Key]) -> None:
        self._current = SAME_CURRENT * max((abs(key.current or 0.0) for key in keys), default=0.0)
        self._known: dict[tuple[str, str | None], list[Key]] = {}
        self._found: dict[Key, Key] = {}

    def first(self, key: Key) -> Key:
        """Return the first key that was like this one."""
        if key not in self._found:
            known = self._known.setdefault(key[:2], [])
            like = next((other for other in known if self._same(key, other)), None)
            if like is None:
                known.append(key)
            self._found[key] = like or key
        return self._found[key]

    def _same(self, one: Key, other: Key) -> bool:
        tolerances = (self._current, self._current, SAME_SPEED * (other.speed or 0.0), SAME_SPEED * (other.stroke or 0.0))
        return all(
            (a is None and b is None) or (a is not None and b is not None and abs(a - b) <= tolerance)
            for a, b, tolerance in zip(one[2:], other[2:], tolerances, strict=True)
        )


def _repeated(entries: Sequence[Entry]) -> list[str]:
    """Return sentences on dampers that were tested more than once on a day."""
    days: dict[tuple[str, str], list[Entry]] = {}
    for entry in entries:
        if entry.date:
            days.setdefault((entry.serial, f"{entry.date:%Y-%m-%d}"), []).append(entry)
    return [
        f"{serial} was tested {len(tests)} times on {day}, and all count: {', '.join(str(t.file.parent) for t in tests)}"
        for (serial, day), tests in days.items()
        if len(tests) > 1
    ]
