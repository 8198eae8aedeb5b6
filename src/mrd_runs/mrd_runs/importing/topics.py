"""Series in bags of other benches: numbers in messages of any type, named as ``/topic.field[index]``."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_runs.bag import Bag, read_bag
from mrd_runs.importing.clocks import MOST_REPEATS, are_copies, find_passes, without_rounding
from mrd_runs.importing.quantities import Source, unit_of
from mrd_runs.importing.stamps import Topic, align_topics
from mrd_runs.importing.synchronise import MOTION, Series
from mrd_runs.importing.table import Column
from mrd_runs.importing.units import find_unit, si_unit, to_si
from mrd_runs.importing.wrapping import unwrap
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_ADDRESS = re.compile(r"(?P<topic>[^.\[\]\s]+)\.(?P<field>[\w.]+)(\[(?P<index>[^\[\]]+)\])?")
_MOST_ELEMENTS = 64  # of an array that is listed
_LISTED_MESSAGES = 50
_FEWEST_ALTERNATING = 50
_ALTERNATING = 2.0
"""Change from a value to the next, relative to that to the one after, from which two series alternate: noise has 1."""
_NO_SERIES = ("rosout", "parameter_events", "clock")


@dataclass(frozen=True)
class Address:
    """A number in the messages of a topic.

    Attributes
    ----------
    topic : str
    field : str
        Dotted path, such as ``wrench.force.z``.
    index : str
        Number of an element, or its name where the message has a field ``name``; "" for no array.
    """

    topic: str
    field: str
    index: str = ""

    def __str__(self) -> str:
        return f"{self.topic}.{self.field}" + (f"[{self.index}]" if self.index else "")


class Number(NamedTuple):
    """How far a number of a bag moves, and whether it only rises, as a time does."""

    range: float
    rises: bool


@dataclass(frozen=True)
class Pass:
    """Numbers of a bag on one clock: times in s and values, and what the times are of, by quantity."""

    series: Mapping[str, Series]
    clocks: Mapping[str, str]


def parse_address(text: str, option: str) -> Address:
    """Parse ``/topic.field`` or ``/topic.field[index]``; raise InputError for another text."""
    match = _ADDRESS.fullmatch(text)
    if match is None:
        raise InputError(
            f"{option}: {text} is not a number of a topic; expected /TOPIC.FIELD or /TOPIC.FIELD[INDEX OR NAME]"
        )
    return Address(match["topic"], match["field"], match["index"] or "")


def read_topics(
    path: Path, addresses: Mapping[str, Address], time_unit: str = ""
) -> tuple[list[Pass], list[str], dict[str, Source]]:
    """Read numbers from the messages of a bag, on one clock.

    Parameters
    ----------
    path : Path
        Bag folder, ``.mcap`` or ``.db3`` file.
    addresses : mapping of str to Address
        By quantity; ``time`` where the messages of a single topic hold a time of their own.
    time_unit : str
        Unit of that time, in place of the one that the bag tells.

    Returns
    -------
    passes : list of Pass
        One of each time that the clock ran.
    told : list of str
        Clauses about messages and clocks.
    sources : dict of str to Source
        By quantity, with the unit where a field ``unit`` or a name tells it.

    Raises
    ------
    InputError
        When the bag cannot be read, a topic, a field or an element is not there, messages of several sensors stand on one
        topic, or the clocks cannot be put onto one.
    """
    names = {address.topic.rsplit("/", 1)[-1] for address in addresses.values()}
    bag = read_bag(path, names, as_written=True)
    values: dict[str, Array] = {}
    units: dict[str, str] = {}
    left_out: list[str] = []
    topics: dict[str, Topic] = {}
    for topic in dict.fromkeys(address.topic for address in addresses.values()):
        wanted = {quantity: address for quantity, address in addresses.items() if address.topic == topic}
        topics[topic], found, found_units, clauses = _read_topic(bag, topic, wanted, path)
        values |= found
        units |= found_units
        left_out += clauses
    sources = {quantity: _source(quantity, address, units[quantity]) for quantity, address in addresses.items()}
    if "time" in addresses:
        timed, told = _timed_by_a_number(path, addresses, values, time_unit or sources["time"].unit)
        return timed, [*left_out, *told], sources
    of = {quantity: address.topic for quantity, address in addresses.items()}
    passes, told = align_topics(topics, list(dict.fromkeys(of[name] for name in MOTION if name in of)), str(path))
    return (
        [
            Pass(
                {quantity: (one[topic].time, values[quantity][one[topic].index]) for quantity, topic in of.items()},
                {quantity: one[topic].clock for quantity, topic in of.items()},
            )
            for one in passes
        ],
        [*left_out, *told],
        sources,
    )


def _source(quantity: str, address: Address, unit: str) -> Source:
    """Return where a quantity comes from; its unit may stand beside it, or end the name of field, element or topic."""
    unit = unit or unit_of(quantity, Column(f"{address.topic}.{address.field}"))
    names = (address.index, address.topic.rpartition("/")[2])
    ends = (found for name in names if find_unit(quantity, found := unit_of(quantity, Column(name))))
    return Source(str(address), unit or next(ends, ""))


def _timed_by_a_number(
    path: Path, addresses: Mapping[str, Address], values: Mapping[str, Array], unit: str
) -> tuple[list[Pass], list[str]]:
    """Return passes of messages of one topic that hold their own time."""
    if len({address.topic for address in addresses.values()}) > 1:
        raise InputError(
            f"{path}: --topics names a time of {addresses['time'].topic}, expected one only where all numbers are of this "
            "topic; leave it out"
        )
    if not np.isfinite(values["time"]).all():
        raise InputError(f"{path}: --topics: {addresses['time']} is not finite everywhere, expected times")
    time, wrapped = unwrap(values["time"], of_day=False)
    time = to_si("time", time, unit or si_unit("time"), str(path))
    order = find_passes(time)
    if order.repeats > MOST_REPEATS and not are_copies(time, [values[name] for name in values if name != "time"]):
        raise InputError(
            f"{path}: --topics: {100 * order.repeats:.0f} % of the times {addresses['time']} repeat another one, expected "
            "one of each message; leave it out: the messages then count at the times of their headers or of their receipt"
        )
    time, rounded = without_rounding(time, order)
    order = order.unrepeated(time)
    told = [*filter(None, [wrapped, rounded and f"{addresses['time']} is {rounded}"]), *order.told]
    told += [f"{addresses['time']} jumps back by {jump:.4g} s" for jump in order.jumps]
    others = [quantity for quantity in values if quantity != "time"]
    clock = str(addresses["time"])
    return [
        Pass({q: (time[piece], values[q][piece]) for q in others}, dict.fromkeys(others, clock)) for piece in order.pieces
    ], told


def _read_topic(
    bag: Bag, topic: str, wanted: Mapping[str, Address], path: Path
) -> tuple[Topic, dict[str, Array], dict[str, str], list[str]]:
    """Return when the messages of a topic were received and stamped, values and units by quantity, and clauses."""
    if topic not in bag.topics:
        raise InputError(f"{path}: --topics: unknown topic {one_line(unknown_key(topic, sorted(bag.topics)))}")
    entry = bag.topics[topic]
    if not entry.messages:
        raise InputError(f"{path}: {topic} has no messages; expected a recording")
    if entry.message_type not in bag.types.fielddefs:
        raise InputError(f"{path}: {_undefined({topic: entry.message_type})}")
    getters: dict[str, Callable[[Any], float]] = {}
    values: dict[str, list[float]] = {quantity: [] for quantity in wanted}
    headers: list[int] = []
    receipts: list[int] = []
    frames: set[str] = set()
    units: dict[str, str] = {}
    named = {address.index for address in wanted.values() if address.index and not address.index.isdigit()}
    for number, (receipt, cdr) in enumerate(zip(entry.stamps, entry.messages, strict=True)):
        try:
            message = bag.types.deserialize_cdr(cdr, entry.message_type)
        except Exception as error:  # rosbags raises many kinds
            raise InputError(f"{path}: a message of {one_line(topic)} cannot be read ({one_line(error)})") from None
        # Controllers of several joints publish on one topic, each those that it knows.
        if named - set(getattr(message, "name", named)) and (receipts or number + 1 < len(entry.messages)):
            continue
        getters = getters or {quantity: _getter(message, address, path) for quantity, address in wanted.items()}
        units = units or {quantity: _unit_beside(message, address) for quantity, address in wanted.items()}
        header = getattr(message, "header", None)
        stamp = getattr(header, "stamp", None)
        headers.append(stamp.sec * 10**9 + stamp.nanosec if stamp is not None else 0)
        frames.add(getattr(header, "frame_id", ""))
        receipts.append(receipt)
        for quantity, get in getters.items():
            try:
                values[quantity].append(float(get(message)))
            except (IndexError, ValueError, TypeError):
                raise InputError(
                    f"{path}: message {number} of {topic} has no {wanted[quantity]}; expected it in each"
                ) from None
    series = {name: np.array(of) for name, of in values.items()}
    _check_publishers(series, wanted, frames, path)
    stamps = np.array(headers, np.int64) if any(headers) else None
    others = len(entry.messages) - len(receipts)
    told = [f"{topic}: {others} messages without {' and '.join(sorted(named))} left out"] if others else []
    return Topic(np.array(receipts, np.int64), stamps), series, units, told


def _unit_beside(message: Any, address: Address) -> str:
    """Return the unit that a field beside a number names; "" without one."""
    *parents, _ = address.field.split(".")
    parent = attrgetter(".".join(parents))(message) if parents else message
    units = (getattr(parent, name, "") for name in ("unit", "units"))
    return next((unit for unit in units if isinstance(unit, str) and unit), "")


def _check_publishers(
    series: Mapping[str, Array], wanted: Mapping[str, Address], frames: Collection[str], path: Path
) -> None:
    """Refuse messages of two sensors on one topic."""
    topic = next(iter(wanted.values())).topic
    if len(frames) > 1:
        shown = " and ".join(one_line(repr(frame)) for frame in sorted(frames)[:5])
        raise InputError(
            f"{path}: the messages of {topic} have the frames {shown}; expected those of one sensor: record each on a "
            "topic of its own"
        )
    for quantity, values in series.items():
        next_, after = (float(np.sum((values[lag:] - values[:-lag]) ** 2)) for lag in (1, 2))
        if len(values) > _FEWEST_ALTERNATING and next_ > _ALTERNATING**2 * after:
            raise InputError(
                f"{path}: {wanted[quantity]} alternates between two series, as where two nodes publish; expected one: "
                "record each on a topic of its own"
            )


def _undefined(types: Mapping[str, str]) -> str:
    """Return a clause about message types, by topic, that nobody can read."""
    shown = ", ".join(f"{one_line(name)} ({one_line(topic)})" for topic, name in types.items())
    return (
        f"no definition of this type in the bag: {shown}; record into MCAP, or convert the bag where the package of the "
        "type is installed, so that the file has the definition"
    )


def _getter(message: Any, address: Address, path: Path) -> Callable[[Any], float]:
    """Return the function that takes a number out of a message."""
    try:
        field = attrgetter(address.field)
        value = field(message)
    except AttributeError:
        known = [str(other) for other, _ in _numbers(message, address.topic)]
        raise InputError(f"{path}: --topics: unknown number {one_line(unknown_key(str(address), known))}") from None
    names = list(getattr(message, "name", ()))
    if not address.index:
        if np.ndim(value):
            elements = ", ".join(map(str, names or range(len(value))))
            raise InputError(f"{path}: --topics: {address} has {len(value)} elements; name one in brackets: {elements}")
        return field
    if address.index in names:
        # The joints may come in another order in another message.
        return lambda message: field(message)[list(message.name).index(address.index)]
    if not (address.index.isdigit() and np.ndim(value) and int(address.index) < len(value)):
        known = sorted(map(str, names)) or [str(number) for number in range(np.size(value))]
        raise InputError(f"{path}: --topics {address}: unknown element {one_line(unknown_key(address.index, known))}")
    return lambda message: field(message)[int(address.index)]


def list_numbers(path: Path) -> tuple[dict[str, Number], str]:
    """Return what numbers the messages of a bag hold.

    Returns
    -------
    numbers : dict of str to Number
        By address, from the first messages of each topic.
    problem : str
        Which topics cannot be read, and why; "" where all can.
    """
    bag = read_bag(path, most=_LISTED_MESSAGES)
    series: dict[str, list[float]] = {}
    undefined: dict[str, str] = {}
    for topic, entry in bag.topics.items():
        if topic.rsplit("/", 1)[-1] in _NO_SERIES:
            continue
        if entry.message_type not in bag.types.fielddefs:
            undefined[topic] = entry.message_type
            continue
        # A message that is damaged has no numbers to name; rosbags raises many kinds of errors for it.
        with suppress(Exception):
            for message in bag.decode(topic):
                for address, value in _numbers(message, topic):
                    series.setdefault(str(address), []).append(value)
    numbers = {
        address: Number(float(np.ptp(values)), len(values) > 2 and bool(np.all(np.diff(values) > 0)))
        for address, values in series.items()
    }
    return numbers, _undefined(undefined) if undefined else ""


def _numbers(content: Any, topic: str, prefix: str = "") -> Iterator[tuple[Address, float]]:
    """Yield address and value of each number in a message."""
    for field, value in vars(content).items():
        path = f"{prefix}{field}"
        if field.startswith("__") or field in ("header", "layout"):
            continue
        if isinstance(value, bool | int | float | np.number):
            yield Address(topic, path), float(value)
        elif (
            isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim == 1 and len(value) <= _MOST_ELEMENTS
        ):
            names = [str(name) for name in getattr(content, "name", ())] if not prefix else []
            labels = names if len(names) == len(value) else [str(index) for index in range(len(value))]
            yield from ((Address(topic, path, label), float(element)) for label, element in zip(labels, value, strict=True))
        elif hasattr(value, "__msgtype__"):
            yield from _numbers(value, topic, f"{path}.")
