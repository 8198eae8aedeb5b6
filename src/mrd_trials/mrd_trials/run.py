"""Let the diagnosis judge every plant of a trial: frozen, one verdict a plant, failures kept."""

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from mrd_base import InputError
from mrd_diagnosis import diagnose
from mrd_diagnosis.diagnosis import Candidate, Cause, Diagnosis, Interval
from mrd_identification.cluster import run_on_cluster
from mrd_runs import Run, read_runs
from mrd_trials.make import Exhibit, read_trial
from mrd_trials.pool import every
from mrd_trials.records import Bin, Named, Submission, completed, read_records

JUDGES = ("mrd_base", "mrd_runs", "mrd_trajectory", "mrd_sim", "mrd_identification", "mrd_diagnosis")
"""Packages whose code decides what a diagnosis says."""

VERDICTS, FROZEN = "verdicts.jsonl", "diagnoser.json"


@dataclass(frozen=True)
class Diagnoser:
    """What judged, so that nobody has to take a word for it.

    Attributes
    ----------
    version : str
    code, catalogue : str
        SHA-256 of the sources of `JUDGES`, and of the effects among them.
    seed : int
        Of every diagnosis.
    """

    version: str
    code: str
    catalogue: str
    seed: int


def frozen(seed: int = 0) -> Diagnoser:
    """The diagnoser that is installed here."""
    roots = {name: Path(_origin(name)).parent for name in JUDGES}
    code, catalogue = _hash(list(roots.values())), _hash([roots["mrd_sim"] / "effects"])
    return Diagnoser(version("mrd_diagnosis"), code, catalogue, seed)


def run(
    folder: Path,
    output: Path,
    diagnoser: Diagnoser | None = None,
    *,
    workers: int = 1,
    scheduler: str = "",
    progress: Callable[[int, int], None] = lambda _n, _of: None,
) -> dict[str, Submission]:
    """Diagnose every plant of a trial that has no verdict yet.

    Parameters
    ----------
    folder : Path
        Of the trial. The answers are not in it, and nothing here knows where they are.
    output : Path
        Folder that gets `FROZEN` and, one line a plant, `VERDICTS`.
    diagnoser : Diagnoser, optional
        As `frozen` gives it.
    workers : int
        Processes.
    scheduler : str
        Address of a dask cluster to work on, in their place.
    progress : callable
        Called with the number of plants that are done, and of all.

    Raises
    ------
    InputError
        Where there is no trial, or ``output`` holds verdicts of another diagnoser or of another trial.
    """
    diagnoser = diagnoser or frozen()
    exhibits = {exhibit.plant: exhibit for exhibit in read_trial(folder).exhibits}
    freeze(diagnoser, output)
    read_verdicts(output / VERDICTS, exhibits.values())

    def work(plants: Sequence[str]) -> Iterator[Submission]:
        if not scheduler:
            yield from every(_judge_files, [(folder, exhibits[plant], diagnoser) for plant in plants], workers)
        # In portions, so that what is done is kept when the work is interrupted.
        for first in range(0, len(plants) if scheduler else 0, PORTION):
            portion = [exhibits[plant] for plant in plants[first : first + PORTION]]
            pieces = [(exhibit, tuple(read_given(folder, exhibit)), diagnoser) for exhibit in portion]
            yield from run_on_cluster(scheduler, judge, pieces)

    return completed(Submission, output / VERDICTS, list(exhibits), work, progress)


PORTION = 16
"""Plants that are handed to a cluster at once."""


def judge(exhibit: Exhibit, runs: Sequence[Run], diagnoser: Diagnoser, effects: Sequence[str] = ()) -> Submission:
    """One verdict; an error is one too."""
    began = time.monotonic()
    try:
        found = diagnose(runs, exhibit.model, effects=effects, seed=diagnoser.seed)
    except Exception as error:  # whatever it is, it counts as a failure of the diagnosis
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        elapsed = time.monotonic() - began
        return Submission(exhibit.plant, "failed", failure=text, elapsed=elapsed, commitment=exhibit.commitment)
    return submission(exhibit, found)


def submission(exhibit: Exhibit, found: Diagnosis) -> Submission:
    """What is kept of a diagnosis."""
    return Submission(
        plant=exhibit.plant,
        verdict=found.verdict,
        causes=tuple(_of_cause(cause, found) for cause in found.causes),
        candidates=tuple(_of_candidate(candidate) for candidate in found.candidates),
        untestable=tuple(entry.effect for entry in found.untestable),
        nearest=found.nearest.effects if found.nearest else (),
        floor=found.gap.noise_floor.value if found.gap else float("nan"),
        before=found.gap.before.value if found.gap else float("nan"),
        after=found.gap.after.value if found.gap else float("nan"),
        closed=_ends(found.gap.closed_fraction) if found.gap else (float("nan"),) * 3,
        where=tuple(Bin(region.axis, region.lower, region.upper, region.share.value) for region in found.where),
        advice=found.next_experiment.experiment if found.next_experiment else "",
        parameters=dict(found.corrected.parameters) if found.corrected else {},
        effects=found.corrected.effects if found.corrected else (),
        elapsed=found.elapsed,
        commitment=exhibit.commitment,
    )


def _of_cause(cause: Cause, found: Diagnosis) -> Named:
    alike = tuple(other.effect for other in found.alternatives if other.instead_of == cause.effect)
    sizes = {name: _ends(value.value) for name, value in cause.parameters.items()}
    return Named((cause.effect,), cause.probability, _ends(cause.closed_fraction), sizes, alike)


def _of_candidate(candidate: Candidate) -> Named:
    return Named(candidate.effects, candidate.probability, _ends(candidate.closed_fraction), {}, candidate.indistinguishable)


def _ends(interval: Interval) -> tuple[float, float, float]:
    return interval.value, interval.lower, interval.upper


def _judge_files(folder: Path, exhibit: Exhibit, diagnoser: Diagnoser) -> Submission:
    return judge(exhibit, read_given(folder, exhibit), diagnoser)


def read_given(folder: Path, exhibit: Exhibit) -> list[Run]:
    """Recordings of a plant that the diagnosis is given."""
    return read_runs([str(folder / file) for file in exhibit.runs])


def read_verdicts(path: Path, exhibits: Iterable[Exhibit]) -> dict[str, Submission]:
    """Verdicts of a file by plant, each checked to be on the plant that a trial has under this name.

    Raises
    ------
    InputError
        For a verdict on another one.
    """
    found = read_records(Submission, path)
    for exhibit in exhibits:
        if exhibit.plant in found and found[exhibit.plant].commitment != exhibit.commitment:
            raise InputError(
                f"{path}: the verdict on {exhibit.plant} is on a plant of another trial; name this trial's folder"
            )
    return found


def freeze(diagnoser: Diagnoser, output: Path) -> None:
    """Tie a folder to what judges; made where it does not exist.

    Raises
    ------
    InputError
        Where it holds verdicts of another diagnoser.
    """
    output.mkdir(parents=True, exist_ok=True)
    path = output / FROZEN
    kept = json.dumps(vars(diagnoser), indent=1) + "\n"
    if path.exists() and path.read_text(encoding="utf-8") != kept:
        raise InputError(
            f"{output}: holds verdicts of another diagnoser, see {path}; the code or the options changed since: "
            "name another --output, or go back to that version"
        )
    path.write_text(kept, encoding="utf-8")


def _origin(package: str) -> str:
    found = find_spec(package)
    if found is None or found.origin is None:
        raise InputError(f"package {package} is not installed; run: make build")
    return found.origin


def _hash(roots: Sequence[Path]) -> str:
    """Of all Python sources below some folders."""
    digest = hashlib.sha256()
    for root in roots:
        for file in sorted(root.rglob("*.py")):
            digest.update(str(file.relative_to(root.parent)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()
