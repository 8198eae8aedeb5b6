"""Recordings in bags: those of other benches, and those of this one whose signs or units are to be changed."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice, product
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_runs.bag import read_bag
from mrd_runs.definitions import SAMPLES_TYPE
from mrd_runs.formats import BAG, Recording
from mrd_runs.importing.finish import Mapped, finish, times_note
from mrd_runs.importing.quantities import listed, shown_options, topic_mappings
from mrd_runs.importing.synchronise import synchronise
from mrd_runs.importing.topics import list_numbers, parse_address, read_topics
from mrd_runs.importing.units import COLUMNS, si_unit, to_si
from mrd_runs.validation import check_values

_MOST_TRIALS, _MOST_TIMES = 24, 3


def bag_recordings(path: Path, mapped: Mapped) -> list[Recording]:
    """Make recordings of a bag, one of each pass of its clock.

    Raises
    ------
    InputError
        When the bag cannot be read, or its clocks cannot be put onto one. Where nothing says which numbers to take, the line
        has options that were tried.
    """
    if mapped.columns:
        raise InputError(f"{path}: --map is for tables; name the numbers of this bag with --topics")
    if mapped.topics:
        return _recordings(path, mapped)
    if any(topic.message_type == SAMPLES_TYPE for topic in read_bag(path, set()).topics.values()):
        return [_read_own_bag(path, mapped)]
    raise _question(path, mapped)


def _recordings(path: Path, mapped: Mapped) -> list[Recording]:
    addresses = {quantity: parse_address(text, f"--topics {quantity}") for quantity, text in mapped.topics.items()}
    needed = {"force": "force" in addresses, "position": "position" in addresses or "velocity" in addresses}
    needed["current"] = "current" in addresses or mapped.current is not None
    if not all(needed.values()):
        missing = " and ".join(quantity for quantity, given in needed.items() if not given)
        raise InputError(
            f"{path}: --topics names no {missing}; expected position (or velocity), force and current (or --current)"
        )
    if "time" in mapped.units and "time" not in addresses:
        raise InputError(f"{path}: --units names the time; the times are those of the messages, leave it out")
    passes, told, sources = read_topics(path, addresses, mapped.units.get("time", ""))
    recordings = []
    for one in passes:
        columns, done = synchronise(one.series, mapped.rate, str(path), mapped.topics)
        notes = times_note([*told, *done], one.clocks)
        recordings.append(finish(path, columns, sources, mapped, notes, one.clocks))
    return recordings


def _question(path: Path, mapped: Mapped) -> InputError:
    """Return the error that asks which numbers of a bag to take, with options that were tried."""
    numbers, problem = list_numbers(path)
    if not numbers:
        return InputError(f"{path}: {problem or 'is a bag without numbers; expected the messages of a bench'}")
    problem = f"; {problem}" if problem else ""
    known = f"numbers in it: {listed(numbers)}{problem}"
    rising = [address for address, number in numbers.items() if number.rises]
    ranges = {address: number.range for address, number in numbers.items()}
    mappings = topic_mappings(ranges, current_is_given=mapped.current is not None)
    for mapping, time in islice(product(mappings, ["", *rising[:_MOST_TIMES]]), _MOST_TRIALS):
        if time in mapping.values():
            continue
        without_current = mapped.current is None and "current" not in mapping
        topics = {"time": time} | mapping if time else mapping
        if _is_usable(path, replace(mapped, topics=topics, current=0.0 if without_current else mapped.current)):
            options = shown_options("--topics", topics) + ["--current 0"] * without_current
            # The mapping comes first: a line is cut where it is long.
            return InputError(
                f"{path}: is a bag of another bench; say which numbers to take with what is right of: "
                f"{' '.join(options)} ({known})"
            )
    return InputError(f"{path}: is a bag of another bench; say which numbers to take with --topics ({known})")


def _is_usable(path: Path, mapped: Mapped) -> bool:
    try:
        for recording in _recordings(path, mapped):
            check_values(recording.columns, str(path), recording.place)
            if not all(np.ptp(recording.columns[name]) for name in ("position_m", "force_N")):
                return False
    except InputError:
        return False
    return True


def _read_own_bag(path: Path, mapped: Mapped) -> Recording:
    """Read a bag of this bench, or one that was imported before, to change its signs, units or current."""
    if not (mapped.flip or mapped.units or mapped.current is not None):
        raise InputError(
            f"{path}: is a bag of this bench already; every tool reads it as it is. Expected --flip, --units or --current, "
            "which change it"
        )
    if mapped.rate is not None:
        raise InputError(f"{path}: is a bag of this bench already and has its times; leave --rate out")
    recording = BAG.read(path)
    series = {quantity: recording.columns[name] for quantity, name in COLUMNS.items() if name in recording.columns}
    series["time"] = to_si("time", series["time"], mapped.units.get("time", si_unit("time")), str(path))
    clocks: Mapping[str, str] = recording.info.get("clocks", {})
    made = finish(path, series, {}, mapped, list(recording.info["notes"]), clocks)
    return replace(made, info={**recording.info, **made.info})
