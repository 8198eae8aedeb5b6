"""The state behind the page, and the one way by which the page acts."""

import asyncio
import contextlib
import dataclasses
import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar

from mrd_base import InputError
from mrd_base.lease import Mode
from mrd_control.experiment import ControlExperiment, parse_control_experiment
from mrd_dashboard.audit import AuditLog
from mrd_dashboard.bench_diagnosis import (
    INTERRUPTED,
    WHY_FAILED,
    WHY_HELD,
    BenchDiagnosis,
    BenchDiagnosisOutcome,
    BenchDiagnosisRequest,
)
from mrd_dashboard.bench_view import BenchView
from mrd_dashboard.control_right import ControlRight, NoControlError
from mrd_dashboard.dampers import Dampers
from mrd_dashboard.experiment_form import preview_set
from mrd_dashboard.guide import Guide
from mrd_dashboard.hybrid_view import LiveMetrics, live_metrics
from mrd_dashboard.jobs import Jobs
from mrd_dashboard.live_frame import LivePrediction, compile_prediction, live_frame, try_prediction
from mrd_dashboard.look import Look, cached_look, keep_look, look_at
from mrd_dashboard.recordings import CACHE_FOLDER, Recording, Recordings
from mrd_dashboard.run_queue import Kind, QueuedRun, RunQueue
from mrd_dashboard.workers import Workers
from mrd_runs import read_runs

P = ParamSpec("P")
T = TypeVar("T")

FRAME_PERIOD = 1 / 30
"""Wall time in s between two frames of the live plots; a browser that is late at times still draws 25 a second."""

REPORTS_FOLDER = "reports"
"""Folder, among the recordings, of the reports on dampers whose tests were recorded by the queue."""

METRICS_PERIOD = 0.8
"""Wall time in s between two computations of the metrics of a hybrid test."""

# Receives the number of a round, its step, the share of the round that is done, and what the round before has added.
RoundProgress = Callable[[int, str, float, str], None]

# Receives the phase of a run and the time in s since the experiment began.
Progress = Callable[[str, float], None]

CALLS = {
    "end run": "end what runs, with braking; it needs no control",
    "home": "home the rod, and leave it at mid-stroke with the drive off",
    "tare": "set the zeros of the channels marked for it",
    "enable": "switch the drive on; the bench permits it under the lease only",
    "disable": "switch the drive off",
    "reset fault": "release the emergency stop; moves nothing",
}
"""Requests to the bench that take no argument, and what they do."""


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended: whether everything is recorded, one line, and the folder of the bag, "" without one."""

    success: bool
    message: str
    bag: str


class Commands(Protocol):
    """Requests to the bench. Each is refused by the bench as that of any other client, with an `InputError`."""

    def emergency_stop(self) -> None:
        """Ask rod and coil to stop at once; returns before they do."""

    async def call(self, name: str) -> str:
        """Make one of the requests `CALLS`; return the answer."""

    async def run(self, kind: Kind, experiment: str, bag: Path, seed: int, stops: int, progress: Progress) -> RunOutcome:
        """Record an experiment or a hybrid test, given by the text of its file; return when it has ended.

        The bench refuses it if it was stopped more often than ``stops`` says (`BenchView.stops`).
        """

    async def diagnose(self, request: BenchDiagnosisRequest, progress: RoundProgress) -> BenchDiagnosisOutcome:
        """Let the bench record and diagnose in turn; return when that has ended."""

    def cancel_diagnosis(self) -> None:
        """End the diagnosis on the bench, and what it records."""


@dataclass(frozen=True)
class Visitor:
    """Somebody who looks at the page: the session of the browser, and how page and audit log name it."""

    session: str
    name: str


@dataclass(frozen=True)
class Answer:
    """What came of an action: whether it was done, one line, and what tells that a refusal is no longer true."""

    success: bool
    message: str
    outdated: Callable[[], bool] | None = None


@dataclass
class Dashboard:
    """Everything that the pages show and change.

    Attributes
    ----------
    bench : BenchView
    commands : Commands
    recordings : Recordings
    queue : RunQueue
    jobs : Jobs
        Fits and diagnoses.
    guide : Guide
        The way from recordings to the cause of a gap that the operators are on.
    control : ControlRight
    audit : AuditLog
    experiments : Path
        Folder of the experiments to choose from.
    workers : Workers or None
        Processes that compute what takes long; without them, threads do.
    prediction : LivePrediction or None
        Model that is drawn over the measured force.
    hybrid_test : Path
        File of the shipped hybrid test, from which the form of the control page starts.
    bench_file, plant : str
        Parameter files of the bench and of its simulated plant, or "".
    bench_diagnosis : BenchDiagnosis
        The latest diagnosis that records what it needs.
    looks : dict of str to Look
        Looks at recordings, by id.
    dampers : Dampers
        The dampers whose tests are among the recordings.
    tasks : set of asyncio.Task
        What goes on beside the queue: looks at what it has recorded.
    """

    bench: BenchView
    commands: Commands
    recordings: Recordings
    queue: RunQueue
    jobs: Jobs
    control: ControlRight
    audit: AuditLog
    experiments: Path
    hybrid_test: Path
    workers: Workers | None = None
    prediction: LivePrediction | None = None
    bench_file: str = ""
    plant: str = ""
    guide: Guide = field(default_factory=Guide)
    bench_diagnosis: BenchDiagnosis = field(default_factory=BenchDiagnosis)
    looks: dict[str, Look] = field(default_factory=dict)
    dampers: Dampers = field(init=False)
    tasks: set[asyncio.Task[None]] = field(default_factory=set)
    _frame: tuple[float, dict[str, list[float]]] = (float("-inf"), {})
    _metrics: tuple[float, LiveMetrics] = (float("-inf"), LiveMetrics())
    _hybrid_test: tuple[int, ControlExperiment | None] = (0, None)

    def __post_init__(self) -> None:
        self.dampers = Dampers(self.recordings.folder)
        if self.bench_diagnosis.running:
            self._end_diagnosis(BenchDiagnosisOutcome(False, INTERRUPTED))

    async def act(
        self, who: Visitor, action: str, work: Callable[[], Awaitable[str]], detail: str = "", *, watching: bool = False
    ) -> Answer:
        """Do what somebody asks for, if they hold control; write it into the audit log.

        Parameters
        ----------
        who : Visitor
        action, detail : str
            What is asked for, as the log names it.
        work : callable
            Does it and returns one line; raises `InputError` where that is refused.
        watching : bool
            Whether it needs no control.
        """
        try:
            if not watching:
                self.control.require(who.session)
            answer = Answer(True, await work())
        except NoControlError as error:
            answer = Answer(False, str(error), lambda: self.control.holds(who.session))
        except InputError as error:
            answer = Answer(False, str(error))
        except OSError as error:
            answer = Answer(False, f"{error.filename or action}: {error.strerror or error}")
        except Exception as error:  # nobody waits for an answer that does not come
            answer = Answer(False, f"{action}: {type(error).__name__}: {error}; please report this")
        self.audit.write(who.name, action, detail, answer.message if answer.success else f"refused: {answer.message}")
        return answer

    async def compute(self, work: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Return the result of a function that takes longer than a stop may wait."""
        if self.workers is None:
            return await asyncio.to_thread(work, *arguments, **options)
        return await self.workers.run(work, *arguments, **options)

    def hear_jobs(self) -> None:
        """Hear what the running job has sent, and log its end; called now and then."""
        if (job := self.jobs.poll()) is not None:
            self.audit.write("page", job.request.kind, str(job.folder), f"{job.state}: {job.message}")
        self.guide.hear(self.jobs.all)

    @property
    def problem(self) -> str:
        """Why queue, guide, the diagnosis on the bench or audit log cannot be kept, or ""."""
        return self.queue.problem or self.guide.problem or self.bench_diagnosis.problem or self.audit.problem

    async def queue_set(self, name: str, files: Sequence[Path], damper: str = "") -> str:
        """Append all experiments of a set to the queue, or none; return one line.

        Raises
        ------
        InputError
            For the first file that the bench would refuse, and when somebody has stopped the bench meanwhile.
        """
        stops = self.queue.stops
        # As `bench` does, all are checked before the first one waits.
        found = await self.compute(preview_set, files, self.bench.generator)
        self.queue.require_no_stop_since(stops)
        batch = self.queue.new_batch(Path(name).name)
        has_tests = any(one.tests_damper for one in found)
        for one in found:
            # Of a set without damper tests, all runs show a damper that is named.
            judged = one.tests_damper if has_tests else bool(damper)
            self.queue.add(one.experiment.name, one.text, one.duration, damper=damper, batch=batch, tests_damper=judged)
        return f"{name}: {len(found)} {'run waits' if len(found) == 1 else 'runs wait'} in the queue"

    def diagnose_on_bench(self, model: str, budget: float) -> str:
        """Let the bench record and diagnose in turn, while the queue waits; return one line.

        Raises
        ------
        InputError
            While a run of the queue, or another such diagnosis, is under way.
        """
        folder = self.recordings.folder / f"diagnosis-{time.strftime('%Y%m%d-%H%M%S')}"
        return self._begin_diagnosis(BenchDiagnosisRequest(model, budget, folder, self.bench_file))

    def go_on_diagnosing(self, recordings: Sequence[str]) -> str:
        """Go on with the latest diagnosis on the bench, with the recordings of a measurement by hand; return one line.

        Raises
        ------
        InputError
            Where there is nothing to go on with, and as `diagnose_on_bench`.
        """
        latest = self.bench_diagnosis.request
        if latest is None or not (self.bench_diagnosis.can_go_on or self.bench_diagnosis.running):
            raise InputError("no diagnosis on the bench was interrupted or needs a measurement; begin a new one")
        runs = [str(self.recordings.find(name).path) for name in recordings]
        # Those of before are replaced: one that could not be used must not be in the way for ever.
        return self._begin_diagnosis(dataclasses.replace(latest, runs=tuple(runs), bench=self.bench_file))

    def _begin_diagnosis(self, request: BenchDiagnosisRequest) -> str:
        if self.bench_diagnosis.running:
            raise InputError("the bench diagnoses already; wait for the end, or cancel it")
        if self.queue.running is not None:
            raise InputError(f"run {self.queue.running.number} is under way; wait for its end")
        if self.bench.mode is Mode.FAULT:
            raise InputError("the bench is in mode fault; reset the fault first")
        self.bench_diagnosis.begin(request)
        self.queue.held = WHY_HELD
        if self.queue.why == WHY_FAILED:
            self.queue.paused = False  # it waited for this one
        _beside(self, self._diagnose(request))
        return f"the bench records and diagnoses; its files are in {request.folder}"

    async def _diagnose(self, request: BenchDiagnosisRequest) -> None:
        try:
            outcome = await self.commands.diagnose(request, self.bench_diagnosis.progress)
        except InputError as error:
            outcome = BenchDiagnosisOutcome(False, str(error))
        except Exception as error:  # else it would seem to go on for ever
            outcome = BenchDiagnosisOutcome(False, f"{type(error).__name__}: {error}; please report this")
        self._end_diagnosis(outcome)

    def _end_diagnosis(self, outcome: BenchDiagnosisOutcome) -> None:
        """Note how a diagnosis has ended. The queue goes on, unless that is a failure, or the queue is paused besides."""
        self.bench_diagnosis.end(outcome)
        self.queue.held = ""
        if not (outcome.success or self.queue.paused):
            self.queue.pause(WHY_FAILED)
        self.recordings.expire()
        self.audit.write("page", "diagnose on the bench", str(self.bench_diagnosis.folder), self.bench_diagnosis.sentence)

    async def call(self, who: Visitor, name: str) -> Answer:
        """Make one of the requests `CALLS`. Whoever sees the page may end a run."""
        if name == "end run":
            self.queue.stop()  # else the next run would begin
        return await self.act(who, name, lambda: self.commands.call(name), watching=name == "end run")

    async def change_pause(self, who: Visitor) -> Answer:
        """Let the queue wait for the operator, or go on."""

        async def work() -> str:
            if not self.queue.paused:
                self.queue.pause("by the operator")
                return "the queue waits"
            if self.queue.held:
                raise InputError(f"the queue waits {self.queue.held}; wait for the end of that, or cancel it")
            if self.bench.mode is Mode.FAULT:
                raise InputError("the bench is in mode fault, so that the next run would fail; reset the fault first")
            self.queue.paused = False
            return "the queue goes on"

        return await self.act(who, "pause or resume the queue", work)

    def emergency_stop(self, who: Visitor) -> None:
        """Ask for the emergency stop; it needs neither control nor session, and waits for nobody."""
        self.commands.emergency_stop()
        self.queue.stop()
        if who.session:
            self.audit.write(who.name, "emergency stop", "", "requested")
        else:
            self.audit.write_seldom(who.name, "emergency stop", "", "requested without a session")

    def frame(self) -> dict[str, list[float]]:
        """Return the table of the live plots, computed once for all who look."""
        made, table = self._frame
        if time.monotonic() - made > 0.8 * FRAME_PERIOD:
            table = live_frame(self.bench.samples, self.prediction)
            self._frame = time.monotonic(), table
        return table

    async def predict(self, fit: str) -> LivePrediction:
        """Return the prediction of a stored fit, given by the path of its file."""
        # A worker compiles the model, so that this process finds it compiled on the disk.
        await self.compute(compile_prediction, fit)
        return await asyncio.to_thread(try_prediction, fit)

    def hybrid_metrics(self) -> LiveMetrics:
        """Return the metrics of the hybrid test under way, or of the latest one, computed once for all who look.

        It takes some hundredths of a second, and is therefore called in a thread.
        """
        made, metrics = self._metrics
        if time.monotonic() - made > METRICS_PERIOD:
            metrics = live_metrics(self._running_test(), self.bench.cycles.latest())
            self._metrics = time.monotonic(), metrics
        return metrics

    def _running_test(self) -> ControlExperiment | None:
        """Return the hybrid test that the page has begun last; None where it has begun none."""
        runs = [run for run in self.queue.runs if run.kind == "control" and run.state != "waiting"]
        if not runs:
            return None
        if self._hybrid_test[0] != runs[-1].number:
            self._hybrid_test = runs[-1].number, parse_control_experiment(runs[-1].experiment, runs[-1].name)
        return self._hybrid_test[1]

    def known_look(self, recording: Recording) -> Look | None:
        """Return the look at a recording if there was one; it reads a file."""
        if recording.id not in self.looks and (look := cached_look(recording.path, self._cache(recording))):
            self.looks[recording.id] = look
        return self.looks.get(recording.id)

    async def look(self, recording: Recording) -> Look:
        """Look at a recording: the preflight, and a picture. What is found in one that is still open is not kept."""
        look = await asyncio.to_thread(self.known_look, recording)
        if look is None:
            look = await self.compute(look_at, str(recording.path))
            if not recording.closed:
                return look
            self.looks[recording.id] = look
            await asyncio.to_thread(keep_look, look, recording.path, self._cache(recording))
        return look

    def _cache(self, recording: Recording) -> Path:
        return self.recordings.folder / CACHE_FOLDER / f"{recording.id.replace('/', '~')}.json"

    def recover(self, recording: str) -> str:
        """Make a readable recording of one whose recorder was killed; return what came of it."""
        self._require_recorded(self.recordings.find(recording))
        return self.recordings.recover(recording)

    def is_recorded(self, recording: Recording) -> bool:
        """Return whether a recording is being made."""
        # The queue alone does not know: other clients record, too, and a page that was started in a run has lost it.
        running, recorded = self.queue.running, self.bench.recorded
        written = ([Path(running.bag)] if running else []) + ([recorded] if recorded else [])
        return any(bag.resolve().is_relative_to(recording.path) for bag in written)

    def _require_recorded(self, recording: Recording) -> None:
        if self.is_recorded(recording):
            raise InputError(f"{recording.id}: is being recorded; stop the run first")

    def delete(self, recording: str) -> None:
        """Delete a recording, unless it is being made."""
        found = self.recordings.find(recording)
        self._require_recorded(found)
        self.recordings.delete(recording)
        self.looks.pop(recording, None)
        self._cache(found).unlink(missing_ok=True)


async def run_next(dashboard: Dashboard) -> bool:
    """Record the run whose turn it is; return whether there was one. What it recorded is looked at beside the next run."""
    queue = dashboard.queue
    queue.hear(dashboard.bench.stops)
    run = queue.next()
    if run is None:
        return False
    outcome = await _record(dashboard, run)
    queue.end(run.number, "done" if outcome.success else "failed", outcome.message, outcome.bag)
    dashboard.audit.write("page", "run", f"{run.number} {run.name}", outcome.message)
    if outcome.bag:
        _beside(dashboard, _look_at_bag(dashboard, Path(outcome.bag), run.damper))
    if run.batch:
        _beside(dashboard, _report_on_set(dashboard, run.number, run.batch))
    return True


def _beside(dashboard: Dashboard, work: Coroutine[Any, Any, None]) -> None:
    """Do something beside the queue."""
    task = asyncio.create_task(work)
    dashboard.tasks.add(task)
    task.add_done_callback(dashboard.tasks.discard)


async def _record(dashboard: Dashboard, run: QueuedRun) -> RunOutcome:
    """Record a run; whatever goes wrong is its outcome, so that it never seems to run for ever."""
    bag = None
    try:
        bag = dashboard.recordings.new_folder(run.name)
        dashboard.queue.start(run.number, bag)
        dashboard.audit.write("page", "run", f"{run.number} {run.name}", "sent")
        return await dashboard.commands.run(
            run.kind,
            run.experiment,
            bag,
            run.seed,
            dashboard.queue.heard,
            lambda phase, elapsed: dashboard.queue.progress(run.number, phase, elapsed),
        )
    except InputError as error:
        message = str(error)
    except Exception as error:
        message = f"{type(error).__name__}: {error}; look at the bench, then try again"
    return RunOutcome(False, message, str(bag) if bag is not None and bag.exists() else "")


async def _look_at_bag(dashboard: Dashboard, bag: Path, damper: str) -> None:
    # Somebody may have moved it; the list shows what is there.
    with contextlib.suppress(InputError, ValueError, OSError):
        recording = dashboard.recordings.find(bag.relative_to(dashboard.recordings.folder).as_posix())
        if damper:
            dashboard.recordings.write_notes(recording.id, dataclasses.replace(recording.notes, damper=damper))
        await dashboard.look(recording)


async def _report_on_set(dashboard: Dashboard, number: int, batch: str) -> None:
    """Write the reports on the damper of a set, as `bench` does, once the last of its runs is recorded."""
    tests = [run for run in dashboard.queue.recorded_set(batch) if run.tests_damper]
    if not tests:
        return
    folder = dashboard.recordings.folder / REPORTS_FOLDER / batch
    try:
        sentence = await dashboard.compute(write_set_reports, [run.bag for run in tests], folder, tests[0].damper or batch)
        message = f"{sentence} The reports are under Dampers."
    except (InputError, OSError) as error:
        message = f"no reports: {error}"
    dashboard.queue.note(number, message)
    dashboard.audit.write("page", "reports", str(folder), message)


def write_set_reports(bags: Sequence[str], folder: Path, serial: str) -> str:
    """Write the reports on the recordings of a damper's tests; return what they say.

    Raises
    ------
    InputError
        When the recordings show nothing of the damper.
    """
    # Plots and tables are slow to import, and only tests of dampers need them.
    from mrd_characterisation.reports import write_reports

    return write_reports(read_runs(bags), folder, serial=serial).characterisation.sentence


async def work_through_queue(dashboard: Dashboard, period: float = 0.2) -> None:
    """Record one run after the other, for ever; look every ``period`` s whether one waits."""
    while True:
        if not await run_next(dashboard):
            await asyncio.sleep(period)
