"""Recordings in tables: their columns on one clock, pass by pass."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.formats import Recording
from mrd_runs.importing.clocks import MOST_REPEATS, Indices, Passes, are_copies, find_passes, usual_step, without_rounding
from mrd_runs.importing.finish import Mapped, finish, times_note
from mrd_runs.importing.quantities import Source, UndecidedError, find_sources, is_counter, is_speed, shown_options, unit_of
from mrd_runs.importing.synchronise import MOTION, Series, synchronise
from mrd_runs.importing.table import Table
from mrd_runs.importing.units import si_unit, to_si
from mrd_runs.importing.wrapping import unwrap
from mrd_runs.run import FEWEST_SAMPLES
from mrd_runs.text import one_line
from mrd_runs.validation import check_values

Array = NDArray[np.float64]

_TRIAL_ROWS = 20_000
_TRIAL_UNITS: Sequence[Mapping[str, str]] = ({}, {"position": "mm"}, {"time": "ms"}, {"time": "ms", "position": "mm"})
"""Units that are tried for columns that have none."""
_TRIAL_RATE = 100.0  # Hz
_LEAST_SHARED = 0.5  # of the longest series
_RATES_AGREE = 0.02


def table_recordings(path: Path, table: Table, mapped: Mapped) -> list[Recording]:
    """Make recordings of a table, one of each pass of its clock.

    Raises
    ------
    InputError
        When the table is not understood. Where it does not tell its quantities, the line has options that were tried.
    """
    try:
        return _recordings(path, table, mapped)
    except UndecidedError as error:
        raise _question(path, table, mapped, error) from None


def _recordings(path: Path, table: Table, mapped: Mapped) -> list[Recording]:
    sources, rate = _sources(path, table, mapped)
    named = {column.name: column for column in table.columns}
    for quantity, source in sources.items():
        if named[source.name].problem and quantity not in mapped.units:
            raise InputError(
                f"{path}: {one_line(source.name)} {named[source.name].problem}; say what one of its numbers means with "
                f'--units {quantity}="NUMBER UNIT"'
            )
    wanted = {quantity: source for quantity, source in sources.items() if quantity != "time"}
    times = list(dict.fromkeys(source.time for source in wanted.values() if source.time))
    counter = next((name for name in named if is_counter(named[name])), "") if rate else ""
    raw = table.read(list(dict.fromkeys([*(source.name for source in wanted.values()), *times, *filter(None, [counter])])))
    raw, told = _equally_long(path, table, wanted, raw)
    clocks: dict[str, Array] = {}
    for name in times:
        unit = mapped.units.get("time") or unit_of("time", named[name])
        time, clause = unwrap(raw[name], of_day=named[name].of_day)
        clocks[name] = to_si("time", time, unit or si_unit("time"), str(path))
        told += [clause] if clause else []
    if rate:
        count = len(raw[next(iter(wanted.values())).name])
        time, clause = _counted(raw[counter], counter) if counter else (np.arange(float(count)), "")
        clocks[""] = time / rate
        told += [clause] if clause else []
    orders: dict[str, Passes] = {}
    for name, time in clocks.items():
        order = find_passes(time, blocks=sorted({k for k in table.blocks if k < len(time)}))
        rows = [raw[source.name] for source in wanted.values() if source.time == name]
        if name and order.repeats > MOST_REPEATS and not are_copies(time, rows):
            return _without_times(path, table, mapped, name, time)
        clocks[name], clause = without_rounding(time, order)
        told += [f"{one_line(name)} is {clause}"] if clause else []
        orders[name] = order.unrepeated(clocks[name])
    told += [clause for order in orders.values() for clause in order.told]
    notes = _layout_notes(table, sources, raw)
    if rate and mapped.rate is None:
        notes.append(f"the sample rate of {rate:g} Hz is the one that the file states")
    told += [] if rate else _compare_rates(table, clocks)
    asked = {*mapped.columns, *mapped.units, *mapped.flip}
    return [
        finish(
            path,
            columns,
            {q: sources[q] for q in sources if q in columns},
            mapped,
            [*notes, *times_note([*told, *more], of)],
            of,
            place,
        )
        for columns, of, more, place in _each_pass(path, table, wanted, raw, clocks, orders, asked)
    ]


def _sources(path: Path, table: Table, mapped: Mapped) -> tuple[dict[str, Source], float | None]:
    """Return where each quantity is from, and the rate of the samples where it is used in place of times."""

    def find(rate: float | None) -> tuple[dict[str, Source], float | None]:
        given = mapped.columns
        current = mapped.current is not None
        return find_sources(table.columns, given, str(path), current_is_given=current, rate_is_given=rate is not None), rate

    try:
        return find(mapped.rate)
    except UndecidedError as error:
        if "time" not in error.missing or table.rate is None or error.times:
            raise
        return find(table.rate)


def _equally_long(
    path: Path, table: Table, wanted: Mapping[str, Source], raw: Mapping[str, Array]
) -> tuple[dict[str, Array], list[str]]:
    """Cut columns that belong to one time to the shortest of them, where the file is such that some end early."""
    told, cut = [], dict(raw)
    for time in dict.fromkeys(source.time for source in wanted.values()):
        names = list(dict.fromkeys([*filter(None, [time]), *(one.name for one in wanted.values() if one.time == time)]))
        counts = {name: len(raw[name]) for name in names}
        if len(set(counts.values())) == 1:
            continue
        shown = ", ".join(f"{count} of {one_line(name)}" for name, count in counts.items())
        if not table.ragged:
            raise InputError(f"{path}: holds {shown}; expected equally many, of one table")
        shortest = min(counts.values())
        told.append(f"cut to {shortest} samples ({shown})")
        cut |= {name: raw[name][:shortest] for name in names}
    return cut, told


def _counted(counter: Array, name: str) -> tuple[Array, str]:
    """Return the numbers of the samples by a counter, which tells where samples are missing or come twice."""
    numbers, clause = unwrap(counter, of_day=False)
    steps = np.diff(numbers)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual <= 0 or np.all(steps == usual):
        return np.arange(float(len(counter))), ""
    told = [clause] if clause else []
    missing = float(np.sum(steps[steps > usual] / usual - 1))
    told += [f"{missing:.0f} samples are missing by {one_line(name)}"] if missing else []
    return numbers / usual, "; ".join(told)


def _without_times(path: Path, table: Table, mapped: Mapped, name: str, time: Array) -> list[Recording]:
    """Make recordings of a table whose times repeat so often that they do not tell the time of each sample."""
    changes = np.flatnonzero(np.diff(time) != 0) + 1
    seen = f"{one_line(name)} has only {len(changes) + 1} times in {len(time)} rows"
    if table.rate is not None:
        remark = f"times: {seen}; the sample rate of {table.rate:g} Hz that the file states tells them instead"
        return _recordings(path, replace(table, remarks=[*table.remarks, remark]), replace(mapped, rate=table.rate))
    if len(changes) < 2 or time[changes[-1]] <= time[changes[0]]:
        raise InputError(f"{path}: {seen}; expected one of each sample, or the sample rate with --rate HZ")
    rate = 1 / np.polyfit(changes, time[changes], 1)[0]
    raise InputError(
        f"{path}: {seen}, expected one of each sample; where they are evenly spaced, give their rate: --rate {rate:.4g}"
    )


def _layout_notes(table: Table, sources: Mapping[str, Source], read: Mapping[str, Array]) -> list[str]:
    notes = [*([table.layout] if table.layout else []), *dict.fromkeys(table.remarks)]
    unused = [column for column in table.columns if column.name and column.name not in read]
    if unused:
        shown = [f"{one_line(column.name)}{' (text)' if column.text else ''}" for column in unused[:20]]
        notes.append(f"not used: {', '.join(shown)}" + (", ..." if len(unused) > 20 else ""))
    return notes


def _compare_rates(table: Table, clocks: Mapping[str, Array]) -> list[str]:
    """Return a clause where the times advance at another rate than the file states."""
    stated = table.rate
    rates = {name: 1 / step for name, time in clocks.items() if 0 < (step := usual_step(time)) < np.inf}
    if stated is None or not rates or any(abs(rate / stated - 1) <= _RATES_AGREE for rate in rates.values()):
        return []
    name, rate = next(iter(rates.items()))
    return [f"{one_line(name)} advances at {rate:.4g} Hz, although the file states {stated:g} Hz"]


def _each_pass(
    path: Path,
    table: Table,
    wanted: Mapping[str, Source],
    raw: Mapping[str, Array],
    clocks: Mapping[str, Array],
    orders: Mapping[str, Passes],
    asked: Collection[str],
) -> Iterator[tuple[dict[str, Array], dict[str, str], list[str], Callable[[int], str]]]:
    """Yield columns on one time, the clock of each quantity, clauses, and the places of the samples, pass by pass."""
    first = next(iter(clocks))
    other = next((name for name in clocks if len(orders[name].pieces) != len(orders[first].pieces)), None)
    if other is not None:
        name, jump = next((name, order.jumps[0]) for name, order in orders.items() if order.jumps)
        raise InputError(
            f"{path}: {one_line(name)} jumps by {-jump:.4g} s, and {one_line(other if name == first else first)} does "
            "not; expected one clock for all: split the file there"
        )
    passes = [f"the times jump {'back' if jump > 0 else 'on'} by {abs(jump):.4g} s" for jump in orders[first].jumps]
    told = [f"{'; '.join(passes[:5])}: {len(passes) + 1} passes"] if passes else []
    # Times that are the same in one file are those of one clock.
    same = {name: next(o for o in clocks if o == name or (table.one_clock and _equal(clocks, o, name))) for name in clocks}
    of = {quantity: one_line(same[source.time]) for quantity, source in wanted.items()}
    alike = all(_equal(clocks, first, name) for name in clocks)
    for number in range(len(orders[first].pieces)):
        pieces = {name: order.pieces[number] for name, order in orders.items()}
        parts = {
            quantity: (clocks[source.time][pieces[source.time]], raw[source.name][pieces[source.time]])
            for quantity, source in wanted.items()
        }
        if alike:
            piece = pieces[first]
            columns = {"time": clocks[first][piece]} | {quantity: values for quantity, (_, values) in parts.items()}
            yield columns, of, told, partial(_place_in, table, piece)
        else:
            _check_durations(path, wanted, parts)
            starts = {name: clocks[name][pieces[name][0]] for name in clocks}
            apart = max(starts.values()) - min(starts.values())
            columns, done = synchronise(parts, None, str(path), asked)
            begin = f" that start {apart:.6g} s apart" if apart else " with times of their own"
            kept = {quantity: clock for quantity, clock in of.items() if quantity in columns}
            yield columns, kept, [*told, f"columns{begin} were put onto one time", *done], "sample {}".format


def _check_durations(path: Path, wanted: Mapping[str, Source], parts: Mapping[str, Series]) -> None:
    """Refuse series of which one lasts so much longer than another that their times cannot both be right."""
    lasting = {quantity: float(parts[quantity][0][-1] - parts[quantity][0][0]) for quantity in MOTION if quantity in parts}
    shortest, longest = min(lasting, key=lasting.__getitem__), max(lasting, key=lasting.__getitem__)
    if lasting[shortest] < _LEAST_SHARED * lasting[longest]:
        shown = " and ".join(
            f"{one_line(wanted[quantity].name)} {lasting[quantity]:.4g} s ({len(parts[quantity][0])} samples at "
            f"{1 / usual_step(parts[quantity][0]):.4g} Hz)"
            for quantity in (longest, shortest)
        )
        raise InputError(f"{path}: by their times, {shown} do not last equally long; expected one recording of all")


def _place_in(table: Table, piece: Indices, index: int) -> str:
    return table.place(int(piece[index]))


def _equal(clocks: Mapping[str, Array], name: str, other: str) -> bool:
    return name == other or np.array_equal(clocks[name], clocks[other])


def _question(path: Path, table: Table, mapped: Mapped, error: UndecidedError) -> InputError:
    """Return the error that asks for a mapping, with options that were tried."""
    head = _first_rows(table)
    if "time" in error.missing and (why := _no_time_series(head)):
        return InputError(f"{path}: {why}, no time series; expected the samples of a recording in time ({error.columns})")
    for mapping, units in product(error.mappings, _TRIAL_UNITS):
        without_time = "time" in error.missing and "time" not in mapping
        without_current = "current" in error.missing and "current" not in mapping
        trial = replace(
            mapped,
            columns=mapping,
            units={**units, **mapped.units},
            rate=_TRIAL_RATE if without_time else mapped.rate,
            current=0.0 if without_current else mapped.current,
        )
        if set(units) - set(mapping) or not _is_usable(path, head, trial):
            continue
        options = shown_options("--map", mapping) + shown_options("--units", units)
        options += ["--current 0"] * without_current + ["--rate HZ"] * without_time
        # The mapping comes first: a line is cut where it is long.
        return InputError(
            f"{path}: the columns do not tell the {' and the '.join(error.missing)}; say so with what is right of: "
            f"{' '.join(options)} ({error.columns})"
        )
    return error if not error.mappings else InputError(f"{error}; no choice of them makes a recording")


def _first_rows(table: Table) -> Table:
    """Return the beginning of a table, of which each column is read once."""
    known: dict[str, Array] = {}

    def read(names: Sequence[str]) -> dict[str, Array]:
        for name in names:
            known[name] = known[name] if name in known else table.read([name])[name][:_TRIAL_ROWS]
        return {name: known[name] for name in names}

    return replace(table, read=read, remarks=[])


def _is_usable(path: Path, table: Table, mapped: Mapped) -> bool:
    try:
        recordings = _recordings(path, table, mapped)
        for recording in recordings:
            check_values(recording.columns, str(path), recording.place)
            if not all(np.ptp(recording.columns[name]) for name in ("position_m", "force_N")):
                return False
    except InputError:
        return False
    return len(recordings) == 1


def _no_time_series(table: Table) -> str:
    """Return what a table without times is rather than a recording; "" where it may be one."""
    numbers = [column for column in table.columns if column.name and not column.text]
    speeds = [column.name for column in numbers if is_speed(column)]
    try:
        rows = len(table.read([numbers[0].name])[numbers[0].name])
        if rows < FEWEST_SAMPLES:
            return f"is a table of {rows} rows without times"
        if speeds and all(values.min() >= 0 or np.all(np.diff(values) >= 0) for values in table.read(speeds).values()):
            return f"is a table over {one_line(speeds[0])}, which never turns, without times"
    except InputError:
        return ""
    return ""
