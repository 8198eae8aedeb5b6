"""The dampers that were tested: their tests, recordings, fits and diagnoses, by serial number."""

import asyncio
import dataclasses
import functools
import os
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mrd_base import InputError
from mrd_characterisation.batch import Batch, Entry, find_tests, make_batch, read_entry
from mrd_dashboard.jobs import Job
from mrd_dashboard.recordings import Recording, Scan
from mrd_identification.fit_file import fitted_sources

FILES = ("sheet.html", "sheet.pdf", "characterisation.html", "acceptance.json", "characterisation.json")
"""Files of a test that the page serves."""
DIAGNOSIS, REPORT = "diagnosis", "gap_report.html"
"""Folder within that of a test, and the report therein, that the command which finds the cause of a failure writes."""

_FITS = {"identify": "fit.json", "diagnose": "gap_report.json"}


@dataclass(frozen=True)
class Damper:
    """What is known of a damper.

    Attributes
    ----------
    serial : str
    tests : tuple of Entry
        The latest first, without their numbers.
    recordings : tuple of Recording
        Those whose notes have the serial number, and those of its tests whose notes have none; the latest first.
    """

    serial: str
    tests: tuple[Entry, ...] = ()
    recordings: tuple[Recording, ...] = ()


class Dampers:
    """The dampers whose tests are below a folder; each file is read once, and again when it has changed.

    Parameters
    ----------
    folder : Path
        Folder of the recordings.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files = Scan(lambda: _changes(folder))
        self._known: dict[Path, tuple[int, Entry | str]] = {}

    @property
    def problems(self) -> list[str]:
        """Why files of tests cannot be read, one line for each."""
        return [found for _, found in self._known.values() if isinstance(found, str)]

    async def look(self, compute: Callable[..., Awaitable[Any]]) -> None:
        """Read what is new; ``compute`` calls a function with arguments where it does not hold up the page."""
        files = await asyncio.to_thread(self._files.found)
        new = [file for file, changed in files.items() if file not in self._known or self._known[file][0] != changed]
        found = dict(zip(new, await compute(summaries, new), strict=True)) if new else {}
        self._known = {
            file: (changed, found[file]) if file in found else self._known[file] for file, changed in files.items()
        }

    def dampers(self, recordings: Iterable[Recording]) -> list[Damper]:
        """Return the dampers of the tests that `look` has found and of recordings; the one tested last comes first."""
        tests: dict[str, list[Entry]] = {}
        owners: dict[str, str] = {}
        for entry in sorted((found for _, found in self._known.values() if isinstance(found, Entry)), key=_age):
            tests.setdefault(entry.serial, []).append(entry)
            owners |= dict.fromkeys(entry.runs, entry.serial)
        owned: dict[str, list[Recording]] = {}
        for recording in recordings:
            if serial := recording.notes.damper or owners.get(str(recording.path), ""):
                owned.setdefault(serial, []).append(recording)
        serials = [*tests, *(serial for serial in owned if serial not in tests)]
        return [Damper(serial, tuple(tests.get(serial, ())), tuple(owned.get(serial, ()))) for serial in serials]

    def name(self, test: Entry) -> str:
        """Return the folder of a test within the folder of the recordings, with /."""
        return test.file.parent.relative_to(self.folder).as_posix()

    def file(self, test: str, name: str) -> Path:
        """Return a file of a test, which is given by its folder as `name` returns it.

        Raises
        ------
        InputError
            When there is none; a path that leads elsewhere is none.
        """
        path = self.folder.joinpath(*test.split("/"), name)
        if name not in (*FILES, REPORT) or "\0" in test or path.resolve() != path or not path.is_file():
            raise InputError(
                f"{test[:200]}: no test below {self.folder} has this name and {name[:40]}; look at the list again"
            )
        return path

    def files(self, test: Entry) -> dict[str, str]:
        """Return which of `FILES` a test has, and the diagnosis of its failure; for each its folder, as `file` takes it."""
        folder, place = test.file.parent, self.name(test)
        files = {name: place for name in FILES if (folder / name).is_file()}
        return files | ({REPORT: f"{place}/{DIAGNOSIS}"} if (folder / DIAGNOSIS / REPORT).is_file() else {})


def _changes(folder: Path) -> dict[Path, int]:
    """Return the files of the tests below a folder, and when they were changed, in ns."""
    changes = {}
    for file in find_tests(folder):
        try:
            changes[file] = os.stat(file).st_mtime_ns
        except OSError:
            continue  # somebody has just deleted it
    return changes


def summaries(files: Sequence[Path]) -> list[Entry | str]:
    """Return tests without their numbers, of which there are many; for one that cannot be read, the reason."""
    found: list[Entry | str] = []
    for file in files:
        try:
            entry = read_entry(file)
            runs = tuple(str(Path(run).resolve()) for run in entry.runs if run)
            found.append(dataclasses.replace(entry, numbers=(), runs=runs))
        except InputError as error:
            found.append(str(error))
    return found


def numbers_of(folder: Path, damper: Damper) -> Batch:
    """Return the tests of a damper with their numbers, and the statistics of these.

    Raises
    ------
    InputError
        When one of the files cannot be read any more.
    """
    return make_batch(folder, [read_entry(test.file) for test in damper.tests])


def analyses_of(damper: Damper, jobs: Iterable[Job]) -> list[Job]:
    """Return the fits and diagnoses of recordings of a damper, the latest first. It reads files."""
    paths = {str(recording.path) for recording in damper.recordings}
    found = [job for job in jobs if job.state == "done" and job.request.kind in _FITS]
    return [job for job in reversed(found) if not paths.isdisjoint(_fitted(job.folder / _FITS[job.request.kind]))]


@functools.lru_cache(maxsize=10_000)
def _fitted(file: Path) -> frozenset[str]:
    """Return the recordings of a fit or diagnosis, whose file does not change any more."""
    try:
        return frozenset(str(Path(source).resolve()) for source in fitted_sources(file))
    except InputError:
        return frozenset()  # its runs are no files


def _age(test: Entry) -> tuple[float, str]:
    return -test.date.timestamp() if test.date else float("inf"), str(test.file)
