"""`read_run` and `read_runs`: runs from files of any format."""

import glob
import hashlib
import itertools
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.formats import file_format, is_own
from mrd_runs.run import Run
from mrd_runs.validation import make_run

Array = NDArray[np.float64]

RUN_HELP = (
    "bag, .mcap, .db3 or CSV file; a folder or a quoted pattern of these; or a file of another program that needs no option "
    "of `import`"
)
"""Help of an argument that `read_runs` reads."""

MOST_FOLDERS = 20
"""Folders that a description of runs lists."""

SHORTER = 0.5
"""Seconds by which a whole recording may be shorter than its experiment: it consists of whole blocks of samples."""


def read_run(path: str | Path) -> Run:
    """Read a recording.

    Parameters
    ----------
    path : path
        A file or folder of one of the formats `mrd_runs.formats.FORMATS`: a bag folder, an ``.mcap`` or ``.db3`` file, or a
        CSV file with the header ``time_s,position_m,current_A,force_N`` and optionally ``acceleration_mps2``,
        ``velocity_mps``, ``temperature_C``.

    Returns
    -------
    Run
        Its ``info`` holds ``source``, ``format``, ``checksum`` (of the samples, whatever the format), ``notes``, ``lost``
        (number of samples missing by their sequence numbers), ``recovered`` (whether the bag had not been closed), and
        ``clocks`` where the channels are not known to have one clock (see `Run.clocks_agree`). For a bag it also holds what
        the bag says of itself: ``experiment``, ``experiment_name``, ``calibration``, ``versions``, ``seed``, ``started``,
        ``jitter_s``.

    Raises
    ------
    InputError
        With one line, when the recording is unusable.
    """
    path = Path(path)
    recording = file_format(path).read(path)
    info = {**recording.info, "source": str(path), "checksum": checksum(recording.columns)}
    name = path.resolve().name if path.is_dir() else path.stem
    return make_run(name, recording.columns, info, where=str(path), place=recording.place)


def read_runs(paths: str | Path | Iterable[str | Path], skip: float = 0.0, *, rig: str | Path | None = None) -> list[Run]:
    """Read recordings and give each a unique name: those that share one are told apart by their folders.

    Parameters
    ----------
    paths : path, or iterable of paths
        Recordings as of `read_run`, and files of other programs that need no option of the importer
        (`mrd_runs.importing.read_passes`). A folder stands for what is in it, a pattern such as ``data/*.csv`` for what fits
        it.
    skip : float
        s that are left out at the start of every run.
    rig : path, optional
        What files of other programs do not tell (`mrd_runs.importing.rig.read_rig`).

    Raises
    ------
    InputError
        As `read_run`; also when two paths hold the same recording, or when nothing is left of one.
    """
    return read_groups([paths], skip, rig=rig)[0]


def read_groups(
    groups: Sequence[str | Path | Iterable[str | Path]], skip: float = 0.0, *, rig: str | Path | None = None
) -> list[list[Run]]:
    """Read several groups of recordings, such as those to fit and those that are held out; the names are unique among all.

    Parameters and errors are those of `read_runs`.
    """
    read = [[(path, run.without_start(skip)) for path, run in _read_each(group, rig)] for group in groups]
    runs: list[Run] = []
    for path, run in itertools.chain.from_iterable(read):
        for earlier in runs:
            if earlier.info["checksum"] == run.info["checksum"]:
                raise InputError(
                    f"{path}: is the same recording as {earlier.info['source']}; give each recording once (simulated runs "
                    "of one motion differ where they were simulated with --noise)"
                )
        runs.append(run)
    shared = {name for name, count in Counter(run.name for run in runs).items() if count > 1}
    used = {run.name for run in runs}
    for place, run in enumerate(runs):
        if run.name in shared:
            name = unique_name(run.name, run.info["source"], used)
            used.add(name)
            runs[place] = replace(run, name=name)
    named = iter(runs)
    return [list(itertools.islice(named, len(group))) for group in read]


def _read_each(paths: str | Path | Iterable[str | Path], rig: str | Path | None) -> Iterator[tuple[Path, Run]]:
    """Yield each recording that paths mean, with its file."""
    if isinstance(paths, Run):
        raise InputError(f"paths is the run {paths.name}, expected paths of recordings; it has been read already")
    named = [paths] if isinstance(paths, str | Path) else list(paths)
    for entry in named:
        if not isinstance(entry, str | Path):
            raise InputError(f"paths holds {type(entry).__name__}, expected paths of recordings")
    if all(is_own(Path(entry)) or not _means_others(Path(entry)) for entry in named):
        yield from ((Path(entry), read_run(entry)) for entry in named)
        return
    # The importer knows many libraries, and most recordings need none of them.
    from mrd_runs.importing import Mapped, find_files, read_passes
    from mrd_runs.importing.rig import read_rig

    mapped = Mapped() if rig is None else read_rig(rig)
    for path in find_files([Path(entry) for entry in named])[0]:
        if is_own(path):
            yield path, read_run(path)
            continue
        passes = read_passes(path, mapped)
        for number, recording in enumerate(passes, 1):
            name = path.stem if len(passes) == 1 else f"{path.stem}-{number}"
            info = {**recording.info, "source": str(path), "checksum": checksum(recording.columns)}
            yield path, make_run(name, recording.columns, info, where=str(path), place=recording.place)


def _means_others(path: Path) -> bool:
    """Whether a path is a pattern, a folder of recordings or a file of another program."""
    return glob.has_magic(str(path)) if not path.exists() else path.is_dir() or path.is_file()


def require_whole(run: Run, bag: Path, duration: float) -> None:
    """Raise `InputError` where the run of a bag holds less than its experiment, which takes ``duration`` s."""
    if run.duration < duration - SHORTER:
        raise InputError(
            f"{bag}: holds {run.duration:.1f} s, expected the {duration:.1f} s of its experiment; move it away, then resume"
        )


def describe_runs(runs: Sequence[Run]) -> str:
    """Return how many runs there are, of which folders, and how long they are.

    A pattern such as ``runs/*/bag`` easily names more than one set: its folders are then listed with their runs.
    """
    folders = Counter(str(Path(run.info["source"]).parent) for run in runs)
    if len(folders) == 1:
        where = f"in {next(iter(folders))}"
    else:
        listed = [f"{folder} ({count})" if count > 1 else folder for folder, count in folders.items()]
        more = f" and {len(listed) - MOST_FOLDERS} more" if len(listed) > MOST_FOLDERS else ""
        where = f"of {len(folders)} folders: {', '.join(listed[:MOST_FOLDERS])}{more}"
    total, samples = sum(run.duration for run in runs), sum(map(len, runs))
    return f"{len(runs)} run{'s' if len(runs) > 1 else ''} {where}; {total:.0f} s, {samples} samples"


def run_arguments(runs: Sequence[Run], *more: str) -> str:
    """Return runs as arguments of a tool, with ``more`` of them and with what was skipped; ``RUN...`` where they were not
    read from files.
    """
    # The passes of one file are runs of the same source.
    sources = list(dict.fromkeys(str(run.info.get("source", "")) for run in runs))
    skipped = max((float(run.info.get("skipped_s", 0.0)) for run in runs), default=0.0)
    skip = f" --skip {skipped:g}" if skipped else ""
    named = shlex.join(sources) if all(sources) and "live samples" not in sources else "RUN..."
    return " ".join([named, *more]) + skip


def unique_name(name: str, path: str | Path, used: set[str]) -> str:
    """Return the name of a run, with that of its folder and a number where needed."""
    longer = f"{Path(path).resolve().parent.name}/{name}"
    candidates = itertools.chain([name, longer], (f"{longer}-{number}" for number in itertools.count(2)))
    return next(candidate for candidate in candidates if candidate not in used)


def checksum(columns: Mapping[str, Array]) -> str:
    """Return a checksum of the samples, the same for a CSV file and for the bag made of it."""
    digest = hashlib.sha256()
    for name in ("time_s", "position_m", "current_A", "force_N"):
        values = np.ascontiguousarray(columns[name], np.float64)
        # Time counts from the first sample, as in a Run.
        with np.errstate(all="ignore"):  # a stranger's times may be anything
            digest.update((values - values[:1] if name == "time_s" else values).tobytes())
    return digest.hexdigest()
