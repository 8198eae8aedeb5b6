"""Which column of a file is which quantity: by its name in several languages, by its unit, or by what the user says."""

import re
import shlex
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_runs.importing.table import Column
from mrd_runs.importing.units import UNITS, find_unit, is_unit
from mrd_runs.text import one_line

WORDS: Mapping[str, frozenset[str]] = {
    quantity: frozenset(words.split())
    for quantity, words in {
        "time": "time t timestamp elapsed zeit temps tiempo tempo",
        "position": "position pos displacement disp stroke travel extension x lvdt weg hub lage auslenkung verschiebung "
        "deplacement course posicion desplazamiento posicao deslocamento spostamento corsa",
        "velocity": "velocity vel speed v xdot geschwindigkeit vitesse velocidad velocidade velocita",
        "acceleration": "acceleration accel acc a beschleunigung aceleracion aceleracao accelerazione",
        "force": "force f load loadcell effort kraft fuerza forca forza",
        "current": "current curr i coil strom courant corriente corrente",
        "temperature": "temperature temp temperatur temperatura",
    }.items()
}
"""Words of column names: English, German, French, Spanish, Portuguese, Italian; without accents."""

_COMPOUNDS = ("zeit", "weg", "hub", "geschwindigkeit", "beschleunigung", "kraft", "strom", "temperatur")  # Kolbenweg
_COMMANDED = ("set", "setpoint", "soll", "sollwert", "command", "commanded", "cmd", "target", "reference", "ref", "desired")
_OTHER_UNITS = ("v", "mv", "count", "counts", "digits", "lsb", "%", "bar", "psi", "rad", "deg", "°", "rpm", "hz")
_OPTIONS = {"current": "--current 0", "time": "--rate HZ"}  # in place of a column
_BRACKETED = re.compile(r"(.*?)[\s_]*[\[(<]\s*([^\])>]*?)\s*[\])>]", re.DOTALL)
_APPENDED = re.compile(r"(.+?)(?:\s+in\s+|\s*[/,]\s*|_|\s+)(\S+)", re.DOTALL)


@dataclass(frozen=True)
class Source:
    """Where a quantity comes from: a column, and the unit that its name or the file gives; "" without one."""

    name: str
    unit: str


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
        By quantity; always with force, and with position or velocity.

    Raises
    ------
    InputError
        When a column that is named is not there; or when names and units do not tell which column a quantity is. The line
        then ends with the options that would do.
    """
    named = {column.name: column for column in columns if column.name and not column.text}
    texts = {column.name: column.text for column in columns if column.name and column.text}
    for quantity, name in given.items():
        if name in texts:
            raise InputError(f"{where}: --map {quantity}: {name} holds {one_line(texts[name])!r}, expected numbers")
        if name not in named:
            raise InputError(f"{where}: --map {quantity}: unknown column {one_line(unknown_key(name, named))}")
    chosen = dict(given)
    doubtful: dict[str, list[str]] = {}
    for quantity, names in _candidates([column for name, column in named.items() if name not in given.values()]).items():
        if quantity not in given:
            doubtful[quantity] = names
            if len(names) == 1:
                chosen[quantity] = names[0]
    unneeded = {"current": current_is_given, "time": rate_is_given}
    unneeded["position"] = "velocity" in chosen and "position" not in doubtful
    needed = [quantity for quantity in ("time", "position", "force", "current") if not unneeded.get(quantity)]
    missing = [quantity for quantity in needed if quantity not in chosen]
    if missing:
        question = _question(where, list(named), chosen, doubtful, missing)
        others = ", ".join(f"{one_line(name)} holds {one_line(text)!r}" for name, text in list(texts.items())[:3])
        raise InputError(question + (f" (no numbers: {others})" if others else ""))
    used = {quantity: name for quantity, name in chosen.items() if quantity == "position" or not unneeded.get(quantity)}
    return {quantity: Source(name, _unit(quantity, named[name])) for quantity, name in used.items()}


def _candidates(columns: Sequence[Column]) -> dict[str, list[str]]:
    """Return the names of the columns that are most likely each quantity; a column is that of one quantity at most."""
    scores: dict[str, dict[str, int]] = {quantity: {} for quantity in UNITS}
    for column in columns:
        of_column = {quantity: _score(quantity, column) for quantity in UNITS}
        if not any(of_column.values()):
            unit = column.unit or _split(column.name)[1]
            of_column = {quantity: int(find_unit(quantity, unit) is not None) for quantity in UNITS if unit}
        best = [quantity for quantity, score in of_column.items() if score and score == max(of_column.values())]
        if len(best) == 1 and not set(_COMMANDED) & set(_words(column.name)):
            scores[best[0]][column.name] = of_column[best[0]]
    return {
        quantity: [name for name, score in found.items() if score == max(found.values())]
        for quantity, found in scores.items()
        if found
    }


def _score(quantity: str, column: Column) -> int:
    """Return how well a name fits a quantity: 4 for a word alone, 3 for a word among others, 2 for a letter among others."""
    base, bracketed, appended = _split(column.name)
    unit = column.unit or bracketed
    if unit and is_unit(unit) and not find_unit(quantity, unit):
        return 0
    if not unit and find_unit(quantity, appended):
        appended, words = "", _words(base)
    else:
        words = _words(f"{base} {appended}")
    known = [word for word in words if word in WORDS[quantity] or _is_compound(word, quantity)]
    if not known:
        return 0
    return 4 if len(words) == 1 else 3 if any(len(word) > 1 for word in known) else 2


def _is_compound(word: str, quantity: str) -> bool:
    return any(word.endswith(end) for end in _COMPOUNDS if end in WORDS[quantity])


def _unit(quantity: str, column: Column) -> str:
    """Return the unit of a column of a known quantity."""
    _, bracketed, appended = _split(column.name)
    return column.unit or bracketed or (appended if find_unit(quantity, appended) else "")


def _split(name: str) -> tuple[str, str, str]:
    """Return a name without unit, a unit in brackets after it, and a last word that may be a unit; "" for none."""
    match = _BRACKETED.fullmatch(name)
    if match and (is_unit(match[2]) or match[2].lower() in _OTHER_UNITS):
        return match[1], match[2], ""
    match = _APPENDED.fullmatch(name)
    return (match[1], "", match[2]) if match else (name, "", "")


def _words(name: str) -> list[str]:
    """Return the words of a name in lower case, without accents and numbers."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c)).replace("ß", "ss")
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", plain)]


def propose_topics(where: str, ranges: Mapping[str, float], *, current_is_given: bool) -> str:
    """Return the line that asks which numbers of a bag to take, with a proposal that would do.

    Parameters
    ----------
    where : str
        Path of the bag.
    ranges : mapping of str to float
        How far each number in its messages moves, by its address.
    current_is_given : bool
        Whether no current is needed.
    """
    candidates = _candidates([Column(address) for address in ranges])
    proposed: dict[str, str] = {}
    for quantity in ("position", "velocity", "force", "current"):
        if (quantity == "velocity" and "position" in proposed) or (quantity == "current" and current_is_given):
            continue
        free = [address for address in candidates.get(quantity, ()) if address not in proposed.values()]
        if quantity == "force" and not free:
            free = [address for address in ranges if address not in proposed.values()]
        if free:
            proposed[quantity] = max(free, key=ranges.__getitem__)
    options = [f"{quantity}={shlex.quote(address)}" for quantity, address in proposed.items()]
    options += [] if current_is_given or "current" in proposed else ["--current 0"]
    # The mapping comes first: a line is cut where it is long.
    return (
        f"{where}: is a bag of another bench; say which numbers to take with what is right of: "
        f"--topics {' '.join(options)} (numbers in it: {_listed(ranges)})"
    )


def _question(
    where: str,
    names: Sequence[str],
    chosen: Mapping[str, str],
    doubtful: Mapping[str, Sequence[str]],
    missing: Sequence[str],
) -> str:
    """Return the line that asks for a mapping, with one that would do."""
    free = [name for name in names if name not in chosen.values()]
    proposed, others = dict(chosen), []
    for quantity in missing:
        pool = [name for name in doubtful.get(quantity, ()) if name in free] or (free if quantity != "current" else [])
        if pool:
            proposed[quantity] = pool[0]
            free.remove(pool[0])
        elif quantity in _OPTIONS:
            others.append(_OPTIONS[quantity])
        else:
            expected = "expected time, position or velocity, and force"
            return f"{where}: no column is left for the {quantity}, {expected} (columns: {_listed(names)})"
    columns = " ".join(f"{quantity}={shlex.quote(name)}" for quantity, name in proposed.items())
    # The mapping comes first: a line is cut where it is long.
    return (
        f"{where}: the columns do not tell the {' and the '.join(missing)}; say so with what is right of: "
        f"{' '.join([f'--map {columns}', *others])} (columns: {_listed(names)})"
    )


def _listed(names: Collection[str]) -> str:
    """Return the first names of columns or topics, on one line."""
    return (", ".join(map(one_line, list(names)[:20])) or "none") + (", ..." if len(names) > 20 else "")
