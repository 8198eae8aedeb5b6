"""What a fault is, what is expected of the bench, and the one way in which its reaction is measured.

A fault is injected while the rod moves at 50 mm/s with 100 mA in the coil, or at a random moment of the whole procedure, of
an experiment or of a hybrid test, or in a phase of a diagnosis that records what it needs.
Motion and current are the true ones of the simulated plant, every 20 ms; all times are bench times.
"""

import dataclasses
import random
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from whole_bench import BENCH, ROOT, WholeBench, simulate_first_round

from faults.broken_machine import BrokenMachine
from mrd_base.nodes.bench_node import seconds
from mrd_base.nodes.graph import DIAGNOSE_ON_BENCH
from mrd_control.experiment import format_control_experiment, read_control_experiment
from mrd_diagnosis.sequential.first_set import FIRST_SET
from mrd_interfaces.action import DiagnoseOnBench, RunExperiment
from mrd_interfaces.msg import BenchState
from mrd_runs.bag import read_bag
from mrd_runs.blocks import decode_blocks

LONG = """
name: long
duration_s: 30.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 8.0, frequency_hz: 1.0}
coil: {waveform: constant, level_mA: 100.0}
"""
# It must still be under way when a busy machine notices that the rod is at full speed.
SHORT = LONG.replace("duration_s: 30.0", "duration_s: 10.0")
_SHIPPED = read_control_experiment(ROOT / "config/control/hybrid_test.yaml")
HYBRID = format_control_experiment(
    dataclasses.replace(
        _SHIPPED,
        name="hybrid",
        duration=30.0,
        excitation=dataclasses.replace(_SHIPPED.excitation, amplitude=0.018, start=1.2, end=1.3),
        law="constant_current",
        gains={"current": 0.1},
    )
)
"""A hybrid test whose rod moves as fast all the time."""
LIVELY = format_control_experiment(
    dataclasses.replace(
        _SHIPPED,
        name="lively",
        duration=30.0,
        system=dataclasses.replace(_SHIPPED.system, unsprung_mass=40.0, passive_damping=0.0),
        excitation=dataclasses.replace(_SHIPPED.excitation, amplitude=0.006, start=1.2, end=1.3),
        law="constant_current",
        gains={"current": 0.1},
    )
)
"""One that only the damper damps, with a light wheel: stable while the rod is no later than declared."""

SIMPLE = "bingham"
"""Model whose diagnosis needs several rounds: the simulated damper has a hysteresis, which it lacks."""

MOVES, FLOWS, STANDS, FAST = 2e-3, 0.02, 2e-4, 0.045
"""m/s and A above which rod and coil are not at rest; m by which a rod that stands may be displaced; m/s from which faults
are injected."""
FAST_IN_DIAGNOSIS = 0.01
"""The same in a diagnosis, whose later recordings may have small strokes."""
_MOMENTS = 8.0
"""Bench time in s from the goal within which random moments lie: homing, tare, and some seconds of the run."""


class Ending(Enum):
    """How a run ends after a fault."""

    LATCHED = "stops until reset"
    ENDED = "the run ends"
    COMPLAINS = "the result says so"
    COMPLETE = "goes on"


class Phase(Enum):
    """What a diagnosis on the bench does."""

    FIRST = "first recording"
    BETWEEN = "between two recordings"
    COMPUTES = "while it computes"
    LATER = "recording of a later round"


@dataclass(frozen=True)
class Fault:
    """A row of the campaign.

    Attributes
    ----------
    name : str
    inject : callable
        Breaks something on a `Bench`; may return what was said to whoever did it.
    cause : str
        Regular expression of what the result must say; "" for nothing.
    ending : Ending
    told : str or None
        Regular expression of what ``/diagnostics`` must say, by default the cause; "" where it need not. At a random moment,
        it must say so where it latches a stop.
    rest, coil : float or None
        Longest time in s until the rod stands and the coil is without current; None where software cannot do it.
    repair : callable
        Mends it again.
    at_random, idle : bool
        Whether it is injected at a random moment of the procedure, or before a run is asked for, instead of at full speed.
    recorded : bool
        Whether the recording must go on until the rod stands.
    homes_on : bool
        Whether a homing that is under way may go on, because it needs nothing of what was broken.
    hybrid : bool
        Whether it is injected in a hybrid test, which ends by it, instead of an experiment.
    experiment : str
        What runs then, where it is not the usual one.
    phase : Phase or None
        Of a diagnosis on the bench, in which it is injected instead of in an experiment.
    """

    name: str
    inject: Callable[["Bench"], str | None]
    cause: str
    ending: Ending = Ending.LATCHED
    told: str | None = None
    rest: float | None = 0.2
    coil: float | None = 0.2
    repair: Callable[["Bench"], None] = lambda bench: bench.set_fault("")
    at_random: bool = False
    idle: bool = False
    recorded: bool = True
    homes_on: bool = False
    hybrid: bool = False
    experiment: str = ""
    phase: Phase | None = None

    @property
    def bench(self) -> tuple[bool, bool]:
        """Whether it needs a bench with a controller, and one with a diagnoser."""
        return self.hybrid, self.phase is not None


@dataclass(frozen=True)
class Reaction:
    """What the bench did: times in s until rod and coil were at rest, what it said, and what is wrong with that."""

    rest: float
    coil: float
    said: str
    recording: str
    failures: tuple[str, ...] = ()


class Bench(WholeBench):
    """A bench with limit switches that one fault after the other is tried on."""

    def __init__(self, folder: Path, seed: int, hybrid: bool = False, diagnoser: bool = False, **environment: str) -> None:
        wired = {"servo": {"limit_switches": True}, "plant": {"motor.limit_switches": True}}
        folder.mkdir(parents=True, exist_ok=True)
        self.machine = BrokenMachine(folder)
        cycle = _SHIPPED.cycle if hybrid else None
        super().__init__(
            folder / "bench", wired, control_cycle=cycle, diagnoser=diagnoser, **environment, **self.machine.environment
        )
        self.action = "run_control" if hybrid else "run_experiment"
        self.folder = folder
        self.random = random.Random(seed)
        self.bag = folder
        self.told: list[str] = []
        self.background: list[Any] = []
        """Processes that a fault has started."""

    def __enter__(self) -> "Bench":
        super().__enter__()
        self.run = ActionClient(self.client.node, RunExperiment, self.action)
        self.diagnose = DIAGNOSE_ON_BENCH.client(self.client.node)
        assert self.client.spin(self.run.server_is_ready, 30)
        return self

    def __exit__(self, *error: object) -> None:
        self.end_background()
        self.run.destroy()
        self.diagnose.destroy()
        super().__exit__(*error)

    def end_background(self) -> None:
        for process in self.background:
            process.kill()
            process.wait()
        self.background.clear()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        super()._on_diagnostics(message)
        for status in message.status:
            # The plant says which fault is injected.
            if status.level != DiagnosticStatus.OK and not status.name.endswith("plant: state"):
                self.told.append(f"{status.name}: {status.message}")
            elif status.name.endswith("daq: state"):
                self.told += [f"{value.key} {value.value}" for value in status.values if value.key == "lost_readings"]

    def send(self, experiment: str) -> Any:
        """Send an experiment; return the future of its result."""
        accepted = self.run.send_goal_async(RunExperiment.Goal(experiment=experiment, bag=str(self.bag)))
        assert self.client.spin(accepted.done, 30)
        return accepted.result().get_result_async()

    def run_to_random_moment(self, experiment: str) -> Any:
        """Send an experiment; return the future of its result at a random moment of the procedure."""
        ended = self.send(experiment)
        self.advance(self.random.uniform(0.0, _MOMENTS))
        return ended

    def first_round(self) -> Path:
        """Return the folder of the recordings of a first round, made without the bench: another one follows them."""
        folder = self.folder / "round_1"
        if not folder.exists():
            simulate_first_round(folder)
        return folder

    def send_diagnosis(self, until: Callable[[Any], bool]) -> Any:
        """Send a diagnosis on the bench, with recordings and reports in the folder ``diagnosis``; return the handle of its
        goal and the future of its result once it has told what is waited for.

        Until then, the bench time stands still while it computes, as it does for the tool `bench`.
        """
        reached = stands = False

        def hear(message: Any) -> None:
            nonlocal reached, stands
            if not reached and stands == message.feedback.moves:
                stands = not stands
                (self.clock.hold if stands else self.clock.release)()
            reached = reached or until(message.feedback)

        goal = DiagnoseOnBench.Goal(model=SIMPLE, bench=str(BENCH), folder=str(self.diagnosis))
        assert self.client.spin(self.diagnose.server_is_ready, 30, watch=False)
        accepted = self.diagnose.send_goal_async(goal, feedback_callback=hear)
        assert self.client.spin(accepted.done, 30, watch=False)
        assert accepted.result().accepted, "the diagnosis was refused"
        ended = accepted.result().get_result_async()
        self.client.spin(lambda: reached or ended.done(), 600, watch=False)
        if stands:
            self.clock.release()
        assert not ended.done(), ended.result().result.message
        assert reached, "the diagnosis does not come so far"
        return accepted.result(), ended

    def diagnose_until(self, phase: Phase, number: int) -> Any:
        """Begin a diagnosis on the bench; return the future of its result in a phase of it."""
        self.diagnosis = self.folder / f"diagnosis{number}"
        self.bag = self.diagnosis / "none"
        if phase in (Phase.COMPUTES, Phase.LATER):
            shutil.copytree(self.first_round(), self.diagnosis / "round_1")

        def reached(feedback: Any) -> bool:
            if phase is Phase.COMPUTES:
                return not feedback.moves
            number = 2 if phase is Phase.LATER else 1
            if phase is Phase.BETWEEN:
                return feedback.stage.startswith(f"recording {FIRST_SET[1]}")
            return feedback.round == number and feedback.moves and feedback.stage.endswith("running")

        self.handle, ended = self.send_diagnosis(reached)
        if phase in (Phase.FIRST, Phase.LATER):
            folder = self.diagnosis / f"round_{2 if phase is Phase.LATER else 1}"
            (self.bag,) = [path for path in folder.iterdir() if path.name not in ("report", "incomplete")]
            fast = self.client.spin(lambda: abs(self.truth[-1].velocity[0]) > FAST_IN_DIAGNOSIS, 60, watch=False)
            assert fast, "the rod does not move"
        return ended

    def cancel(self) -> None:
        """Cancel the diagnosis, as `bench` does at Ctrl-C."""
        self.handle.cancel_goal_async()
        self.client.spin(lambda: False, 0.5, watch=False)  # nobody announces the request to the bench time

    def watch_the_end(self, duration: float = 3.0) -> None:
        """Let bench time pass until the rod has not moved for so many s: a recording may go on, but none begins."""
        while True:
            begun = self.clock.now()
            self.advance(duration)
            if not self.last_time(begun, lambda state: abs(state.velocity[0]) > MOVES):
                return

    def recorded(self) -> dict[Path, int]:
        """Return the closed recordings of the diagnosis, each with the time of its last change in ns."""
        return {path.parent: path.stat().st_mtime_ns for path in self.diagnosis.glob("round_*/*/metadata.yaml")}

    def go_on(self) -> str:
        """Send the diagnosis again, until it records or computes; return what is wrong with that, or ""."""
        kept = self.recorded()
        try:
            handle, ended = self.send_diagnosis(lambda feedback: not feedback.moves or feedback.stage.endswith("running"))
        except AssertionError as error:
            return f"the diagnosis does not go on: {error}"
        handle.cancel_goal_async()
        if not self.client.spin(ended.done, 120, watch=False):
            return "the diagnosis that goes on is not cancelled"
        later = self.recorded()
        moved = [path for path in self.diagnosis.glob("round_*/incomplete/*") if path.is_dir()]
        lost = [path.name for path in kept if later.get(path) != kept[path] and path.name not in str(moved)]
        return f"lost: {', '.join(lost)}" if lost else ""

    def restart(self, name: str) -> None:
        """Start a node that has ended, or was stopped by a signal."""
        if name in self.processes.running:
            self.processes.kill(name)
        self.processes.start(name)
        self.await_up({name})

    def advance(self, duration: float) -> None:
        """Let bench time pass."""
        end = self.clock.now() + duration
        self.client.spin(lambda: bool(self.truth) and seconds(self.truth[-1].header.stamp) > end, 30, watch=False)

    def hear_the_servo(self, time: float) -> None:
        """Wait for a state of the servo from after a bench time.

        Bench time does not wait for this process, which takes in turn one message of each topic. Of one with twice as many
        messages as another, it may be 2 s behind.
        """
        assert self.client.spin(lambda: seconds(self.servo[-1].header.stamp) > time, 10, watch=False)

    def reach_full_speed(self) -> None:
        """Let bench time, which stands still, pass until the rod is nearly at full speed.

        That is before mid-stroke: behind it the rod slows down, and a difference of positions takes longer to build up.
        """
        for _ in range(300):
            self.clock.sleep(0.01)
            now = self.clock.now()
            assert self.client.spin(lambda now=now: now - seconds(self.truth[-1].header.stamp) < 0.021, 10, watch=False)
            position, velocity = self.truth[-1].position[0], self.truth[-1].velocity[0]
            if abs(velocity) > FAST and position * velocity < 0.0:
                return
        raise AssertionError("the rod does not reach its full speed")

    def homes(self, state: JointState) -> bool:
        """Whether the bench was in mode homing at the time of a true state."""
        before = [mode.mode for mode in self.modes if seconds(mode.header.stamp) <= seconds(state.header.stamp)]
        return bool(before) and before[-1] == BenchState.HOMING

    def story(self, duration: float = 20.0) -> list[str]:
        """Return what modes, servo and logs have said of late, for a row that is beyond its limits."""
        since = seconds(self.truth[-1].header.stamp) - duration
        told: list[tuple[float, str]] = []
        for what, states in (("mode", self.modes), ("servo", self.servo)):
            before = ""
            for state in states:
                text = f"{what} {getattr(state, 'mode', '')}: {state.message}"
                if (at := seconds(state.header.stamp)) > since and text != before:
                    told.append((at, text))
                before = text
        logs = {name: self.processes.log(name).read_text(errors="replace") for name in self.processes.running}
        ends = [f"{name}.log: {line}" for name, text in logs.items() for line in text.splitlines()[-6:]]
        return [f"{at:.3f} s: {text}" for at, text in sorted(told)] + ends

    def last_time(self, begun: float, what: Callable[[Any], bool]) -> float:
        """Return how long after a bench time something true of the plant has last been so, in s."""
        return max((0.0, *(seconds(state.header.stamp) - begun for state in self.truth if what(state))))


def measure(fault: Fault, bench: Bench, number: int) -> Reaction:
    """Inject a fault, measure what happens, mend it, and reset the bench."""
    bench.bag = bench.folder / f"bag{number}"
    bench.truth.clear()
    usual = HYBRID if fault.hybrid else SHORT if fault.ending in (Ending.COMPLETE, Ending.COMPLAINS) else LONG
    experiment = fault.experiment or usual
    ended: Any = None
    if fault.at_random:
        ended = bench.run_to_random_moment(experiment)
        if ended.done() and "loaded another experiment" in ended.result().result.message:
            # The generator has answered a request of the supervisor that was killed before.
            ended = bench.run_to_random_moment(experiment)
    elif fault.phase:
        ended = bench.diagnose_until(fault.phase, number)
    elif not fault.idle:
        ended = bench.run_at_speed(experiment, bench.bag, bench.action)
    with bench.clock.busy():
        if not (fault.at_random or fault.idle or fault.phase):
            bench.reach_full_speed()
        begun = bench.clock.now()
        bench.told.clear()
        answer = fault.inject(bench) or ""
    if fault.idle:
        bench.advance(0.5)
        result, ends = bench.client.run_experiment(experiment, bench.bag, 0), True
    else:
        teller, patience = ("diagnoser", 600) if fault.phase else ("supervisor", 120)
        ends = bench.client.spin(lambda: ended.done() or _is_gone(bench, teller), patience, watch=False)
        result = ended.result().result if ended.done() else None
    if fault.phase:
        bench.watch_the_end()
    # The result may be heard before the mode in which the run has ended.
    bench.advance(max(0.2, begun + 1.0 - bench.clock.now()))
    rest = bench.last_time(
        begun, lambda state: abs(state.velocity[0]) > MOVES and not (fault.homes_on and bench.homes(state))
    )
    coil = bench.last_time(begun, lambda state: state.effort[1] > FLOWS)
    if result is None:
        bench.hear_the_servo(begun + 0.5)
    said = answer or (result.message if result is not None else bench.servo[-1].message)
    told = fault.cause if fault.told is None else fault.told
    latched = bench.modes[-1].mode == BenchState.FAULT or bench.servo[-1].stopped
    heard = not told or (fault.at_random and not latched)
    heard = heard or bench.client.spin(lambda: any(re.search(told, line) for line in bench.told), 6, watch=False)

    failures: list[str] = []

    def require(holds: bool, problem: str) -> None:
        if not holds:
            failures.append(problem)

    require(ends, "the run does not end")
    require(not fault.cause or re.search(fault.cause, said) is not None, f"the result is {said!r}")
    require(bool(said) or result is not None or not bench.servo[-1].stopped, "the servo is stopped and tells no cause")
    require(heard, f"/diagnostics says {sorted(set(bench.told))}")
    succeeded = result is not None and result.success
    require(succeeded == (fault.ending is Ending.COMPLETE), f"success is {succeeded}")
    stops = fault.ending in (Ending.LATCHED, Ending.ENDED)
    if stops:
        require(fault.rest is None or rest <= fault.rest, f"the rod stands after {1e3 * rest:.0f} ms")
        require(fault.coil is None or coil <= fault.coil, f"the coil is off after {1e3 * coil:.0f} ms")
    recording, problem = _look_at_bag(bench, begun, rest if stops else 0.0, fault)
    require(not problem, problem)
    # At a random moment, nothing may have moved yet that could be latched.
    if fault.ending is Ending.LATCHED and not (fault.at_random and bench.modes[-1].mode == BenchState.IDLE):
        failures += _try_to_move(bench)
    fault.repair(bench)
    bench.end_background()
    problem = bench.reset() or (bench.go_on() if fault.phase else "")
    require(not problem, problem)
    return Reaction(rest, coil, said, recording, tuple(failures))


def _is_gone(bench: Bench, name: str) -> bool:
    """Whether a process has ended or was stopped by a signal."""
    process = bench.processes.running.get(name)
    if process is None or process.poll() is not None:
        return True
    return Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] in "Tt"


def _look_at_bag(bench: Bench, begun: float, rest: float, fault: Fault) -> tuple[str, str]:
    """Return until when the bag goes, and what is wrong with it."""
    if not bench.bag.exists() and (aside := bench.bag.parent / "incomplete" / f"{bench.bag.name}_1").exists():
        bench.bag = aside  # where a diagnosis puts a recording that has failed
    if not bench.bag.exists():
        return "none", "" if fault.at_random or not fault.recorded else "nothing was recorded"
    try:
        bag = read_bag(bench.bag, {"samples"})
        topics = [entry for entry in bag.topics.values() if entry.messages]
        if not topics:  # broken before the first samples were written, a quarter of a second after the bag was made
            return "empty", "" if fault.at_random or fault.phase else "the bag has no samples"
        (topic,) = topics
        blocks = decode_blocks(topic.messages, bag.types)
    except ValueError as error:
        empty = fault.at_random and "samples" in str(error)
        return "empty", "" if empty else f"the bag cannot be read: {error}"
    last = float(1e-9 * blocks.stamp[-1] + blocks.period[-1] * (blocks.count[-1] - 1)) - begun
    missing = fault.recorded and last < rest + 0.3 and last > -0.05
    return f"{last:+.2f} s", f"the recording ends at {last:+.2f} s" if missing else ""


def _try_to_move(bench: Bench) -> list[str]:
    """Ask for motion of a bench that has stopped; return what it did wrongly."""
    failures = []
    bench.truth.clear()
    bench.advance(0.2)
    here = bench.truth[-1].position[0]
    attempts: dict[str, tuple[Any, dict[str, Any]]] = {
        "servo/home": (Trigger, {}),
        "servo/enable": (SetBool, {"data": True}),
        "home": (Trigger, {}),
    }
    for name, (kind, fields) in attempts.items():
        try:
            if bench.service(name, kind, 2.0, **fields).success:
                failures.append(f"{name} was accepted before the reset")
        except AssertionError:
            pass  # nobody is there to be asked
    bench.advance(0.5)
    moved = float(np.ptp([state.position[0] for state in bench.truth] + [here]))
    return [*failures, f"the rod moved by {1e3 * moved:.2f} mm before the reset"] if moved > STANDS else failures


def worst(reactions: list[Reaction]) -> Reaction:
    """Return the longest times of several reactions and all that was wrong."""
    last = reactions[-1]
    return dataclasses.replace(
        last,
        rest=max(reaction.rest for reaction in reactions),
        coil=max(reaction.coil for reaction in reactions),
        failures=tuple(dict.fromkeys(failure for reaction in reactions for failure in reaction.failures)),
    )


def table(rows: list[tuple[Fault, list[Reaction]]]) -> str:
    """Return the table of the campaign in Markdown."""
    lines = [
        "| fault | times | expected | rod at rest after, ms | coil off after, ms | named as | bag ends | |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for fault, reactions in rows:
        reaction = worst(reactions)
        stops = fault.ending in (Ending.LATCHED, Ending.ENDED)

        def shown(value: float, limit: float | None, stops: bool = stops) -> str:
            if not stops:
                return ""
            return f"{1e3 * value:.0f}" if limit is not None else "hardware"

        said = reaction.said.replace("|", "/").replace(str(fault), "")
        said = re.sub(r"/[^ ,;:()]*/(bag\d*|round_\d)", r"\1", said)
        said = said if len(said) < 120 else said[:117] + "..."
        cells = [fault.name, str(len(reactions)), fault.ending.value, shown(reaction.rest, fault.rest)]
        cells += [shown(reaction.coil, fault.coil), said, reaction.recording]
        cells.append("; ".join(reaction.failures).replace("|", "/") or "ok")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
