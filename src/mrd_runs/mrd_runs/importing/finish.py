"""What a user says about a file, and the last steps from its series to a recording in SI units."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.formats import Recording
from mrd_runs.importing.integration import integrate_velocity
from mrd_runs.importing.quantities import Source
from mrd_runs.importing.units import COLUMNS, si_unit, to_si
from mrd_runs.importing.words import names_compression
from mrd_runs.missing import check_missing, missing_number
from mrd_runs.scales import LARGEST, SMALLEST
from mrd_runs.text import one_line
from mrd_runs.validation import LARGEST_RATIO, MEDIAN_INTERVALS, magnitude_problem, velocity_ratio

Array = NDArray[np.float64]

LARGEST_RATE = 1e7  # Hz

DOUBTED = 0.2
"""Share of the largest stroke and current of any damper, above which a number without a unit is rather in mm or mA."""


@dataclass(frozen=True)
class Mapped:
    """What a user says about a file.

    Attributes
    ----------
    columns, topics : mapping of str to str
        Column of the file, or number of a topic, of a quantity.
    units : mapping of str to str
        Unit of a quantity, in place of the one that the file names.
    flip : tuple of str
        Quantities whose sign is turned.
    current : float, optional
        Constant current in A.
    rate : float, optional
        Sample rate in Hz of a file without time; or to which the series of a bag are resampled.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    flip: tuple[str, ...] = ()
    current: float | None = None
    rate: float | None = None

    def check(self, prefix: str) -> None:
        """Raise `InputError` for what means nothing; ``prefix`` stands before the names of the fields in the message."""
        if self.rate is not None and not 0 < self.rate < LARGEST_RATE:
            raise InputError(f"{prefix}rate is {self.rate:g}, expected a sample rate in Hz")
        if self.current is not None and not np.isfinite(self.current):
            raise InputError(f"{prefix}current is {self.current:g}, expected a finite number of A")
        if len(set(self.flip)) < len(self.flip):
            raise InputError(f"{prefix}flip is {' '.join(self.flip)}, expected each quantity once")


def times_note(clauses: Sequence[str], clocks: Mapping[str, str]) -> list[str]:
    """Return what was done with the times, and whether their clocks are known to agree, as a list of one note at most."""
    of: dict[str, list[str]] = {}
    for quantity, clock in clocks.items():
        of.setdefault(clock, []).append(quantity)
    unsure = "; ".join(f"{' and '.join(quantities)} by the {clock}" for clock, quantities in of.items())
    all_clauses = [*clauses, *([f"not known to be of one clock: {unsure}"] if len(of) > 1 else [])]
    return [f"times: {'; '.join(all_clauses)}"] if all_clauses else []


def finish(
    path: Path,
    series: Mapping[str, Array],
    sources: Mapping[str, Source],
    mapped: Mapped,
    notes: list[str],
    clocks: Mapping[str, str],
    place: Callable[[int], str] = "sample {}".format,
) -> Recording:
    """Convert series to SI units, and add what the file lacks.

    Parameters
    ----------
    path : Path
    series : mapping of str to ndarray (n,)
        By quantity, on one time; ``time`` itself is in s.
    sources : mapping of str to Source
        Where each quantity is from.
    mapped : Mapped
    notes : list of str
        What has been done before.
    clocks : mapping of str to str
        What the times of each quantity were of, before they were put onto one.
    place : callable
        Returns how an error message names the sample of an index.

    Raises
    ------
    InputError
        For a quantity that cannot be converted, a velocity that cannot be integrated, or numbers without a unit that are
        hardly in SI units.
    """
    absent = [quantity for quantity in (*mapped.units, *mapped.flip) if quantity not in series]
    if absent:
        raise InputError(f"{path}: --units or --flip names the {absent[0]}, which is not read; expected {', '.join(series)}")
    columns, told, notes = {}, [], list(notes)
    unneeded = {"acceleration", "temperature", *(["velocity"] if "position" in series else [])}
    unneeded -= {*mapped.columns, *mapped.topics, *mapped.units}
    for quantity, values in series.items():
        source = sources.get(quantity)
        unit = mapped.units.get(quantity) or (source.unit if source else "")
        is_time = quantity == "time"
        if quantity in unneeded:
            values = np.where(values == missing_number(values), np.nan, values)
        elif source and not is_time:
            check_missing(values, one_line(source.name), str(path), place)
        columns[quantity] = values if is_time else to_si(quantity, values, unit or si_unit(quantity), str(path))
        if source:
            told.append(f"{quantity} is {one_line(source.name)} in {unit or f'{si_unit(quantity)} (no unit given)'}")
        elif quantity in mapped.units:
            told.append(f"{quantity} is in {unit}")
    if told:
        notes.append("; ".join(told))
    for quantity, source in sources.items():
        if names_compression(source.name) and quantity not in mapped.flip:
            notes.append(
                f"{one_line(source.name)} is taken as it is: if its numbers grow in compression, turn them with "
                f"--flip {quantity}"
            )
    for quantity in unneeded & set(columns):
        if absent_values := int(np.count_nonzero(~np.isfinite(columns[quantity]))):
            del columns[quantity]
            notes.append(f"the {quantity} is left out: {absent_values} of {len(series[quantity])} values are not numbers")
        elif problem := _unneeded_problem(quantity, columns):
            del columns[quantity]
            notes.append(f"the {quantity} is left out: {problem}")
    for quantity in mapped.flip:
        columns[quantity] = -columns[quantity]
        notes.append(f"the sign of the {quantity} was turned")
    if mapped.current is not None:
        columns["current"] = np.full(len(columns["time"]), mapped.current)
        notes.append(f"current of {mapped.current:g} A as given")
    if "position" not in columns:
        time = columns["time"]
        if len(time) < 2 or not (np.isfinite(columns["velocity"]).all() and np.all(np.diff(time) > 0)):
            raise InputError(
                f"{path}: holds no position, and its velocity or time cannot be integrated; expected rising times"
            )
        columns["position"], note = integrate_velocity(time, columns["velocity"])
        # The mean error of the velocity is out of the position; the velocity is computed from it again.
        del columns["velocity"]
        notes.append(note)
        clocks = {("position" if quantity == "velocity" else quantity): clock for quantity, clock in clocks.items()}
    unsure = {quantity for quantity, source in sources.items() if not (mapped.units.get(quantity) or source.unit)}
    _check_without_units(path, columns, unsure)
    info = {"format": path.suffix.lstrip(".") or "text", "notes": notes, "lost": 0, "recovered": False}
    if len(set(clocks.values())) > 1:
        info["clocks"] = dict(clocks)
    return Recording({COLUMNS[quantity]: columns[quantity] for quantity in COLUMNS if quantity in columns}, info, place)


@np.errstate(all="ignore")  # a stranger's numbers may be anything
def _check_without_units(path: Path, columns: Mapping[str, Array], unsure: Collection[str]) -> None:
    """Refuse quantities without a unit that may be those of a damper in SI units, but are rather in others.

    `mrd_runs.validation` refuses those that cannot be, and names the unit that they may be in.
    """
    time, position = columns["time"], columns["position"]
    motion = [quantity for quantity in ("time", "position", "velocity") if quantity in unsure]
    stroke = float(np.ptp(position)) if len(position) else 0.0
    problem, asked = "", motion
    if set(motion) - {"time"} and DOUBTED * 2 * LARGEST.stroke < stroke <= 2 * LARGEST.stroke:
        problem = f"the stroke would be {stroke:.3g} m, expected at most {DOUBTED * 2 * LARGEST.stroke:g} m"
    elif (
        motion
        and 2 * SMALLEST.stroke < stroke <= 2 * LARGEST.stroke
        and np.all(np.diff(time) > 0)
        and MEDIAN_INTERVALS[0] <= np.median(np.diff(time)) <= MEDIAN_INTERVALS[1]
    ):
        speed = float(np.quantile(np.abs(np.gradient(position, time)), 0.995))
        if not SMALLEST.speed <= speed <= LARGEST.speed:
            problem = f"the rod would move at up to {speed:.3g} m/s, expected {SMALLEST.speed:g} to {LARGEST.speed:g} m/s"
    current = columns.get("current", np.zeros(0))
    if not problem and "current" in unsure:
        largest = float(np.abs(current).max(initial=0.0))
        if DOUBTED * LARGEST.current < largest <= LARGEST.current:
            problem, asked = f"the current would be up to {largest:.3g} A", ["current"]
    if problem:
        given = " ".join(f"{quantity}=UNIT" for quantity in asked)
        raise InputError(
            f"{path}: no unit is given for the {' and the '.join(asked)}: {problem}; say so with --units {given}"
        )


@np.errstate(all="ignore")  # a stranger's numbers may be anything
def _unneeded_problem(quantity: str, columns: Mapping[str, Array]) -> str:
    """Return why a channel that a recording does not need would stop its import; "" where it would not."""
    values = columns[quantity]
    if quantity == "velocity":
        time, position = columns["time"], columns["position"]
        rises = len(time) > 1 and bool(np.all(np.diff(time) > 0))
        if rises and np.ptp(position) > 0 and (ratio := velocity_ratio(time, position, values)) > LARGEST_RATIO:
            return f"it is {ratio:.3g} times the derivative of the position, expected about 1"
    return magnitude_problem(COLUMNS[quantity], values)
