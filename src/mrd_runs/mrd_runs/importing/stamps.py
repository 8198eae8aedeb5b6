"""The times of messages of several topics, put onto one clock: header stamps where these agree, else times of receipt."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.importing.clocks import MOST_REPEATS, Indices, Passes, find_passes, usual_step

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_WINDOWS = 8
"""Parts of a recording in which the clocks are compared."""
_FEWEST = 5 * _WINDOWS
"""Messages of a topic from which its clock is compared with others."""
_FASTEST = 10.0
"""Percentile of the delays from stamp to receipt that is compared: a busy network makes others longer, never these."""
_LONGEST_DELAY = 1.0
"""Delay in s between two topics from which their stamps are those of two clocks rather than of a slow transport."""


@dataclass(frozen=True)
class Topic:
    """When the messages of a topic were received and, by their headers, measured, in ns; in the order of the file.

    Attributes
    ----------
    receipt : ndarray (n,) of int64
    header : ndarray (n,) of int64 or None
        None where the messages have no header, or none that anybody set.
    """

    receipt: Stamps
    header: Stamps | None = None

    def take(self, indices: Indices) -> "Topic":
        """Return some of the messages."""
        return Topic(self.receipt[indices], None if self.header is None else self.header[indices])


@dataclass(frozen=True)
class Timed:
    """The usable messages of a topic in the order of their times.

    Attributes
    ----------
    index : ndarray (m,) of int
        Numbers of the messages in the file.
    time : ndarray (m,)
        Increasing times in s on the clock of all topics.
    clock : str
        What the times are of. Topics with the same text have times of one clock.
    """

    index: Indices
    time: Array
    clock: str


@dataclass(frozen=True)
class _Clocks:
    """Times of receipt of a topic and, where there are, of its headers, in s, and the passes of the latter.

    Headers count from ``origin`` on, in s on the clock from whose beginning receipts count.
    """

    receipt: Array
    header: Array | None
    order: Passes
    origin: float

    @property
    def problem(self) -> str:
        """Why the stamps do not tell the times; "" where they do."""
        if self.header is None:
            return "its messages have no stamps"
        repeats = self.order.repeats
        return f"{100 * repeats:.0f} % of its stamps repeat another one" if repeats > MOST_REPEATS else ""

    def of_pass(self, number: int) -> tuple[Indices, Array]:
        """Return the messages of a pass of the header's clock and their times."""
        assert self.header is not None
        piece = self.order.pieces[number]
        return piece, self.header[piece]


def align_topics(topics: Mapping[str, Topic], main: Collection[str], where: str) -> tuple[list[dict[str, Timed]], list[str]]:
    """Put topics onto one clock.

    Header stamps are taken where every main topic has them, and where the delays from stamp to receipt tell nothing against
    them. A clock that is set back, as that of a simulation is, makes several passes. Where the stamps cannot be used, the
    times of receipt are taken, made even by the stamps where these run steadily.

    Parameters
    ----------
    topics : mapping of str to Topic
        By name.
    main : collection of str
        Topics that decide on the clock; the others follow.
    where : str
        Prefix of error messages.

    Returns
    -------
    passes : list of dict of str to Timed
    told : list of str
        Clauses about what was found and done.

    Raises
    ------
    InputError
        When neither stamps nor times of receipt put the topics onto one clock.
    """
    origin = min(int(topic.receipt.min()) for topic in topics.values())
    orders = {
        name: find_passes(_seconds(topic.receipt, origin), any_order=True, unset=-1e-9 * origin)
        for name, topic in topics.items()
    }
    told = [f"{name}: {clause}" for name, order in orders.items() for clause in order.told if "dropped" in clause]
    count = len(orders[next(iter(main))].pieces)
    other = next((name for name in topics if len(orders[name].pieces) != count), None)
    if other is not None:
        name, jump = next((name, order.jumps[0]) for name, order in orders.items() if order.jumps)
        raise InputError(
            f"{where}: the recording's clock is set back by {jump:.4g} s between two messages of {name}, and not so often "
            f"between those of {other}; expected one clock for all: record each pass into a bag of its own"
        )
    if count > 1:
        told.append(_set_back("the recording", orders[next(iter(main))]))
    passes = []
    for number in range(count):
        numbers = {name: order.pieces[number] for name, order in orders.items()}
        found, clauses = _align_pass({name: topic.take(numbers[name]) for name, topic in topics.items()}, main, where)
        passes += [{name: replace(one, index=numbers[name][one.index]) for name, one in each.items()} for each in found]
        told += [clause for clause in clauses if clause not in told]
    return passes, told


def _set_back(clock: str, order: Passes) -> str:
    by = ", ".join(f"{jump:.4g} s" for jump in order.jumps[:5])
    return f"the clock of {clock} is set back by {by}, which makes {len(order.pieces)} passes"


def _align_pass(topics: Mapping[str, Topic], main: Collection[str], where: str) -> tuple[list[dict[str, Timed]], list[str]]:
    """Put topics onto one clock; their messages are in the order of their receipt."""
    clocks = _clocks(topics)
    first = next(iter(main))
    reason = next((f"{name}: {clocks[name].problem}" for name in main if clocks[name].problem), "")
    reason = reason or next((text for name in main if (text := _difference(clocks, first, name))), "")
    if reason:
        dropped = [f"{name}: {text}" for name, one in clocks.items() for text in one.order.told if "far" in text]
        told = [f"the times are those of the recording ({reason})", *dropped]
        return [{name: _of_receipt(name, one, where, reason) for name, one in clocks.items()}], told
    stamped = [name for name in topics if not (clocks[name].problem or _difference(clocks, first, name))]
    others = [name for name in topics if name not in stamped]
    told = [f"{name}: {text}" for name in stamped for text in clocks[name].order.told]
    told += [f"{name} is put onto the stamps of {first} by its times of receipt" for name in others]
    if clocks[first].order.jumps:
        told.append(_set_back("the headers", clocks[first].order))
    told += [text for name in stamped if (text := _doubt(clocks, first, name))]
    owners = {name: next(other for other in stamped if _has_same_stamps(clocks, other, name)) for name in stamped}
    passes = []
    for number in range(len(clocks[first].order.pieces)):
        one = {name: Timed(*clocks[name].of_pass(number), f"header stamps of {owners[name]}") for name in stamped}
        one |= {name: _following(name, clocks[name], clocks[first], one[first].index) for name in others}
        passes.append({name: one[name] for name in topics})
    return passes, told


def _seconds(stamps: Stamps, origin: int) -> Array:
    return (stamps - origin).astype(np.float64) * 1e-9


def _clocks(topics: Mapping[str, Topic]) -> dict[str, _Clocks]:
    origin = min(int(topic.receipt[0]) for topic in topics.values())
    typical = [int(np.median(topic.header)) for topic in topics.values() if topic.header is not None]
    unset = typical[0] if typical else 0
    clocks = {}
    for name, topic in topics.items():
        receipt = _seconds(topic.receipt, origin)
        header = None if topic.header is None else _seconds(topic.header, unset)
        order = find_passes(receipt, any_order=True) if header is None else find_passes(header, receipt, unset=-1e-9 * unset)
        clocks[name] = _Clocks(
            receipt, header, order.unrepeated(receipt if header is None else header), 1e-9 * (unset - origin)
        )
    return clocks


def _delays(clocks: Mapping[str, _Clocks], name: str, other: str) -> Array:
    """Return the shortest usual delays (k,) from stamp to receipt in the parts of the time that two topics share."""
    of, to = clocks[name], clocks[other]
    assert of.header is not None
    kept = np.sort(np.concatenate(of.order.pieces))
    begin, end = max(of.receipt[0], to.receipt[0]), min(of.receipt[-1], to.receipt[-1])
    part = np.floor(_WINDOWS * (of.receipt[kept] - begin) / max(end - begin, 1e-9)).clip(-1, _WINDOWS)
    delay = of.receipt[kept] - of.header[kept] - of.origin
    return np.array(
        [np.percentile(delay[part == number], _FASTEST) if (part == number).any() else np.nan for number in range(_WINDOWS)]
    )


def _has_same_stamps(clocks: Mapping[str, _Clocks], name: str, other: str) -> bool:
    """Return whether two topics have the same stamps but for those that were dropped: one clock was read for both."""
    of, to = clocks[name], clocks[other]
    if name == other or of.header is None or to.header is None:
        return name == other
    headers = ((of.header, of.order), (to.header, to.order))
    kept = [header[np.concatenate(order.pieces)] for header, order in headers]
    dropped = [len(one.receipt) - len(times) for one, times in zip((of, to), kept, strict=True)]
    if max(dropped) > MOST_REPEATS * min(map(len, kept)):
        return False
    absent = [len(np.setdiff1d(times, other)) for times, other in (kept, reversed(kept))]
    return absent[0] <= dropped[1] and absent[1] <= dropped[0]


def _compared(clocks: Mapping[str, _Clocks], first: str, name: str) -> tuple[Array, float] | None:
    """Return how much longer the delays of a topic are than those of the first, and the interval of the slower one."""
    same = _has_same_stamps(clocks, first, name)
    if same or min(len(clocks[first].receipt), len(clocks[name].receipt)) < _FEWEST:
        return None
    step = max(usual_step(clocks[first].receipt), usual_step(clocks[name].receipt))
    difference = _delays(clocks, name, first) - _delays(clocks, first, name)
    return (difference, step) if np.isfinite(difference).any() else None


def _difference(clocks: Mapping[str, _Clocks], first: str, name: str) -> str:
    """Return why the stamps of a topic are of another clock than those of the first; "" where nothing tells it."""
    passes, others = len(clocks[first].order.pieces), len(clocks[name].order.pieces)
    if passes != others:
        by = (clocks[first].order.jumps + clocks[name].order.jumps)[0]
        return f"the stamps of one of {first} and {name} are set back by {by:.4g} s, those of the other are not"
    compared = _compared(clocks, first, name)
    if compared is None:
        return ""
    difference, step = compared
    typical, range_ = float(np.nanmedian(difference)), float(np.nanmax(difference) - np.nanmin(difference))
    if abs(typical) > _LONGEST_DELAY:
        return f"the stamps of {name} and {first} are of two clocks, {abs(typical):.6g} s apart"
    if range_ > step:
        return f"the clocks of the stamps of {name} and {first} run apart by {1e3 * range_:.3g} ms"
    earliest = {one: float(np.nanmedian(_delays(clocks, one, other))) for one, other in ((name, first), (first, name))}
    ahead = min(earliest, key=earliest.__getitem__)
    if abs(typical) > step and earliest[ahead] < -step and max(earliest.values()) >= 0:
        return f"the stamps of {ahead} lie {-1e3 * earliest[ahead]:.3g} ms after their receipt, on a clock of their own"
    return ""


def _doubt(clocks: Mapping[str, _Clocks], first: str, name: str) -> str:
    """Return a clause where the delays of two topics differ by more than a sample; "" else."""
    compared = _compared(clocks, first, name)
    typical = 0.0 if compared is None else float(np.nanmedian(compared[0]))
    if compared is None or abs(typical) <= compared[1]:
        return ""
    later, earlier = (name, first) if typical > 0 else (first, name)
    return (
        f"from stamp to receipt {later} takes {1e3 * abs(typical):.3g} ms more than {earlier}: a slow transport, or a clock "
        "that differs by that"
    )


def _following(name: str, clocks: _Clocks, first: _Clocks, index: Indices) -> Timed:
    """Return the messages of a topic on the header clock of another one, whose messages of a pass are given."""
    assert first.header is not None
    time = clocks.receipt - float(np.median(first.receipt[index] - first.header[index]))
    begin, end = first.receipt[index].min(), first.receipt[index].max()
    inside = np.flatnonzero((clocks.receipt <= end) & (np.append(clocks.receipt[1:], np.inf) > begin))
    inside = inside[np.diff(time[inside], prepend=-np.inf) > 0]
    return Timed(inside, time[inside], f"receipt of {name}")


def _of_receipt(name: str, clocks: _Clocks, where: str, reason: str) -> Timed:
    """Return the messages of a topic at the times of their receipt, which steady stamps make even."""
    receipt, header = clocks.receipt, clocks.header
    if header is not None and not clocks.problem and len(clocks.order.pieces) == 1 and len(header) >= _FEWEST:
        index, time = clocks.of_pass(0)
        line = np.polynomial.Polynomial.fit(time, receipt[index], 1)
        rest = receipt[index] - line(time)
        if np.ptp([float(np.median(part)) for part in np.array_split(rest, _WINDOWS)]) < usual_step(time):
            return Timed(index, np.asarray(line(time) + np.percentile(rest, _FASTEST)), f"receipt of {name}")
    index = np.flatnonzero(np.diff(receipt, prepend=-np.inf) > 0)
    repeats = 1 - len(index) / len(receipt)
    if repeats > MOST_REPEATS:
        raise InputError(
            f"{where}: {100 * repeats:.0f} % of the messages of {name} were received at the time of another one, and the "
            f"header stamps cannot be used ({reason}); no times are left to put the topics onto one clock"
        )
    return Timed(index, receipt[index], f"receipt of {name}")
