"""The runs that wait, the one that runs, and those that have ended."""

import dataclasses
import itertools
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from mrd_base import InputError
from mrd_dashboard.kept_file import keep

Kind = Literal["identification", "control"]
State = Literal["waiting", "running", "done", "failed", "stopped"]

# Wall time in s between two runs, for homing, tare, and the closing of the bag, by which the time left is estimated.
_BETWEEN_RUNS = 5.0
_MOST_ENDED = 100
_OPEN = ("waiting", "running")


@dataclass(frozen=True)
class QueuedRun:
    """A run.

    Attributes
    ----------
    number : int
        Its number, unique in the queue.
    name, experiment : str
        Name of the experiment, and the text of its file.
    duration : float
        In s, with the ways from and to rest.
    seed : int
    state : {"waiting", "running", "done", "failed", "stopped"}
    phase : str
        What the bench does for it while it runs.
    elapsed : float
        Time of the experiment that has passed, in s.
    message : str
        How it ended.
    bag : str
        Folder of its recording, once it has one.
    kind : {"identification", "control"}
        Mode of the bench that it needs: ``control`` for a hybrid test.
    damper : str
        Serial number for the notes of its recording, or "".
    batch : str
        Name of the set to which it belongs, unique in the queue, or "".
    tests_damper : bool
        Whether the reports of its set are made of it.
    """

    number: int
    name: str
    experiment: str
    duration: float
    seed: int = 0
    state: State = "waiting"
    phase: str = ""
    elapsed: float = 0.0
    message: str = ""
    bag: str = ""
    kind: Kind = "identification"
    damper: str = ""
    batch: str = ""
    tests_damper: bool = False


@dataclass
class RunQueue:
    """Runs in their order. One thread changes it.

    The queue is kept in a file, so that it outlives the page. A run that was under way when the page ended is then marked as
    such, and may be tried again: the bench itself has ended it, or still does.

    Attributes
    ----------
    file : Path or None
        Where it is kept.
    runs : list of QueuedRun
    paused : bool
        Whether the next run waits for the operator: at first, and after a run that failed.
    why : str
        Since what it is paused, such as "after a stop".
    held : str
        While what the runs wait besides, such as "while the bench diagnoses", or "". Nobody can resume them then.
    problem : str
        Why the file could not be written, or "".
    stops : int
        How often somebody has stopped the bench, as far as the queue has heard.
    heard : int
        How often the bench has counted a stop, from 1; 0 while it was not heard. A run is sent with this number, and
        the bench refuses it after a stop of which the queue has not heard yet.
    """

    file: Path | None = None
    runs: list[QueuedRun] = field(default_factory=list)
    paused: bool = False
    why: str = ""
    held: str = ""
    problem: str = ""
    stops: int = 0
    heard: int = 0

    def __post_init__(self) -> None:
        if self.file is not None and self.file.exists():
            try:
                self.runs = [QueuedRun(**entry) for entry in json.loads(self.file.read_text(encoding="utf-8"))]
            except (ValueError, TypeError):
                self.runs = []  # of another version
            self.paused = any(run.state in ("waiting", "running") for run in self.runs)
            self.why = "since the page was started again"
            for run in self.runs:
                if run.state == "running":
                    message = "the page was closed meanwhile; look at the recording, and try again if it is incomplete"
                    self._replace(run.number, state="stopped", message=message)
        self._numbers = itertools.count(1 + max((run.number for run in self.runs), default=0))

    def _replace(self, number: int, **changes: object) -> QueuedRun:
        place = next((place for place, run in enumerate(self.runs) if run.number == number), None)
        if place is None:
            raise InputError(f"run {number} is no longer in the queue; look at the list again")
        self.runs[place] = dataclasses.replace(self.runs[place], **changes)  # type: ignore[arg-type]
        return self.runs[place]

    def _keep(self, ended_set: str = "") -> None:
        # Of a set that goes on, or has ended now, all runs are needed.
        sets = {ended_set, *(run.batch for run in self.runs if run.state in _OPEN)} - {""}
        ended = [run for run in self.runs if run.state not in _OPEN and run.batch not in sets]
        dropped = {run.number for run in ended[:-_MOST_ENDED]}
        self.runs = [run for run in self.runs if run.number not in dropped]
        # A full disk must not keep a run from being seen to end.
        self.problem = keep([dataclasses.asdict(run) for run in self.runs], self.file, "the queue")

    def add(self, name: str, experiment: str, duration: float, seed: int = 0, **options: Any) -> QueuedRun:
        """Append a run; ``options``: its ``kind``, ``damper``, ``batch`` and ``tests_damper``."""
        self.runs.append(QueuedRun(next(self._numbers), name, experiment, duration, seed, **options))
        self._keep()
        return self.runs[-1]

    def new_batch(self, name: str) -> str:
        """Return a name for a set that no other one in the queue has."""
        return f"{name}-{time.strftime('%Y%m%d-%H%M%S')}-{1 + max((run.number for run in self.runs), default=0)}"

    def recorded_set(self, batch: str) -> list[QueuedRun]:
        """Return the latest run of each experiment of a set once all of them are recorded, until then none."""
        latest = {run.name: run for run in self.runs if run.batch == batch}
        return list(latest.values()) if all(run.state == "done" for run in latest.values()) else []

    def stop(self) -> None:
        """Let the runs that wait, wait for the operator: somebody stops the bench."""
        self.pause("after a stop")
        self.stops += 1

    def pause(self, why: str) -> None:
        """Let the runs that wait, wait for the operator."""
        self.paused, self.why = True, why

    def note(self, number: int, message: str) -> None:
        """Add a sentence to how a run has ended, unless it has been taken out of the list."""
        for run in self.runs:
            if run.number == number:
                self._replace(number, message="; ".join(filter(None, (run.message, message))))
                self._keep()
                return

    def hear(self, count: int) -> None:
        """Hear how often the bench has counted a stop: after one that came from elsewhere, the runs wait, too."""
        if self.heard not in (0, count):
            self.stop()
        self.heard = count

    def require_no_stop_since(self, stops: int) -> None:
        """Refuse what was asked for when there were so many stops, if there are more now: nothing moves by it any more."""
        if self.stops != stops:
            raise InputError("somebody stopped the bench meanwhile; nothing was added, ask for it again")

    def retry(self, number: int) -> QueuedRun:
        """Append a run that has ended once more."""
        run = self._replace(number)
        options = {"kind": run.kind, "damper": run.damper, "batch": run.batch, "tests_damper": run.tests_damper}
        return self.add(run.name, run.experiment, run.duration, run.seed, **options)

    def remove(self, number: int) -> None:
        """Take a run out that does not run."""
        if self._replace(number).state == "running":
            raise InputError(f"run {number} is under way; stop it first")
        self.runs = [run for run in self.runs if run.number != number]
        self._keep()

    def next(self) -> QueuedRun | None:
        """Return the run whose turn it is; None while one runs, while the queue is paused or held, or when none waits."""
        if self.paused or self.held or self.running is not None:
            return None
        return next((run for run in self.runs if run.state == "waiting"), None)

    def start(self, number: int, bag: Path) -> None:
        """Note that a run has begun."""
        self._replace(number, state="running", phase="sent", bag=str(bag))
        self._keep()

    def progress(self, number: int, phase: str, elapsed: float) -> None:
        """Note how far a run is, unless it has ended in the meantime."""
        if self.running is not None and self.running.number == number:
            self._replace(number, phase=phase, elapsed=elapsed)

    def end(self, number: int, state: State, message: str, bag: str) -> None:
        """Note how a run has ended; the runs after one that did not end well wait for the operator."""
        run = self._replace(number, state=state, phase="", message=message, bag=bag)
        if state != "done" and not self.paused and self.waiting:
            self.pause(f"after run {number}, {run.name}, has failed")
        self._keep(run.batch)

    @property
    def waiting(self) -> list[QueuedRun]:
        """The runs that wait, the next one first."""
        return [run for run in self.runs if run.state == "waiting"]

    def sentence(self) -> str:
        """Return what the queue does, and what waits in it."""
        waiting = self.waiting
        waits = f"{len(waiting)} waiting, next is {waiting[0].name}" if waiting else "nothing waits"
        if self.paused or self.held:
            return f"{' '.join(filter(None, ('queue paused', self.held or self.why)))}: {waits}"
        if self.running is None and not waiting:
            return "queue empty"
        runs = [f"{self.running.name} runs"] if self.running else []
        return f"queue: {', '.join([*runs, waits])}, about {self.time_left:.0f} s left"

    @property
    def running(self) -> QueuedRun | None:
        """The run that is under way."""
        return next((run for run in self.runs if run.state == "running"), None)

    @property
    def time_left(self) -> float:
        """Time in s that the waiting runs and the present one take, with the breaks between them."""
        open_runs = [run for run in self.runs if run.state in ("waiting", "running")]
        return sum(max(0.0, run.duration - run.elapsed) + _BETWEEN_RUNS for run in open_runs)
