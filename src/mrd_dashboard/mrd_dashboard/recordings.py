"""The recordings of the bench: finding, describing, searching, recovering and deleting them.

What people add to a recording stands in a file of the recording's own folder, so that it moves with it.
"""

import dataclasses
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

import yaml

from mrd_base import InputError, from_mapping, quantity, read_yaml, to_mapping
from mrd_runs.recovery import recover_bag, recovered_path
from mrd_runs.storage import SUFFIXES

T = TypeVar("T")

NOTES_FILE = "notes.yaml"
METADATA = "metadata.yaml"
CACHE_FOLDER = ".page"
"""Folder, among the recordings, of what the page can compute again."""
NOTES_REMEDY = "mend or remove the file, then its notes can be changed here"
"""It tells what to do about notes that cannot be read."""
LONGEST_NOTE = 10_000
"""Characters."""
DEPTH = 3
"""Parts of the longest id: a diagnosis on the bench records into ``diagnosis-TIME/round_1/NAME``."""
SCAN_PERIOD = 2.0
"""Wall time in s between two scans of the folders, however many pages are open."""
_SCAN_SHARE = 0.1  # of a core that the scans may take, where there are very many recordings


@dataclass(frozen=True)
class Notes:
    """What people add to a recording; units in the names."""

    damper: str = quantity("", "", "serial number of the damper")
    temperature: float | None = quantity(None, "degC", "of the damper", lower=-60, upper=200)
    tags: tuple[str, ...] = quantity((), "", "words to find the recording by")
    text: str = quantity("", "", "anything else")


@dataclass(frozen=True)
class Recording:
    """A recorded bag.

    Attributes
    ----------
    id : str
        Path within the folder of the recordings, with /.
    path : Path
    modified : float
        Unix time in s of the last change of its folder.
    notes : Notes
    problem : str
        Why its notes cannot be read, or "".
    closed : bool
        Whether its recorder has closed it: it has metadata.yaml. One that was killed leaves a bag that can be recovered.
    """

    id: str
    path: Path
    modified: float
    notes: Notes = Notes()
    problem: str = ""
    closed: bool = True

    @property
    def date(self) -> str:
        """The time of the recording's end as people read it, by the clock of this machine as in the names of folders."""
        return f"{datetime.fromtimestamp(self.modified):%Y-%m-%d %H:%M}"

    def matches(self, search: str) -> bool:
        """Return whether all words of a search stand in its name, its notes, or its date."""
        notes = self.notes
        text = " ".join([self.id, self.date, notes.damper, *notes.tags, notes.text]).casefold()
        return all(word in text for word in search.casefold().split())


class Scan(Generic[T]):
    """What a scan of folders finds, for all pages together.

    Parameters
    ----------
    scan : callable
        Scans; it is called in the thread that asks.
    """

    def __init__(self, scan: Callable[[], T]) -> None:
        self._scan, self._lock, self._next = scan, threading.Lock(), -float("inf")

    def found(self) -> T:
        """Return what is found, as of `SCAN_PERIOD` ago at most, or longer ago where a scan takes long."""
        with self._lock:
            began = time.monotonic()
            if began >= self._next:
                self._found = self._scan()
                ended = time.monotonic()
                self._next = ended + max(SCAN_PERIOD, (ended - began) / _SCAN_SHARE)
            return self._found

    def expire(self) -> None:
        """Let the next one who asks scan the folders: something has changed."""
        self._next = -float("inf")


def new_name(name: str) -> str:
    """Return the name of a run, or refuse it.

    Raises
    ------
    InputError
        For a name that is more, or less, than the name of one folder.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name):
        raise InputError(f"name: found {name[:80]!r}, expected 1 to 64 letters, digits, - and _")
    return name


@dataclass
class Recordings:
    """The recordings in a folder, and in the folders therein, as deep as `DEPTH`.

    Attributes
    ----------
    folder : Path
    """

    folder: Path
    _notes: dict[Path, tuple[int, Notes, str]] = field(default_factory=dict, repr=False)
    _all: Scan[list[Recording]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.folder = self.folder.expanduser().resolve()
        self.folder.mkdir(parents=True, exist_ok=True)
        self._all = Scan(lambda: sorted(self._scan(self.folder, DEPTH), key=lambda found: (-found.modified, found.id)))

    def search(self, search: str = "") -> list[Recording]:
        """Return the recordings that match a search, the latest first, as of `SCAN_PERIOD` ago at most."""
        found = self._all.found()
        return [recording for recording in found if recording.matches(search)] if search.split() else found

    def _scan(self, folder: Path, depth: int) -> list[Recording]:
        found = []
        try:
            entries = list(os.scandir(folder))
        except OSError:
            return []  # somebody has just deleted it
        for entry in entries:
            # A link could lead out of the folder.
            if not entry.is_dir(follow_symlinks=False) or entry.name.startswith("."):
                continue
            path = Path(entry.path)
            if (closed := _is_closed(path)) or _has_samples(path):
                try:
                    notes, problem = self._read_notes(path)
                    modified = entry.stat(follow_symlinks=False).st_mtime
                except OSError:
                    continue  # somebody has just deleted it
                identifier = path.relative_to(self.folder).as_posix()
                found.append(Recording(identifier, path, modified, notes, problem, closed))
            elif depth > 1:
                found += self._scan(path, depth - 1)
        return found

    def _read_notes(self, path: Path) -> tuple[Notes, str]:
        file = path / NOTES_FILE
        try:
            changed = file.stat().st_mtime_ns
        except OSError:
            return Notes(), ""
        known = self._notes.get(file)
        if known is None or known[0] != changed:
            try:
                content = {key: value for key, value in read_yaml(file).items() if value not in ([], None)}
                known = changed, from_mapping(Notes, content, str(file)), ""
            except InputError as error:
                known = changed, Notes(), str(error)
            self._notes[file] = known
        return known[1:]

    def find(self, recording: str) -> Recording:
        """Return a recording by its id.

        Raises
        ------
        InputError
            When there is none; a path that leads elsewhere is none.
        """
        parts = recording.split("/")
        path = self.folder.joinpath(*parts)
        inside = 1 <= len(parts) <= DEPTH and all(part and part[0] != "." and "\0" not in part for part in parts)
        if not inside or path.resolve() != path or not (_is_closed(path) or _has_samples(path)):
            raise InputError(f"{recording[:200]}: no recording of {self.folder} has this name; look at the list again")
        notes, problem = self._read_notes(path)
        return Recording(recording, path, path.stat().st_mtime, notes, problem, _is_closed(path))

    def in_order(self, names: Iterable[str]) -> list[Recording]:
        """Return recordings by their ids, in the order in which they were recorded: heat carries over from run to run.

        Raises
        ------
        InputError
            When there is none of such a name.
        """

        def ended(recording: Recording) -> float:
            # Notes change the folder, but not this file, which its recorder writes when it closes.
            return (recording.path / METADATA).stat().st_mtime if recording.closed else recording.modified

        return sorted(map(self.find, names), key=ended)

    def paths(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return where recordings are, in the order of `in_order`."""
        return tuple(str(recording.path) for recording in self.in_order(names))

    def new_folder(self, name: str) -> Path:
        """Return the path for a new recording of a run, named after it and the time."""
        path = self.folder / f"{new_name(name)}-{datetime.now():%Y%m%d-%H%M%S}"
        number = 2
        while path.exists():
            path, number = path.with_name(f"{path.name}-{number}"), number + 1
        return path

    def write_notes(self, recording: str, notes: Notes) -> None:
        """Keep notes with a recording, in place of those that it has.

        Raises
        ------
        InputError
            For a note that is too long, and where the present notes cannot be read: they would be lost.
        """
        found = self.find(recording)
        if found.problem:
            raise InputError(f"{found.problem}; {NOTES_REMEDY}")
        modified = found.path.stat()
        if len(notes.text) > LONGEST_NOTE:
            raise InputError(f"note: has {len(notes.text)} characters, expected at most {LONGEST_NOTE}")
        file = found.path / NOTES_FILE
        part = file.with_name(f".{NOTES_FILE}.part")
        part.write_text(yaml.safe_dump(to_mapping(notes), sort_keys=False, allow_unicode=True), encoding="utf-8")
        part.replace(file)
        # The order of the list is that of the recordings, not of their notes.
        os.utime(found.path, ns=(modified.st_atime_ns, modified.st_mtime_ns))
        self._all.expire()

    def expire(self) -> None:
        """Let the next search look at the folder again: something has been added."""
        self._all.expire()

    def recover(self, recording: str) -> str:
        """Make a readable recording of one whose recorder was killed, beside it; return what came of it in one line."""
        found = self.find(recording)
        recovery = recover_bag(found.path, recovered_path(found.path))
        self._all.expire()
        lost = "; ".join(recovery.losses) or "nothing"
        return f"{recovery.path.name}: recovered {sum(recovery.counts.values())} messages; lost: {lost}"

    def delete(self, recording: str) -> None:
        """Delete a recording for ever."""
        shutil.rmtree(self.find(recording).path)
        self._all.expire()


def make_notes(mapping: Mapping[str, Any]) -> Notes:
    """Return the notes of a form: texts ``damper``, ``tags`` (words with commas), ``text``, number ``temperature_degC``.

    Raises
    ------
    InputError
        For a temperature out of range.
    """
    tags = [word.strip() for word in str(mapping.get("tags") or "").split(",") if word.strip()]
    content: dict[str, Any] = {
        "damper": str(mapping.get("damper") or "").strip(),
        "text": str(mapping.get("text") or ""),
        "temperature_degC": mapping.get("temperature_degC"),
    }
    if tags:
        content["tags"] = tags
    return from_mapping(Notes, {key: value for key, value in content.items() if value is not None}, "notes")


def notes_form(notes: Notes) -> dict[str, Any]:
    """Return the texts of the form for notes; `make_notes` reads them back."""
    return {**dataclasses.asdict(notes), "tags": ", ".join(notes.tags), "temperature_degC": notes.temperature}


def _is_closed(path: Path) -> bool:
    return (path / METADATA).is_file()


def _has_samples(path: Path) -> bool:
    """Return whether a folder without metadata.yaml holds what a recorder was writing."""
    try:
        return any(entry.name.endswith(SUFFIXES) for entry in os.scandir(path))
    except OSError:
        return False
