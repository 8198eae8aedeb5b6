"""The course of one experiment: arm, record, run, stop, close; and of a set of them. What it asks of the bench is a
protocol, so that it runs against the nodes and against a fake alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mrd_bench_driver.modes import Mode


class RefusedError(Exception):
    """A part of the bench said no, or did not answer in time; one line."""


class TrippedError(Exception):
    """An interlock or an emergency stop ended it; one line."""


class CancelledError(Exception):
    """Somebody asked for the end."""


@dataclass(frozen=True)
class Order:
    """What to run and where to put the recording."""

    experiment: str
    bag: str
    seed: int

    @property
    def name(self) -> str:
        """Of the bag; in a set, that of the experiment."""
        return Path(self.bag).name


@dataclass(frozen=True)
class Planned:
    """Length in s and sample rate in Hz of a loaded experiment."""

    duration: float
    rate: float


@dataclass(frozen=True)
class Recorded:
    """What a closed bag holds."""

    bag: str = ""
    samples: int = 0
    lost: int = 0
    duration: float = 0.0
    problem: str = ""


@dataclass(frozen=True)
class Outcome:
    """How an experiment ended."""

    success: bool
    cancelled: bool
    message: str
    recorded: Recorded = Recorded()


@dataclass(frozen=True)
class SetOutcome:
    """How a set of experiments ended, and what became of each that was begun."""

    success: bool
    cancelled: bool
    message: str
    runs: tuple[tuple[Order, Outcome], ...] = ()


class Bench(Protocol):
    """The parts of the bench. Every call ends within a deadline; what cannot be done raises `RefusedError`."""

    def require(self) -> None:
        """Refuse unless every node is there, nothing else runs, and no fault is latched."""

    def load(self, experiment: str) -> Planned:
        """Plan the experiment; nothing moves."""

    def sample_at(self, rate: float) -> None:
        """Set the sample rate and wait for fresh samples and a servo that is well."""

    def enter(self, mode: Mode) -> None:
        """Change the mode; from here on the interlocks watch when the rod may move in it."""

    def centre(self) -> None:
        """Home the rod, or bring it back to mid-stroke, unless it stands there already."""

    def tare(self) -> None:
        """Take the sensors' zeros at rest, without current."""

    def enable(self) -> None:
        """Let the drive follow setpoints."""

    def start_recording(self, order: Order) -> None:
        """Open the bag."""

    def start(self) -> None:
        """Start the loaded experiment."""

    def watch(self, duration: float, report: Callable[[float], None]) -> None:
        """Wait for the end of the experiment; `TrippedError`, `CancelledError` or `RefusedError` when there is another."""

    def settle(self) -> None:
        """Wait until the last samples have passed through."""

    def abort(self) -> None:
        """Stop the setpoints; the coil follows them to 0 A."""

    def halt(self) -> None:
        """Stop the rod and let the drive go."""

    def stop_recording(self) -> Recorded:
        """Close the bag and count what is in it."""


Report = Callable[[str, float, float], None]


def run_experiment(bench: Bench, order: Order, report: Report) -> Outcome:
    """Run one experiment; however it ends, rod, setpoints and recorder have been stopped, in this order.

    Parameters
    ----------
    bench : Bench
    order : Order
    report : callable
        Takes phase, time in s since the experiment's start and its duration in s.
    """
    undo: list[Callable[[], None]] = []  # in the order in which it is to be done
    recorded, recording = Recorded(), False
    planned = Planned(0.0, 0.0)
    problem, cancelled = "", False

    def close_bag() -> None:
        nonlocal recorded
        report("closing", planned.duration, planned.duration)
        try:
            recorded = bench.stop_recording()
        except RefusedError:
            # A recorder that refused to begin may refuse to end; one that only answered too late must be stopped.
            if recording:
                raise

    try:
        report("arming", 0.0, 0.0)
        bench.require()
        planned = bench.load(order.experiment)
        bench.sample_at(planned.rate)
        bench.enter(Mode.HOMING)
        undo.append(bench.halt)
        bench.centre()
        bench.tare()
        bench.enter(Mode.IDENTIFICATION)
        bench.enable()
        report("recording", 0.0, planned.duration)
        undo.append(close_bag)
        bench.start_recording(order)
        recording = True
        report("running", 0.0, planned.duration)
        # The rod first: a generator that hangs must not keep it waiting.
        undo.insert(1, bench.abort)
        bench.start()
        bench.watch(planned.duration, lambda elapsed: report("running", elapsed, planned.duration))
        undo.remove(bench.abort)  # the generator has ended by itself
        report("stopping", planned.duration, planned.duration)
        bench.settle()
    except CancelledError:
        problem, cancelled = "cancelled", True
    except (RefusedError, TrippedError) as error:
        problem = str(error)
    finally:
        late = _undo(undo)
    late += [recorded.problem] if recorded.problem else []
    message = "; ".join(([problem] if problem else []) + late) or (
        f"{recorded.samples} samples in {recorded.duration:.1f} s, none lost"
    )
    return Outcome(not problem and not late, cancelled, message, recorded)


def run_set(orders: Sequence[Order], check: Callable[[Order], None], run: Callable[[Order], Outcome]) -> SetOutcome:
    """Run experiments one after the other, until one does not end well; what was recorded before it stays.

    Parameters
    ----------
    orders : sequence of Order
        Their bags named after the experiments.
    check : callable
        Raises `RefusedError` for an experiment that cannot be run; all are asked for before the first runs.
    run : callable
        As `run_experiment`.
    """
    runs: list[tuple[Order, Outcome]] = []

    def ended(order: Order, cancelled: bool, problem: str) -> SetOutcome:
        recorded = ", ".join(order.name for order, outcome in runs if outcome.success) or "none"
        message = f"{order.name}: {problem} (completely recorded of {len(orders)}: {recorded})"
        return SetOutcome(False, cancelled, message, tuple(runs))

    for order in orders:
        try:
            check(order)
        except CancelledError:
            return ended(order, True, "cancelled")
        except (RefusedError, TrippedError) as error:
            return ended(order, False, str(error))
    for order in orders:
        outcome = run(order)
        runs.append((order, outcome))
        if not outcome.success:
            return ended(order, outcome.cancelled, outcome.message)
    return SetOutcome(True, False, f"{len(runs)} runs recorded, none of their samples lost", tuple(runs))


def _undo(steps: list[Callable[[], None]]) -> list[str]:
    """Take back what was done; a step that fails keeps no other from being taken."""
    failures: list[str] = []
    for step in steps:
        try:
            step()
        except RefusedError as error:
            failures.append(str(error))
    return failures
