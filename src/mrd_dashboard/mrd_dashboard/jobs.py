"""What takes the page long, such as fits and diagnoses: each job in a process of its own, by the functions of the tools."""

import multiprocessing
import os
import pickle
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from mrd_base import InputError

Kind = Literal["identify", "diagnose", "validate", "trend", "review"]
State = Literal["running", "done", "failed", "cancelled"]

REPORTS: Mapping[Kind, str] = {
    "identify": "fit.html",
    "diagnose": "gap_report.html",
    "validate": "validation.html",
    "trend": "trend.html",
    "review": "hybrid_test.html",
}
"""Report of each kind of job, in its folder."""


FIT_ANYWAY = "fit faulty recordings, too"
"""The choice ``anyway`` as the page names it."""
_FIT_ANYWAY_REMEDY = f"tick {FIT_ANYWAY!r}, to fit them as they are"
LOOK_PERIOD = 2.0
"""Wall time in s between two looks for identified dampers."""


@dataclass(frozen=True)
class JobRequest:
    """What a job is to compute.

    Attributes
    ----------
    kind : {"identify", "diagnose", "validate", "trend", "review"}
        ``review`` compares the recording of a hybrid test with its offline twin.
    runs, held_out, reference : tuple of str
        Paths of recordings: fitted (of a validation: predicted), held out, and of before something changed (diagnose only).
    model : str
        Id of a damper model; for a fit and a diagnosis also ``auto``, the one that predicts the runs best.
    parameters : str
        fit.json of the simulator as it is (diagnose), or that and a gap_report.json of what is validated, or "".
    method : mapping
        Options of `mrd_identification.method.Method` (identify only).
    anyway : bool
        Fit recordings although the data check finds a fault (identify only).
    seed : int
    bench : str
        bench.yaml whose limits an advised experiment must not exceed, or "".
    follow : str
        Parameter, or ``EFFECT.PARAMETER``, that a trend follows.
    limit : float or None
        Value in SI units; a trend predicts when the parameter reaches it.
    """

    kind: Kind
    runs: tuple[str, ...]
    model: str
    held_out: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()
    parameters: str = ""
    method: Mapping[str, Any] = field(default_factory=dict)
    anyway: bool = False
    seed: int = 0
    bench: str = ""
    follow: str = ""
    limit: float | None = None


@dataclass
class Job:
    """A job and how far it is.

    Attributes
    ----------
    number : int
    request : JobRequest
    folder : Path
        Where its files are written.
    state : {"running", "done", "failed", "cancelled"}
    stage : str
        What it does at present.
    share : float
        Finished share, 0 to 1.
    history : list of (float, float)
        Share and error (NRMSE) of the best candidate, while a model is fitted.
    front : list of (float, float)
        Both error norms, e2 and einf in N, of the best candidates of the latest generation: the Pareto front.
    message : str
        Its result in a sentence, or why it failed.
    command : str
        Command that a diagnosis advises next, or "".
    """

    number: int
    request: JobRequest
    folder: Path
    state: State = "running"
    stage: str = "starting"
    share: float = 0.0
    history: list[tuple[float, float]] = field(default_factory=list)
    front: list[tuple[float, float]] = field(default_factory=list)
    message: str = ""
    command: str = ""
    began: float = field(default_factory=time.monotonic)

    @property
    def report(self) -> Path:
        """Its report, once it is done."""
        return self.folder / REPORTS[self.request.kind]

    @property
    def advised(self) -> Path:
        """The experiment that a diagnosis advises; there is no such file where it advises none."""
        return self.folder / "next_experiment.yaml"


class Jobs:
    """Starts jobs, one at a time, and hears of their progress.

    Parameters
    ----------
    folder : Path
        Each job writes into a new folder therein.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.all: list[Job] = [Job(number, *found) for number, found in enumerate(_earlier(folder), 1)]
        self._looking, self._next_look = threading.Lock(), -float("inf")
        self._fits = self._find_fits()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._connection: Connection | None = None

    @property
    def running(self) -> Job | None:
        """The job that is under way."""
        return next((job for job in self.all if job.state == "running"), None)

    def fits(self) -> list[Path]:
        """Return the files of the identified dampers, the latest first, as `look_for_fits` found them."""
        return self._fits

    def look_for_fits(self) -> None:
        """Look for identified dampers, at most once in `LOOK_PERIOD` for all pages. Call it in a thread: it reads files."""
        with self._looking:
            if time.monotonic() >= self._next_look:
                self._fits = self._find_fits()
                self._next_look = time.monotonic() + LOOK_PERIOD

    def _find_fits(self) -> list[Path]:
        return sorted(self.folder.glob("*/fit.json"), key=lambda path: path.stat().st_mtime, reverse=True)

    def start(self, request: JobRequest) -> Job:
        """Start a job.

        Raises
        ------
        InputError
            While another one runs, or without runs.
        """
        if self.running is not None:
            raise InputError(f"job {self.running.number} ({self.running.request.kind}) runs; wait for its end or cancel it")
        if not request.runs:
            raise InputError(f"{request.kind}: no runs are chosen; choose some in the list of recordings")
        folder = self.folder / f"{request.kind}-{time.strftime('%Y%m%d-%H%M%S')}"
        number = 2
        while folder.exists():
            folder, number = folder.with_name(f"{folder.name}-{number}"), number + 1
        folder.mkdir(parents=True)
        # A fresh interpreter: a fork of the page would share its sockets and threads.
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe(duplex=False)
        self._process = context.Process(target=work, args=(request, str(folder), other), daemon=True, name=request.kind)
        self._process.start()
        other.close()
        self.all.append(Job(len(self.all) + 1, request, folder))
        return self.all[-1]

    def poll(self) -> Job | None:
        """Hear what the running job has sent; called now and then. Return the job if it has ended."""
        job = self.running
        if job is None or self._connection is None:
            return None
        try:
            while job.state == "running" and self._connection.poll():
                _note(job, self._connection.recv())
        except (EOFError, OSError, pickle.UnpicklingError):
            job.state, job.message = "failed", "its process has ended without a result; there may be too little memory"
        if job.state == "running":
            return None
        self._end()
        return job

    def cancel(self) -> None:
        """End the running job, without waiting until its process has died."""
        if (job := self.running) is not None:
            job.state, job.message = "cancelled", "cancelled"
            self._end()

    def _end(self) -> None:
        if self._process is not None:
            # The process has inherited that a node blocks SIGTERM. What it has not finished, nobody reads.
            self._process.kill()
            threading.Thread(target=self._process.join, name="job", daemon=True).start()
        if self._connection is not None:
            self._connection.close()
        self._process = self._connection = None


def _earlier(folder: Path) -> list[tuple[JobRequest, Path, State]]:
    """Return what earlier pages have computed in a folder, in its order."""
    found: list[tuple[JobRequest, Path, State]] = []
    for kind, report in REPORTS.items():
        for path in folder.glob(f"{kind}-*/{report}"):
            found.append((JobRequest(kind, (), "before this start of the page"), path.parent, "done"))
    return sorted(found, key=lambda entry: entry[1].stat().st_mtime)


def _note(job: Job, message: Mapping[str, Any]) -> None:
    """Put a message of the process into its job."""
    job.stage, job.share = message.get("stage", job.stage), message.get("share", job.share)
    error = message.get("nrmse")
    if error is not None and error == error:
        job.history.append((job.share, error))
    job.front = message.get("front", job.front)
    if "state" in message:
        job.state, job.message, job.command = message["state"], message["message"], message.get("command", "")


def work(request: JobRequest, folder: str, connection: Connection) -> None:
    """Do a job and send its progress and its end; the body of its process."""
    os.nice(10)  # bench and page come first
    try:
        works = {"identify": _identify, "diagnose": _diagnose, "validate": _validate, "trend": _trend, "review": _review}
        done = works[request.kind](request, Path(folder), connection)
        connection.send({"state": "done", "share": 1.0, "stage": "", **done})
    except InputError as error:
        connection.send({"state": "failed", "message": str(error)})
    except Exception as error:  # the page must say that the process has failed
        connection.send({"state": "failed", "message": f"{type(error).__name__}: {error}; please report this"})


def _identify(request: JobRequest, folder: Path, connection: Connection) -> dict[str, str]:
    from mrd_diagnosis.diagnose import BEST_MODEL, choose_model
    from mrd_identification.cli.options import look_at_runs
    from mrd_identification.fit_file import write_fit
    from mrd_identification.identify import identify
    from mrd_identification.method import parse_method
    from mrd_identification.report import write_report
    from mrd_runs.read import read_groups
    from mrd_sim.models import find_model

    method = parse_method(**{**request.method, "seed": request.seed})
    fitted, held_out = read_groups([request.runs, request.held_out])
    runs = [*fitted, *held_out]
    if request.model == BEST_MODEL:
        look_at_runs(runs, request.anyway, remedy=_FIT_ANYWAY_REMEDY)
        connection.send({"stage": "choosing the damper model", "share": 0.0})
        chosen = choose_model(fitted, method.seed)
        name, method = chosen.id, replace(method, laws=chosen.laws)
    else:
        name = request.model
        look_at_runs(runs, request.anyway, find_model(name, method.laws, method.given_effects), remedy=_FIT_ANYWAY_REMEDY)
    total = method.total_generations

    front: list[tuple[float, float]] = []

    def watch(norms: Any) -> None:
        front[:] = [(float(e2), float(einf)) for e2, einf in norms]

    def progress(generation: int, nrmse: float) -> None:
        stage = "assessing" if generation == total else f"generation {generation} of {total}"
        connection.send({"stage": stage, "share": generation / total, "nrmse": nrmse, "front": front})

    fit = identify(fitted, name, held_out=held_out, method=method, progress=progress, watch=watch)
    write_fit(fit, folder)
    write_report(fit, folder)
    return {"message": fit.sentence}


def _diagnose(request: JobRequest, folder: Path, connection: Connection) -> dict[str, str]:
    from mrd_diagnosis.diagnose import diagnose
    from mrd_diagnosis.report.page import write_gap_report
    from mrd_diagnosis.report.sentences import next_command
    from mrd_identification.fit_file import read_fit
    from mrd_runs.read import read_groups
    from mrd_trajectory.settings import read_settings

    runs, held_out, reference = read_groups([request.runs, request.held_out, request.reference])

    def progress(stage: str, share: float) -> None:
        connection.send({"stage": stage, "share": share})

    diagnosis = diagnose(
        runs,
        request.model,
        held_out=held_out,
        reference=reference,
        parameters=read_fit(request.parameters) if request.parameters else None,
        bench=read_settings(request.bench or None),
        seed=request.seed,
        progress=progress,
    )
    write_gap_report(diagnosis, folder)
    return {"message": diagnosis.sentence, "command": next_command(diagnosis, str(folder))}


def _validate(request: JobRequest, folder: Path, connection: Connection) -> dict[str, str]:
    from mrd_diagnosis.report.validation_page import validation_sentence, write_validation
    from mrd_diagnosis.validation.validate import validate
    from mrd_identification.export import load_damper
    from mrd_identification.fit_file import fitted_sources
    from mrd_runs import read_runs

    connection.send({"stage": "predicting", "share": 0.1})
    damper, runs = load_damper(request.parameters), read_runs(request.runs)
    try:
        fitted = read_runs(fitted_sources(request.parameters))
    except InputError:
        fitted = []  # they were deleted
    validation = validate(damper, runs, fitted=fitted, seed=request.seed)
    write_validation(validation, folder)
    return {"message": validation_sentence(validation)}


def _trend(request: JobRequest, folder: Path, connection: Connection) -> dict[str, str]:
    from mrd_diagnosis.trend.trend import trend
    from mrd_diagnosis.trend.trend_file import write_trend
    from mrd_identification.fit_file import read_fit
    from mrd_runs import read_runs

    fit = read_fit(request.parameters) if request.parameters else None

    def progress(stage: str, share: float) -> None:
        connection.send({"stage": stage, "share": share})

    found = trend(
        read_runs(request.runs),
        fit.model if fit else request.model,
        request.follow,
        effects=fit.effects if fit else (),
        laws=fit.laws if fit else None,
        parameters=fit.values if fit else None,
        limit=request.limit,
        seed=request.seed,
        progress=progress,
    )
    write_trend(found, folder)
    return {"message": found.sentence}


def _review(request: JobRequest, folder: Path, _connection: Connection) -> dict[str, str]:
    from mrd_control.comparison import compare_with_twin, write_comparison
    from mrd_control.recording import read_hybrid_run

    comparison = compare_with_twin(read_hybrid_run(request.runs[0]))
    write_comparison(comparison, folder)
    return {"message": comparison.sentence}
