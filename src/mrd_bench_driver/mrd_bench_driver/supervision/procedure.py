"""The procedure of an experiment: arm, record, run, stop, close the bag; and of a set of experiments."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mrd_bench_driver.supervision.errors import CancelledError, RefusedError, TrippedError
from mrd_bench_driver.supervision.modes import Mode
from mrd_bench_driver.supervision.operations import BagSummary, BenchOperations
from mrd_bench_driver.supervision.run_requests import RunRequest

# Receives the phase, the time in s since the start of the experiment, and its duration in s.
Progress = Callable[[str, float, float], None]


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run."""

    success: bool
    cancelled: bool
    message: str
    recorded: BagSummary = BagSummary()


@dataclass(frozen=True)
class SetOutcome:
    """Outcome of a set of runs, and of each run of it that was started."""

    success: bool
    cancelled: bool
    message: str
    runs: tuple[tuple[RunRequest, RunOutcome], ...] = ()


class _Experiment:
    """The state of `run_experiment`: what must be undone, and what was recorded."""

    def __init__(self, bench: BenchOperations, request: RunRequest, progress: Progress) -> None:
        self._bench, self._request, self._progress = bench, request, progress
        self._undo: list[Callable[[], None]] = []  # in the order in which the steps are undone
        self._duration = self._elapsed = 0.0
        self._recording = False
        self.recorded = BagSummary()
        self.ended = ""  # why the experiment ended before its last pass

    def run(self) -> None:
        bench = self._bench
        self._progress("arming", 0.0, 0.0)
        bench.require_ready()
        plan = bench.load(self._request.experiment)
        self._duration = plan.duration
        bench.set_sample_rate(plan.rate)
        bench.require_punctual_machine()
        bench.enter(Mode.HOMING, bench.source.action)
        self._undo.append(bench.halt)
        bench.require_prepared()  # nobody can load another experiment any more
        bench.require_start_temperature()
        bench.centre(require=bench.require_prepared)
        # From here on, nobody else homes, records or tares. Nothing moves without the setpoints, which come last.
        bench.enter(bench.source.mode, bench.source.action, bench.source.node)
        bench.tare()
        bench.enable()
        self._progress("recording", 0.0, self._duration)
        self._undo.append(self._close_bag)
        bench.start_recording(self._request)
        self._recording = True
        self._progress("running", 0.0, self._duration)
        # The rod is stopped first: a generator that hangs must not delay this.
        self._undo.insert(1, bench.abort_experiment)
        bench.start_experiment()
        self.ended = bench.follow_experiment(self._duration, self._follow)
        self._elapsed = self._duration
        self._undo.remove(bench.abort_experiment)  # the generator has ended by itself
        self._progress("stopping", self._duration, self._duration)
        bench.await_last_samples()

    def undo(self) -> list[str]:
        """Undo what was begun; return the failures. A step that fails does not prevent the next ones."""
        failures: list[str] = []
        for step in self._undo:
            try:
                step()
            except RefusedError as error:
                failures.append(str(error))
        return failures + ([self.recorded.problem] if self.recorded.problem else [])

    def _follow(self, elapsed: float) -> None:
        self._elapsed = elapsed
        self._progress("running", elapsed, self._duration)

    def _close_bag(self) -> None:
        self._progress("closing", self._elapsed, self._duration)
        try:
            recorded = self._bench.stop_recording()
        except RefusedError:
            # A recorder that refused to start may refuse to stop. One that responded too late to the start must be stopped.
            if self._recording:
                raise
            return
        if self._recording or recorded.bag:
            self.recorded = recorded


def run_experiment(bench: BenchOperations, request: RunRequest, progress: Progress) -> RunOutcome:
    """Run one experiment. However it ends, first the rod, then the setpoints, then the recorder are stopped."""
    experiment = _Experiment(bench, request, progress)
    problem, cancelled = "", False
    try:
        experiment.run()
    except CancelledError as error:
        problem, cancelled = str(error), True
    except (RefusedError, TrippedError) as error:
        problem = str(error)
    finally:
        failures = experiment.undo()
    recorded = experiment.recorded
    # A recording that fails during the experiment is also the problem of its bag.
    problems = list(dict.fromkeys(([problem] if problem else []) + failures))
    ended = f"; ended early, {experiment.ended}" if experiment.ended else ""
    message = "; ".join(problems) or f"{recorded.samples} samples in {recorded.duration:.1f} s, none lost{ended}"
    return RunOutcome(not problems, cancelled, message, recorded)


def run_set(
    requests: Sequence[RunRequest], check: Callable[[RunRequest], None], run: Callable[[RunRequest], RunOutcome]
) -> SetOutcome:
    """Run experiments one after the other until one fails; the bags recorded before it are kept.

    Parameters
    ----------
    check : callable
        Raises `RefusedError` for an experiment that cannot be run. All are checked before the first one runs.
    run : callable
        Runs one experiment, as `run_experiment` does.
    """
    runs: list[tuple[RunRequest, RunOutcome]] = []

    def failed(request: RunRequest, cancelled: bool, problem: str) -> SetOutcome:
        complete = ", ".join(request.name for request, outcome in runs if outcome.success) or "none"
        message = f"{request.name}: {problem} (completely recorded of {len(requests)}: {complete})"
        return SetOutcome(False, cancelled, message, tuple(runs))

    for request in requests:
        try:
            check(request)
        except (CancelledError, RefusedError, TrippedError) as error:
            return failed(request, isinstance(error, CancelledError), str(error))
    for request in requests:
        outcome = run(request)
        runs.append((request, outcome))
        if not outcome.success:
            return failed(request, outcome.cancelled, outcome.message)
    return SetOutcome(True, False, f"{len(runs)} runs recorded, none of their samples lost", tuple(runs))
