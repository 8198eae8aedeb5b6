"""Which column of a file is which quantity: by its name in several languages, by its unit, or by what the user says."""

import itertools
import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_runs.importing.table import Column
from mrd_runs.importing.units import UNITS, find_unit, is_unit, looks_like_unit
from mrd_runs.importing.words import ALL_WORDS, WORDS, is_measured, is_word_of, names_quantity, words_of
from mrd_runs.text import one_line

_OPTIONS = {"current": "--current 0", "time": "--rate HZ"}  # in place of a column
_BRACKETED = re.compile(r"[\s_]*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]")
_SEPARATOR = re.compile(r"\s+in\s+|[\s_/,:;|]+")
_DOTS = re.compile(r"\.+")  # as R writes brackets: Force..N.
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_FACTOR = re.compile(r"(?:(?<!\w)[x×]|[*/÷])\s?10+(?!\w)|(?<![\w.])(?:[x×*]\s?)?10(?:\^|\*\*|e)-?\d+")
_REPEATED = re.compile(r" \(\d+\)$")  # what the second column of a name has behind it
_COUNTERS = (
    "sample",
    "samples",
    "samplenumber",
    "sampleno",
    "sampleindex",
    "index",
    "counter",
    "count",
    "n",
    "no",
    "nr",
    "scan",
    "frame",
    "framenumber",
    "row",
    "record",
    "point",
)
_MOST_TRIALS = 24


@dataclass(frozen=True)
class Source:
    """Where a quantity comes from: a column, the unit that its name or the file gives, "" without one, and its times."""

    name: str
    unit: str
    time: str = ""


class UndecidedError(InputError):
    """The columns of a file do not tell its quantities.

    Attributes
    ----------
    mappings : list of dict of str to str
        Columns by quantity that might be meant, the most likely first.
    missing : list of str
        Quantities that are not told.
    times : list of str
        Columns of times, where it is not clear which of them counts.
    columns : str
        The names of the columns, for a message.
    """

    def __init__(
        self, message: str, mappings: list[dict[str, str]], missing: list[str], times: list[str], columns: str
    ) -> None:
        super().__init__(message)
        self.mappings, self.missing, self.times, self.columns = mappings, missing, times, columns


def find_sources(
    columns: Iterable[Column], given: Mapping[str, str], where: str, *, current_is_given: bool, rate_is_given: bool
) -> dict[str, Source]:
    """Find the columns of the quantities.

    Parameters
    ----------
    columns : iterable of Column
        Those of the file; those without a name are left out.
    given : mapping of str to str
        Columns that the user names, by quantity.
    where : str
        Path of the file, for error messages.
    current_is_given, rate_is_given : bool
        Whether no column of current, or of time, is needed.

    Returns
    -------
    dict of str to Source
        By quantity; always with force, and with position or velocity; without time where columns have times of their own.

    Raises
    ------
    InputError
        When a column that is named is not there.
    UndecidedError
        When names and units do not tell which column a quantity is.
    """
    columns = [column for column in columns if column.name]
    named = {column.name: column for column in columns if not column.text}
    texts = {column.name: column.text for column in columns if column.text}
    for quantity, name in given.items():
        if name in texts:
            raise InputError(f"{where}: --map {quantity}: {name} holds {one_line(texts[name])!r}, expected numbers")
        if name not in named:
            raise InputError(f"{where}: --map {quantity}: unknown column {one_line(unknown_key(name, named))}")
    chosen = dict(given)
    doubtful: dict[str, list[str]] = {}
    candidates = _candidates([column for name, column in named.items() if name not in given.values()])
    times = [given["time"]] if "time" in given else candidates.pop("time", [])
    for quantity, names in candidates.items():
        if quantity not in given:
            doubtful[quantity] = names
            if len(names) == 1:
                chosen[quantity] = names[0]
    unneeded = {"current": current_is_given, "position": "velocity" in chosen and "position" not in doubtful}
    needed = [quantity for quantity in ("position", "force", "current") if not unneeded.get(quantity)]
    missing = [quantity for quantity in needed if quantity not in chosen]
    used = {quantity: name for quantity, name in chosen.items() if not unneeded.get(quantity) and quantity != "time"}
    of = {} if rate_is_given else {q: _time_of(q, named[name], list(named.values()), times) for q, name in used.items()}
    has_times = all(of.values()) if of else bool(times) or any(column.time for column in columns)
    if not rate_is_given and not has_times:
        missing = ["time", *missing]
    if missing:
        known = {quantity: name for quantity, name in chosen.items() if quantity not in missing}
        if len(times) == 1 and not rate_is_given:
            known = {"time": times[0]} | known
        raise _undecided(where, named, known, doubtful | {"time": times}, missing, texts)
    sources = {q: Source(name, unit_of(q, named[name]), of.get(q) or "") for q, name in used.items()}
    if len(set(of.values())) == 1:
        (name,) = {time for time in of.values() if time}
        sources["time"] = Source(name, unit_of("time", named[name]), name)
    return sources


def shown_options(option: str, pairs: Mapping[str, str]) -> list[str]:
    """Return an option of the import with its pairs as arguments; nothing without pairs."""
    return [option, *(f"{quantity}={shlex.quote(text)}" for quantity, text in pairs.items())] if pairs else []


def is_counter(column: Column) -> bool:
    """Return whether a column numbers the samples, by its name."""
    return not column.text and re.sub(r"[\W_]", "", column.name.lower()) in _COUNTERS


def is_speed(column: Column) -> bool:
    """Return whether a column holds velocities, by its name or unit."""
    return list(_candidates([column])) == ["velocity"]


def is_time(column: Column) -> bool:
    """Return whether a column holds times, by its name or unit."""
    return list(_candidates([column])) == ["time"]


def is_no_time(column: Column) -> bool:
    """Return whether a column holds another quantity than times, by its unit or by a word: a letter such as x may be one."""
    (quantity, *_) = [*_candidates([column]), "time"]
    by_word = any(len(word) > 1 and is_word_of(word, quantity) for word in words_of(column.name))
    return quantity != "time" and (by_word or find_unit(quantity, unit_of(quantity, column)) is not None)


def _time_of(quantity: str, column: Column, columns: Sequence[Column], times: Sequence[str]) -> str | None:
    """Return the column with the times of a column; None where there is none, or where it is not clear."""
    if column.time or len(times) < 2:
        return column.time or next(iter(times), None)
    own = [name for name in times if WORDS[quantity] & set(words_of(name))]
    if len(own) == 1:
        return own[0]
    depth = {name: _common_parents(name, column.name) for name in times}
    times = [name for name in times if depth[name] == max(depth.values())]
    if len(times) == 1:
        return times[0]
    # A pair of time and values stands side by side, and so do the columns of a table, behind their time.
    order = [other.name for other in columns]
    places = sorted(order.index(name) for name in times)
    place = order.index(column.name)
    before = [time for time in places if time < place]
    side_by_side = any(later - earlier == 1 for earlier, later in itertools.pairwise(places))
    return order[before[-1]] if before and not side_by_side else None


def _common_parents(name: str, other: str) -> int:
    """Return how many groups or structures two names have in common."""
    parents, others = re.split(r"[./]", name)[:-1], re.split(r"[./]", other)[:-1]
    return sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(parents, others, strict=False)))


def _candidates(columns: Sequence[Column]) -> dict[str, list[str]]:
    """Return the names of the columns that are most likely each quantity; a column is that of one quantity at most."""
    scores: dict[str, dict[str, int]] = {quantity: {} for quantity in UNITS}
    for column in columns:
        of_column = {quantity: _score(quantity, column) for quantity in UNITS}
        if not any(of_column.values()):
            unit = column.unit or _split(column.name)[1]
            of_column = {quantity: int(find_unit(quantity, unit) is not None) for quantity in UNITS if unit}
        best = [quantity for quantity, score in of_column.items() if score and score == max(of_column.values())]
        if len(best) == 1 and is_measured(best[0], _without_unit(best[0], column.name)):
            scores[best[0]][column.name] = of_column[best[0]]
    return {
        quantity: [name for name, score in found.items() if score == max(found.values())]
        for quantity, found in scores.items()
        if found
    }


def _score(quantity: str, column: Column) -> int:
    """Return how well a name fits a quantity: 4 for a word alone, 3 for a word among others, 2 for a letter among others.

    A column in a unit that cannot be converted fits least.
    """
    if re.sub(r"[\W_]", "", _REPEATED.sub("", column.name)).lower() == "xvalue":  # as LabVIEW calls it
        return 4 if quantity == "time" else 0
    _, bracketed, appended = _split(column.name)
    unit = column.unit or bracketed
    if unit and is_unit(unit) and not find_unit(quantity, unit):
        return 0
    text = _without_unit(quantity, column.name)
    # The last part of a path tells more than those before it, where it is more than a letter.
    last = words_of(re.split(r"[./]", text)[-1])
    words = last if any(len(word) > 1 for word in set(last) & ALL_WORDS) else words_of(text)
    known = [word for word in words if is_word_of(word, quantity)]
    if not known:
        return 0
    if (unit and not find_unit(quantity, unit)) or (not unit and _is_other(appended)):
        return 1
    return 4 if len(words) == 1 else 3 if any(len(word) > 1 for word in known) else 2


def _is_other(text: str) -> bool:
    """Return whether a text names a unit that is of no quantity of a recording, or is not known."""
    return looks_like_unit(text) and not is_unit(text)


def unit_of(quantity: str, column: Column) -> str:
    """Return the unit of a column of a known quantity, with a factor before it where the name has one."""
    base, bracketed, appended = _split(column.name)
    unit = column.unit or bracketed or (appended if find_unit(quantity, appended) or _is_other(appended) else "")
    factor = _FACTOR.search(base)
    return f"{factor[0]} {unit}".strip() if factor else unit


def _without_unit(quantity: str, name: str) -> str:
    """Return a name without what is a unit at its end: one of a quantity, one that is not known, or a symbol such as A."""
    base, bracketed, appended = _split(name)
    is_symbol = any(appended in units for units in UNITS.values())
    return base if bracketed or find_unit(quantity, appended) or _is_other(appended) or is_symbol else name


def _split(name: str) -> tuple[str, str, str]:
    """Return a name without unit, what stands in brackets as a unit does, and what else of the name may be a unit.

    Either is "" where there is none. A number in brackets is that of a column.
    """
    name = _REPEATED.sub("", name).strip()
    brackets = [match for match in _BRACKETED.finditer(name) if not match[1].isdigit() and len(match[0]) < len(name)]
    brackets = [match for match in brackets if match.start() > 0 or looks_like_unit(match[1])]
    if brackets:
        match = next((match for match in brackets if looks_like_unit(match[1])), brackets[-1])
        return f"{name[: match.start()]} {name[match.end() :]}".strip(), match[1], ""
    ends, dots, humps = (
        [match.span() for match in mark.finditer(name) if match.start()] for mark in (_SEPARATOR, _DOTS, _CAMEL)
    )
    for begin, end in sorted(ends + dots):
        rest = name[end:].rstrip(".")
        if looks_like_unit(rest) and ((begin, end) in ends or names_quantity(name[:begin])):
            return name[:begin], "", rest
    if glued := _glued_unit(name):
        return name[: -len(glued)], "", glued
    for begin, end in humps:
        if looks_like_unit(name[end:]):
            return name[:begin], "", name[end:]
    for begin, end in ends:
        if begin > 1 and name[:begin].lower() not in ("in", "min") and is_unit(name[:begin]) and names_quantity(name[end:]):
            return name[end:], "", name[:begin]
    last = max([*ends, *humps], default=(len(name), len(name)))
    return name[: last[0]], "", name[last[1] :]


def _glued_unit(name: str) -> str:
    """Return the unit that ends a name without anything between, as in ``currentmA``; "" where none does."""
    end = re.split(r"[^A-Za-zµ]", name)[-1]
    if end.lower() in ALL_WORDS:
        return ""
    for length in range(min(4, len(end) - 3), 0, -1):
        head, unit = end[:-length].lower(), end[-length:]
        if any(head in words and find_unit(quantity, unit) for quantity, words in WORDS.items()):
            return unit
    return ""


def topic_mappings(ranges: Mapping[str, float], *, current_is_given: bool) -> list[dict[str, str]]:
    """Return which numbers of a bag may be which quantity, the most likely mapping first.

    Parameters
    ----------
    ranges : mapping of str to float
        How far each number in its messages moves, by its address.
    current_is_given : bool
        Whether no current is needed.
    """
    # The index of an element stands in brackets, as units do elsewhere.
    address_of = {re.sub(r"[\[\]]", ".", address): address for address in ranges}
    found = _candidates([Column(name) for name in address_of])
    candidates = {quantity: [address_of[name] for name in names] for quantity, names in found.items()}
    moving = sorted((address for address in ranges if ranges[address] > 0), key=ranges.__getitem__)
    motion = "velocity" if "velocity" in candidates and "position" not in candidates else "position"
    pools: dict[str, list[str]] = {}
    for quantity in (motion, "force", *([] if current_is_given else ["current"])):
        named = sorted(candidates.get(quantity, ()), key=ranges.__getitem__, reverse=True)
        pools[quantity] = named or (moving if quantity == motion else moving[::-1] if quantity == "force" else [])
    pools = {quantity: pool for quantity, pool in pools.items() if pool or quantity != "current"}
    chosen = (dict(zip(pools, addresses, strict=True)) for addresses in itertools.product(*pools.values()))
    different = (mapping for mapping in chosen if len(set(mapping.values())) == len(mapping))
    return list(itertools.islice(different, _MOST_TRIALS))


def _undecided(
    where: str,
    named: Mapping[str, Column],
    chosen: Mapping[str, str],
    doubtful: Mapping[str, Sequence[str]],
    missing: list[str],
    texts: Mapping[str, str],
) -> UndecidedError:
    """Return the error about quantities that the columns do not tell, with the mappings that might be meant."""
    free = [name for name, column in named.items() if name not in chosen.values() and not is_counter(column)]
    pools = []
    for quantity in missing:
        pool = [name for name in doubtful.get(quantity, ()) if name in free]
        pool += [name for name in free if quantity not in _OPTIONS or quantity == "time"] if not pool else []
        pools.append([*pool, ""] if quantity in _OPTIONS else pool)
    mappings: list[dict[str, str]] = []
    for names_of in itertools.product(*pools):
        used = [name for name in names_of if name]
        if len(set(used)) == len(used) and len(mappings) < _MOST_TRIALS:
            mappings.append(dict(chosen) | {q: name for q, name in zip(missing, names_of, strict=True) if name})
    known = f"columns: {listed(named)}"
    if texts:
        shown = (f"{one_line(name)} holds {one_line(text)!r}" for name, text in list(texts.items())[:3])
        known += f"; no numbers: {', '.join(shown)}"
    if not mappings:
        message = f"no column is left for the {' and the '.join(missing)}, expected time, position or velocity, and force"
    else:
        message = f"the columns do not tell the {' and the '.join(missing)}"
    return UndecidedError(f"{where}: {message} ({known})", mappings, missing, list(doubtful.get("time", ())), known)


def listed(names: Collection[str]) -> str:
    """Return the first names of columns or topics, on one line."""
    return (", ".join(map(one_line, list(names)[:20])) or "none") + (", ..." if len(names) > 20 else "")
