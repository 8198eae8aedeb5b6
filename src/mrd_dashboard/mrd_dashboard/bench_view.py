"""What the page knows of the bench: everything that it heard, without ROS."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mrd_base import BenchClock
from mrd_base.lease import Mode
from mrd_bench_driver.supervision.config import SupervisorConfig
from mrd_bench_driver.supervision.snapshot import BenchMonitor
from mrd_dashboard.hybrid_view import CycleHistory
from mrd_dashboard.lamps import Lamp, lamps
from mrd_dashboard.sample_history import SampleHistory
from mrd_trajectory.settings import GeneratorSettings

SILENT_AFTER = 1.0
"""Wall time in s without a lease after which the page says that nobody supervises the bench; also for servo and DAQ."""
NODE_SILENT_AFTER = 5.0
"""Wall time in s without diagnostics, which every node sends once a second, after which the page calls it silent."""

SERVO, DAQ, RECORDER = "servo", "DAQ", "recorder"
"""These are heard several times a second."""


@dataclass(frozen=True)
class NodeHealth:
    """Diagnostics of a node: its level (0 ok, 1 warning, 2 error), message, and values."""

    level: int
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass
class BenchView:
    """State of the bench, as far as the page has heard it.

    One thread writes what it hears, any thread reads. Ages are by bench time: the time of the latest lease counts as now.

    Attributes
    ----------
    supervisor : SupervisorConfig
        Limits and tolerances of the interlocks.
    generator : GeneratorSettings
        Limits against which experiments are checked.
    samples : SampleHistory
    cycles : CycleHistory
        Of the controller, in a hybrid test.
    monitor : BenchMonitor
        What the supervisor would know by the same messages.
    mode, reason : Mode, str
        Mode of the bench and why it is in it; the reason is empty until the supervisor was heard.
    stops : int
        How often it was stopped, as the supervisor counts: from 1; 0 until it was heard.
    bench_time : float
        Bench time in s of the latest lease.
    lease_heard : float
        Wall time in s at which it came, by `time.monotonic`.
    lease_holder : (str, float) or None
        The supervisor whose lease it is, and the bench time in s at which that one started.
    source : str
        The node whose setpoints are followed, by that lease.
    """

    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)
    generator: GeneratorSettings = field(default_factory=GeneratorSettings)
    samples: SampleHistory = field(default_factory=SampleHistory)
    cycles: CycleHistory = field(default_factory=CycleHistory)
    monitor: BenchMonitor = field(default_factory=lambda: BenchMonitor(BenchClock()))
    mode: Mode = Mode.IDLE
    reason: str = ""
    stops: int = 0
    bench_time: float = float("nan")
    lease_heard: float = -float("inf")
    lease_holder: tuple[str, float] | None = None
    source: str = ""
    _bag: str = ""
    _nodes: dict[str, NodeHealth] = field(default_factory=dict)
    _heard: dict[str, float] = field(default_factory=dict)

    def hear_lease(self, bench_time: float, holder: str = "", since: float = 0.0, source: str = "") -> None:
        """Note that the supervisor has renewed its lease, who it is, since when it is there, and whose setpoints count."""
        self.bench_time, self.lease_heard = bench_time, time.monotonic()
        self.lease_holder, self.source = (holder, since), source

    @property
    def supervised(self) -> bool:
        """Whether the supervisor lives."""
        return time.monotonic() - self.lease_heard < SILENT_AFTER

    def hear(self, name: str) -> None:
        """Note that something was heard now."""
        self._heard[name] = time.monotonic()

    def silence(self, name: str) -> float:
        """Return the wall time in s since something was heard; infinite if it never was."""
        return time.monotonic() - self._heard.get(name, -float("inf"))

    def hear_recorder(self, state: str, problem: str, bag: str) -> None:
        """Note a state of the recorder, the problem of its recording, and the folder of the bag that it has open."""
        self._bag = bag
        self.hear(RECORDER)
        self.monitor.add_recorder_state(state, problem, self.bench_time)

    @property
    def recorded(self) -> Path | None:
        """Folder of the bag that is being written, for whichever client; None when none is, or its recorder has died."""
        # The state is repeated in bench time, which may stand still, the diagnostics in wall time.
        lives = self.silence(RECORDER) <= NODE_SILENT_AFTER or self.lives("recorder")
        return Path(self._bag) if self._bag and lives else None

    def hear_node(self, name: str, health: NodeHealth) -> None:
        """Note the diagnostics of a node."""
        self._nodes[name] = health
        self.hear(f"node {name}")

    def nodes(self) -> dict[str, NodeHealth]:
        """Return the latest diagnostics of each node that was heard; one that has become silent is an error."""
        found = {}
        for name, health in sorted(self._nodes.copy().items()):
            silence = self.silence(f"node {name}")
            if silence > NODE_SILENT_AFTER:
                last = "" if health.message == "ok" else f"; its last words: {health.message}"
                health = NodeHealth(2, f"silent for {silence:.0f} s; look whether it is up{last}", health.values)
            found[name] = health
        return found

    def lives(self, node: str) -> bool:
        """Return whether a node was heard a moment ago."""
        return self.silence(f"node {node}") <= NODE_SILENT_AFTER

    def lamps(self) -> list[Lamp]:
        """Return a lamp for each interlock, the first one for the supervisor itself."""
        silence = time.monotonic() - self.lease_heard
        first = Lamp("supervisor", "ok", "watches")
        if not self.supervised:
            first = Lamp(
                "supervisor",
                "tripped",
                "silent" if self.reason else "not heard",
                f"{1e3 * SILENT_AFTER:.0f} ms",
                f"the supervisor has been silent for {silence:.1f} s" if self.reason else "no supervisor was heard yet",
                "look at its log, or start the bench",
            )
        now = self.monitor.snapshot(self.bench_time, self.source)
        config = self.supervisor
        return [first, *lamps(now, config.limits, config.interlocks, self.mode, self.reason)]
