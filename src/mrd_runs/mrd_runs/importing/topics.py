"""Series in bags of other benches: numbers in messages of any type, named as ``/topic.field[index]``."""

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_runs.bag import Bag, read_bag
from mrd_runs.importing.synchronise import Series, increasing
from mrd_runs.text import one_line

Stamps = NDArray[np.int64]

_ADDRESS = re.compile(r"(?P<topic>[^.\[\]\s]+)\.(?P<field>[\w.]+)(\[(?P<index>[^\[\]]+)\])?")
_MOST_ELEMENTS = 12  # of an array that is listed
_LISTED_MESSAGES = 50
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


def parse_address(text: str, option: str) -> Address:
    """Parse ``/topic.field`` or ``/topic.field[index]``; raise InputError for another text."""
    match = _ADDRESS.fullmatch(text)
    if match is None:
        raise InputError(f"{option}: {text} is no number of a topic; expected /TOPIC.FIELD or /TOPIC.FIELD[INDEX OR NAME]")
    return Address(match["topic"], match["field"], match["index"] or "")


def read_topics(path: Path, addresses: Mapping[str, Address]) -> tuple[dict[str, Series], list[str]]:
    """Read numbers from the messages of a bag, with the times of their headers or else of their recording.

    Parameters
    ----------
    path : Path
        Bag folder, ``.mcap`` or ``.db3`` file.
    addresses : mapping of str to Address
        By quantity.

    Returns
    -------
    series : dict of str to (ndarray (n,), ndarray (n,))
        Times in s, increasing from near 0, and values, by quantity.
    notes : list of str

    Raises
    ------
    InputError
        When the bag cannot be read, or a topic, a field or an element is not there.
    """
    bag = read_bag(path, {address.topic.rsplit("/", 1)[-1] for address in addresses.values()})
    notes: list[str] = []
    values: dict[str, list[float]] = {}
    stamps: dict[str, Stamps] = {}
    for topic in dict.fromkeys(address.topic for address in addresses.values()):
        wanted = {quantity: address for quantity, address in addresses.items() if address.topic == topic}
        of_topic, has_headers, found = _read_topic(bag, topic, wanted, path)
        values |= found
        stamps |= dict.fromkeys(wanted, of_topic)
        if not has_headers:
            notes.append(f"{topic}: the times are those of the recording, because its messages have no stamps")
    start = min(of_topic.min() for of_topic in stamps.values())
    series = {}
    for quantity, of_topic in stamps.items():
        time, ordered, wrong = increasing(1e-9 * (of_topic - start), values[quantity])
        series[quantity] = (time, ordered)
        if wrong:
            notes.append(f"{quantity}: {wrong} messages were out of order or had the time of another one")
    return series, notes


def _read_topic(
    bag: Bag, topic: str, wanted: Mapping[str, Address], path: Path
) -> tuple[Stamps, bool, dict[str, list[float]]]:
    """Return the times of the messages of a topic in ns, whether their headers have them, and the values by quantity."""
    if topic not in bag.topics:
        raise InputError(f"{path}: --topics: unknown topic {one_line(unknown_key(topic, sorted(bag.topics)))}")
    entry = bag.topics[topic]
    if not entry.messages:
        raise InputError(f"{path}: {topic} has no messages; expected a recording")
    getters: dict[str, Callable[[Any], float]] = {}
    values: dict[str, list[float]] = {quantity: [] for quantity in wanted}
    headers: list[int] = []
    for number, cdr in enumerate(entry.messages):
        try:
            message = bag.types.deserialize_cdr(cdr, entry.message_type)
        except Exception as error:  # rosbags raises many kinds
            raise InputError(f"{path}: a message of {one_line(topic)} cannot be read ({one_line(error)})") from None
        getters = getters or {quantity: _getter(message, address, path) for quantity, address in wanted.items()}
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        headers.append(stamp.sec * 10**9 + stamp.nanosec if stamp is not None else 0)
        for quantity, get in getters.items():
            try:
                values[quantity].append(float(get(message)))
            except (IndexError, ValueError, TypeError):
                raise InputError(
                    f"{path}: message {number} of {topic} has no {wanted[quantity]}; expected it in each"
                ) from None
    has_headers = all(headers)
    return np.array(headers if has_headers else entry.stamps, np.int64), has_headers, values


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
        known = [str(name) for name in names] or [str(number) for number in range(np.size(value))]
        raise InputError(f"{path}: --topics {address}: unknown element {one_line(unknown_key(address.index, known))}")
    return lambda message: field(message)[int(address.index)]


def list_numbers(path: Path) -> dict[str, float]:
    """Return the addresses of all numbers in the messages of a bag, with their range in the first messages of each topic."""
    bag = read_bag(path, most=_LISTED_MESSAGES)
    ranges: dict[str, list[float]] = {}
    for topic in bag.topics:
        if topic.rsplit("/", 1)[-1] in _NO_SERIES:
            continue
        # A type that is not known has no numbers to name; rosbags raises many kinds of errors for it.
        with suppress(Exception):
            for message in bag.decode(topic):
                for address, value in _numbers(message, topic):
                    ranges.setdefault(str(address), []).append(value)
    return {address: float(np.ptp(values)) for address, values in ranges.items()}


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
