"""The runs that wait, the one that runs, and those that have ended."""

import dataclasses
import itertools
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from mrd_base import InputError

Kind = Literal["identification", "control"]
State = Literal["waiting", "running", "done", "failed", "stopped"]

# Wall time in s between two runs, for homing, tare, and the closing of the bag, by which the time left is estimated.
_BETWEEN_RUNS = 5.0
_MOST_ENDED = 100


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
    problem : str
        Why the file could not be written, or "".
    stops : int
        How often somebody has stopped the bench from the page.
    """

    file: Path | None = None
    runs: list[QueuedRun] = field(default_factory=list)
    paused: bool = False
    problem: str = ""
    stops: int = 0

    def __post_init__(self) -> None:
        if self.file is not None and self.file.exists():
            try:
                self.runs = [QueuedRun(**entry) for entry in json.loads(self.file.read_text(encoding="utf-8"))]
            except (ValueError, TypeError):
                self.runs = []  # of another version
            self.paused = any(run.state in ("waiting", "running") for run in self.runs)
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

    def _keep(self) -> None:
        ended = [run for run in self.runs if run.state not in ("waiting", "running")]
        dropped = {run.number for run in ended[:-_MOST_ENDED]}
        self.runs = [run for run in self.runs if run.number not in dropped]
        if self.file is not None:
            part = self.file.with_name(self.file.name + ".part")
            try:
                part.write_text(json.dumps([dataclasses.asdict(run) for run in self.runs]), encoding="utf-8")
                part.replace(self.file)
                self.problem = ""
            except OSError as error:
                # A full disk must not keep a run from being seen to end.
                self.problem = f"{self.file}: {error.strerror}; the queue will be lost with the page"

    def add(
        self, name: str, experiment: str, duration: float, seed: int = 0, kind: Kind = "identification", damper: str = ""
    ) -> QueuedRun:
        """Append a run."""
        self.runs.append(QueuedRun(next(self._numbers), name, experiment, duration, seed, kind=kind, damper=damper))
        self._keep()
        return self.runs[-1]

    def stop(self) -> None:
        """Let the runs that wait, wait for the operator: somebody stops the bench."""
        self.paused = True
        self.stops += 1

    def require_no_stop_since(self, stops: int) -> None:
        """Refuse what was asked for when there were so many stops, if there are more now: nothing moves by it any more."""
        if self.stops != stops:
            raise InputError("somebody stopped the bench meanwhile; nothing was added, ask for it again")

    def retry(self, number: int) -> QueuedRun:
        """Append a run that has ended once more."""
        run = self._replace(number)
        return self.add(run.name, run.experiment, run.duration, run.seed, run.kind, run.damper)

    def remove(self, number: int) -> None:
        """Take a run out that does not run."""
        if self._replace(number).state == "running":
            raise InputError(f"run {number} is under way; stop it first")
        self.runs = [run for run in self.runs if run.number != number]
        self._keep()

    def next(self) -> QueuedRun | None:
        """Return the run whose turn it is; None while one runs, while the queue is paused, or when none waits."""
        if self.paused or self.running is not None:
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
        self._replace(number, state=state, phase="", message=message, bag=bag)
        self.paused = self.paused or (state != "done" and any(run.state == "waiting" for run in self.runs))
        self._keep()

    @property
    def running(self) -> QueuedRun | None:
        """The run that is under way."""
        return next((run for run in self.runs if run.state == "running"), None)

    @property
    def time_left(self) -> float:
        """Time in s that the waiting runs and the present one take, with the breaks between them."""
        open_runs = [run for run in self.runs if run.state in ("waiting", "running")]
        return sum(max(0.0, run.duration - run.elapsed) + _BETWEEN_RUNS for run in open_runs)
