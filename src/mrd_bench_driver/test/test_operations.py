"""The supervisor and its operations with fake peers, without ROS."""

import contextlib
import dataclasses
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mrd_base import BenchClock
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.config import SupervisorConfig
from mrd_bench_driver.supervision.errors import CancelledError, RefusedError, TrippedError
from mrd_bench_driver.supervision.interlocks import Tolerances
from mrd_bench_driver.supervision.modes import BenchMode, Mode
from mrd_bench_driver.supervision.operations import BenchOperations
from mrd_bench_driver.supervision.supervisor import Supervisor

EXPERIMENT = "{name: short, duration_s: 0.5, rate_hz: 1000, rod: {waveform: constant}}"


class FakePeers:
    """Peers that do at once what they are asked, and whose data are published by `publish`."""

    def __init__(self, clock: BenchClock | None = None, **changes: float) -> None:
        self.calls: list[str] = []
        self.refusals: dict[str, str] = {}
        self.effects: dict[str, Callable[[], None]] = {}
        self.takes: dict[str, float] = {}  # wall time in s that a service takes
        self.absent: tuple[str, ...] = ()
        self.clock = clock or BenchClock()
        self.servo = ServoStatus(position=0.0, connected=True)
        self.force, self.rate, self.state, self.recorder = 0.0, 100.0, "", "idle"
        self.temperature = 300.0
        self.modes: list[tuple[Mode, str]] = []
        self.emergency_stops: list[bool] = []
        # These tests share their machine with tests that compute, so that the thread that publishes may come late.
        stale = Tolerances(samples_stale=1.0, servo_stale=1.0, setpoint_stale=0.5)
        patience = {"late": 1.0, "stall": 1.0, "interlocks": stale}
        timeouts = {"answer_timeout": 0.2, "discovery_timeout": 0.1}
        config = SupervisorConfig(**{**timeouts, **patience, **changes})  # type: ignore[arg-type]
        self.supervisor = Supervisor(config, self.clock, self, self._on_mode, self._on_emergency_stop)
        self.publish()

    def publish(self) -> None:
        now, ones = self.clock.now(), np.ones(10)
        monitor = self.supervisor.monitor
        series = 0 * ones, self.force * ones, 0 * ones, self.temperature * ones
        monitor.add_samples(now - 9 / self.rate, 1 / self.rate, *series)
        monitor.add_servo_status(dataclasses.replace(self.servo, time=now))
        if self.recorder:  # "" is silent
            monitor.add_recorder_state(self.recorder, "", now)
        if self.state != monitor.experiment_state:
            monitor.add_experiment_state(self.state, now)
        self.supervisor.check_interlocks()

    def _on_mode(self, mode: BenchMode, stops: int) -> None:
        if self.modes[-1:] != [(mode.current, mode.reason)]:
            self.modes.append((mode.current, mode.reason))
        self.told_stops = stops

    def _on_emergency_stop(self, stop: bool) -> None:
        self.emergency_stops.append(stop)
        if stop:
            self.servo = dataclasses.replace(self.servo, stopped=True, enabled=False)
            self.supervisor.monitor.add_daq_problem("emergency stop")

    def require(self, nodes: tuple[str, ...], timeout: float, interruption: Callable[[], None]) -> None:
        missing = [node for node in nodes if node in self.absent]
        if missing:
            raise RefusedError(f"not there: {', '.join(missing)}")

    def check(self, service: str) -> None:
        pass

    def call(
        self, service: str, timeout: float, *_interruption: Callable[[], None], may_fail: bool = False, **fields: Any
    ) -> Any:
        if self.takes.get(service, 0.0) > timeout:
            raise RefusedError(f"{service} was not answered within {timeout:g} s")
        self.calls.append(service + (f" {fields['data']}" if service == "servo/enable" else ""))
        if service in self.refusals:
            if may_fail:
                return SimpleNamespace(success=False, message=self.refusals[service])
            raise RefusedError(f"{service}: {self.refusals[service]}")
        changes: dict[str, dict[str, object]] = {
            "servo/home": {"homed": True},
            "servo/enable": {"enabled": fields.get("data")},
            "servo/rest": {"enabled": False},
            "servo/reset_fault": {"stopped": False, "fault": False},
        }
        self.servo = dataclasses.replace(self.servo, **changes.get(service, {}))
        states = {"load_experiment": "loaded", "start_experiment": "running", "abort_experiment": "aborted"}
        self.state = states.get(service, self.state)
        self.recorder = {"start_recording": "recording", "stop_recording": "idle"}.get(service, self.recorder)
        if service == "daq/reset_fault":
            self.supervisor.monitor.add_daq_problem("")
        self.effects.get(service, lambda: None)()
        return SimpleNamespace(
            success=True, message="", duration=0.5, rate=1000.0, bag=fields.get("bag", "/tmp/bag"), samples=500, lost=0
        )

    def set_sample_rate(self, rate: float, timeout: float, interruption: Callable[[], None]) -> None:
        self.rate = rate


@pytest.fixture
def peers(request: pytest.FixtureRequest) -> Any:
    """Peers whose data a thread publishes, as the executor of the node does."""
    peers = FakePeers(**getattr(request, "param", {}))
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.01):
            peers.publish()

    thread = threading.Thread(target=publish)
    thread.start()
    yield peers
    ended.set()
    thread.join()


def never_cancelled() -> bool:
    return False


def run(peers: FakePeers, cancelled: Callable[[], bool] = never_cancelled, experiment: str = EXPERIMENT) -> Any:
    return peers.supervisor.run_experiment(experiment, "/tmp/bag", 3, lambda *_progress: None, cancelled)


def test_an_experiment_goes_through_the_modes_and_ends_in_idle(peers: FakePeers) -> None:
    peers.effects["start_experiment"] = lambda: setattr(peers, "state", "done")
    outcome = run(peers)
    assert outcome.success, outcome.message
    assert (outcome.recorded.bag, outcome.recorded.samples) == ("/tmp/bag", 500)
    assert [mode for mode, _ in peers.modes] == [Mode.IDLE, Mode.HOMING, Mode.IDENTIFICATION, Mode.IDLE]
    assert peers.calls[-2:] == ["servo/rest", "stop_recording"]
    assert not peers.emergency_stops


def test_a_busy_machine_may_take_a_minute_to_plan(peers: FakePeers) -> None:
    """Beside a load of eight, a controller needed more than the 30 s that it was given."""
    peers.takes = {"load_experiment": 60.0}
    peers.effects["start_experiment"] = lambda: setattr(peers, "state", "done")
    outcome = run(peers)
    assert outcome.success, outcome.message


def test_an_interlock_ends_an_experiment_and_reset_fault_needs_health(peers: FakePeers) -> None:
    peers.effects["start_experiment"] = lambda: setattr(peers, "force", 900.0)
    outcome = run(peers)
    assert outcome.message.startswith("interlock force: 900 N on the load cell")
    assert peers.emergency_stops[0]
    assert peers.supervisor.mode.current is Mode.FAULT
    with pytest.raises(RefusedError, match=r"not reset, force: 900 N"):
        peers.supervisor.reset_fault()
    assert peers.emergency_stops[-1]
    peers.force = 0.0
    assert peers.supervisor.reset_fault().startswith("reset; ")
    assert not peers.emergency_stops[-1]
    assert peers.supervisor.mode.current is Mode.IDLE


@pytest.mark.parametrize("peers", [{"late": 0.5}], indirect=True)
def test_a_machine_that_is_too_slow_is_named_before_and_after_a_run(
    peers: FakePeers, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start() -> None:
        for _ in range(3):
            peers.supervisor.tick()
        time.sleep(0.6)  # no setpoint comes meanwhile
        peers.supervisor.tick()

    peers.effects["start_experiment"] = start
    outcome = run(peers)
    assert outcome.message.startswith("interlock stale setpoint: ")
    assert "; this machine is too slow: 1 of 4 cycles came more than 500 ms late, the worst " in outcome.message
    assert peers.supervisor.reset_fault()

    delays = iter([0.0, 0.6])  # the first sleep is for the other nodes to hear that the bench is idle

    def sleep(duration: float) -> None:
        peers.supervisor.tick()
        time.sleep(duration + next(delays, 0.0))
        peers.supervisor.tick()

    monkeypatch.setattr(peers.clock, "sleep", sleep)
    peers.calls.clear()
    outcome = run(peers)
    assert not outcome.success
    assert outcome.message.startswith("not armed, this machine is too slow: 1 of 2 cycles came more than 500 ms late")
    assert "servo/enable True" not in peers.calls


def test_no_run_starts_with_a_damper_that_is_too_warm_but_homing_does(peers: FakePeers) -> None:
    peers.temperature = 273.15 + 65.0
    peers.publish()
    outcome = run(peers)
    assert not outcome.success
    assert outcome.message.startswith("not started, the damper has 65.0 degC, allowed 0 to 60 degC; wait, or change")
    assert "start_recording" not in peers.calls
    assert peers.supervisor.mode.current is Mode.IDLE
    assert peers.supervisor.home()


def test_cancel_and_stop_end_an_experiment(peers: FakePeers) -> None:
    started = threading.Event()
    peers.effects["start_experiment"] = started.set
    outcome = run(peers, started.is_set)
    assert (outcome.success, outcome.cancelled, outcome.message) == (False, True, "cancelled by stop or through its goal")
    assert "abort_experiment" in peers.calls

    started.clear()
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(run(peers)))
    thread.start()
    assert started.wait(5)
    with pytest.raises(RefusedError, match="the bench is busy: run_experiment; wait for its end or call stop"):
        peers.supervisor.home()
    assert peers.supervisor.stop() == "stopped"
    thread.join(5)
    assert results[0].cancelled
    assert peers.supervisor.mode.current is Mode.IDLE


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"absent": ("generator",)}, "not there: generator"),
        ({"refusals": {"load_experiment": "speed exceeds"}}, "load_experiment: speed exceeds"),
        ({"refusals": {"start_recording": "bag exists"}}, "start_recording: bag exists"),
    ],
)
def test_what_cannot_be_done_refuses_the_experiment(peers: FakePeers, broken: dict[str, Any], message: str) -> None:
    for name, value in broken.items():
        setattr(peers, name, value)
    outcome = run(peers)
    assert outcome.message == message
    assert peers.supervisor.mode.current is Mode.IDLE
    assert "start_experiment" not in peers.calls


def test_control_enables_and_a_failure_halts(peers: FakePeers) -> None:
    assert peers.supervisor.control() == f"the rod follows setpoints that carry lease {peers.supervisor.mode.lease}"
    assert peers.supervisor.mode.current is Mode.CONTROL
    assert peers.servo.enabled
    assert run(peers).message == "the bench is in mode control (control); call stop first"
    assert peers.supervisor.stop() == "stopped"
    peers.refusals["servo/home"] = "the motor is not connected"
    peers.calls.clear()
    with pytest.raises(RefusedError, match="the motor is not connected"):
        peers.supervisor.home()
    assert peers.calls == ["servo/home", "servo/rest"]
    assert peers.modes[-1] == (Mode.IDLE, "ended early")


def test_a_servo_that_does_not_rest_after_the_homing_ends_it_all_the_same(peers: FakePeers) -> None:
    """If the mode stayed homing after the procedure has ended, anybody could let the servo home the rod."""
    peers.refusals["servo/rest"] = "no answer"
    with pytest.raises(RefusedError, match="no answer"):
        peers.supervisor.home()
    assert peers.supervisor.procedure == ""
    assert peers.modes[-1] == (Mode.IDLE, "ended early")


def test_a_stop_at_the_very_end_of_the_request_ends_a_control_by_hand(
    peers: FakePeers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It finds the request still under way, which looks no more at whether it is to end."""
    enable = BenchOperations.enable

    def stop_then(bench: BenchOperations) -> None:
        enable(bench)
        assert peers.supervisor.stop() == "stopped"

    monkeypatch.setattr(BenchOperations, "enable", stop_then)
    with pytest.raises(CancelledError):
        peers.supervisor.control()
    assert (peers.supervisor.mode.current, peers.supervisor.mode.lease) == (Mode.IDLE, 0)


def test_an_emergency_stop_ends_a_request_with_its_reason(peers: FakePeers) -> None:
    peers.effects["servo/home"] = lambda: peers.supervisor.emergency_stop("emergency stop on the topic")
    peers.servo = dataclasses.replace(peers.servo, position=0.01)
    with pytest.raises(TrippedError, match="emergency stop on the topic"):
        peers.supervisor.home()
    assert peers.calls[-1:] == ["servo/rest"]


def test_a_stop_before_the_end_of_homing_cancels_it(peers: FakePeers) -> None:
    stopping: list[threading.Thread] = []

    def stop() -> None:
        stopping.append(threading.Thread(target=peers.supervisor.stop))
        stopping[0].start()

    peers.servo = dataclasses.replace(peers.servo, position=0.01)
    peers.effects["servo/home"] = stop
    with pytest.raises(CancelledError):
        peers.supervisor.home()
    stopping[0].join(5)
    assert peers.supervisor.mode.current is Mode.IDLE


class QuickClock(BenchClock):
    """Its time passes only where somebody waits; meanwhile the peers publish."""

    def __init__(self) -> None:
        self._now = 1000.0
        self.publish: Callable[[], None] = lambda: None

    def now(self) -> float:
        return self._now

    def sleep_until(self, bench_time: float) -> None:
        while self._now < bench_time:
            self._now += 0.01
            self.publish()

    def sleep_step(self, period: float) -> None:
        self.sleep(period)


def quick_peers() -> FakePeers:
    clock = QuickClock()
    peers = FakePeers(clock)
    clock.publish = peers.publish
    return peers


def stop_by_the_servo(peers: FakePeers) -> None:
    peers.clock.sleep(0.01)
    peers.servo = dataclasses.replace(peers.servo, halt_time=peers.clock.now())
    peers.publish()


STOPS: dict[str, Callable[[FakePeers], object]] = {
    "stop": lambda peers: peers.supervisor.stop(),
    "servo/stop": stop_by_the_servo,
    "emergency_stop and reset": lambda peers: (
        peers.supervisor.emergency_stop("emergency stop on the topic"),
        peers.supervisor.procedure or peers.supervisor.reset_fault(),
    ),
}


def run_set_in_parts(
    peers: FakePeers, parts: list[list[str]], told: bool, moment: int, stop: Callable[[FakePeers], object]
) -> tuple[int, list[str]]:
    """Run a set in parts, as `bench` does where a damper test may end it, and stop at one of its moments.

    Parameters
    ----------
    told : bool
        Whether the goals tell at how many stops the set was asked for.

    Returns
    -------
    moments : int
        How many there were.
    calls : list of str
        What was asked of the bench after the stop.
    """
    supervisor, call = peers.supervisor, peers.call
    stops = peers.told_stops if told else 0
    moments, calls_before = 0, 0

    def pass_moment(*_arguments: object) -> None:
        nonlocal moments, calls_before
        moments += 1
        if moments == moment:
            peers.call = call  # type: ignore[method-assign]
            stop(peers)
            calls_before = len(peers.calls)

    def call_and_pass(*arguments: Any, **fields: Any) -> Any:
        response = call(*arguments, **fields)
        pass_moment()
        return response

    peers.call = call_and_pass  # type: ignore[method-assign]
    peers.effects["start_experiment"] = lambda: setattr(peers, "state", "done")
    # Each experiment is announced, also where one waits already.
    peers.effects["load_experiment"] = lambda: supervisor.monitor.add_experiment_state("", peers.clock.now())
    for part in parts:
        experiments = [EXPERIMENT.replace("short", name) for name in part]
        with contextlib.suppress(RefusedError):
            supervisor.check_set(experiments, "", 3, stops)
            if told:
                pass_moment()  # the goal is accepted
            if supervisor.run_set(experiments, "", 3, pass_moment, lambda: supervisor.stopped_since(stops)).success:
                pass_moment()  # its result is under way
                continue
        break
    return moments, peers.calls[calls_before:] if moments >= moment else []


def test_a_supervisor_refuses_what_an_earlier_one_was_asked_for() -> None:
    """One that was started again has moved nothing yet, and nobody may have told it of a stop."""
    earlier, later = QuickClock(), QuickClock()
    later.sleep(1.0)
    asked = FakePeers(earlier).told_stops
    with pytest.raises(RefusedError, match="somebody stopped the bench before this run"):
        FakePeers(later).supervisor.check_set([EXPERIMENT], "", 3, asked)


@pytest.mark.parametrize("way", STOPS)
@pytest.mark.parametrize(("parts", "told"), [([["first", "second"]], False), ([["first"], ["second"]], True)])
def test_no_run_of_a_set_begins_after_a_stop_at_any_moment(parts: list[list[str]], told: bool, way: str) -> None:
    count, calls = run_set_in_parts(quick_peers(), parts, told, 0, STOPS[way])
    assert calls.count("start_experiment") == 2, "without a stop"
    for moment in range(1, count + 1):
        _, calls = run_set_in_parts(quick_peers(), parts, told, moment, STOPS[way])
        assert not {"servo/home", "servo/enable True", "start_experiment"} & set(calls), f"moment {moment}: {calls}"


@pytest.mark.parametrize(
    ("experiments", "message"),
    [
        ([], "the set has no experiments"),
        (["name: x"], "experiment 1: duration_s is missing"),
        ([EXPERIMENT, EXPERIMENT], "experiment 2: another one of the set has the name short"),
        ([EXPERIMENT.replace("short", "there")], "there: exists already and is not overwritten"),
        ([EXPERIMENT.replace("short", "in_a_file")], "set/in_a_file: cannot be made, because"),
    ],
)
def test_an_unusable_set_is_refused_before_anything_is_asked_of_the_bench(
    peers: FakePeers, tmp_path: Path, experiments: list[str], message: str
) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "set").write_text("a file where the folder of the bags should be")
    folder = tmp_path / "set" if "in_a_file" in "".join(experiments) else tmp_path
    outcome = peers.supervisor.run_set(experiments, str(folder), 3, lambda *_progress: None, never_cancelled)
    assert not outcome.success
    assert message in outcome.message
    assert peers.calls == []


def test_a_bag_without_a_name_goes_into_the_configured_folder(peers: FakePeers) -> None:
    bags: list[str] = []
    peers.effects["start_experiment"] = lambda: setattr(peers, "state", "done")
    call = peers.call

    def note(service: str, *arguments: Any, **fields: Any) -> Any:
        bags.extend([fields["bag"]] if "bag" in fields else [])
        return call(service, *arguments, **fields)

    peers.call = note  # type: ignore[method-assign]
    peers.supervisor.run_experiment(EXPERIMENT, "", 3, lambda *_progress: None, never_cancelled)
    assert Path(bags[-1]).parent == Path("runs").resolve()
    assert Path(bags[-1]).name.startswith("short-")
    bags.clear()
    outcome = peers.supervisor.run_experiment(
        EXPERIMENT.replace("short", "../x"), "", 3, lambda *_progress: None, never_cancelled
    )
    assert not outcome.success
    assert "'../x'" in outcome.message
    assert bags == []


def test_a_supervisor_that_was_stalled_blames_itself(peers: FakePeers, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time goes on by 3 s, in which this process neither received nor checked anything."""
    now = peers.clock.now

    def freeze() -> None:
        monkeypatch.setattr(peers.clock, "now", lambda: now() + 3.0)

    peers.effects["start_experiment"] = freeze
    outcome = run(peers)
    assert not outcome.success
    assert outcome.message.startswith("the supervisor was stalled for 3.")
    assert peers.emergency_stops[0]
    assert peers.supervisor.mode.current is Mode.FAULT


def test_a_daq_that_stops_by_itself_stops_the_run(peers: FakePeers) -> None:
    def press() -> None:
        peers.supervisor.monitor.daq_problem = "emergency stop by its service; call reset_fault"

    peers.effects["start_experiment"] = press
    outcome = run(peers)
    assert outcome.message.startswith("interlock daq fault: emergency stop by its service; call reset_fault")
    assert peers.supervisor.mode.current is Mode.FAULT
    peers.effects["daq/reset_fault"] = press
    with pytest.raises(RefusedError, match="still in fault after the reset"):
        peers.supervisor.reset_fault()
    del peers.effects["daq/reset_fault"]
    assert peers.supervisor.reset_fault().startswith("reset; ")


@pytest.mark.parametrize(
    ("disturb", "line"),
    [
        (lambda peers: setattr(peers, "rate", 500.0), "daq: somebody changed the sample rate to 500 Hz"),
        (
            lambda peers: setattr(peers, "servo", dataclasses.replace(peers.servo, enabled=False)),
            "servo: somebody stopped the rod during the run (by servo/stop or servo/enable)",
        ),
    ],
)
def test_whatever_spoils_a_run_ends_it(peers: FakePeers, disturb: Callable[[FakePeers], None], line: str) -> None:
    peers.effects["start_experiment"] = lambda: disturb(peers)
    outcome = run(peers)
    assert not outcome.success
    assert outcome.message == line
    assert peers.supervisor.mode.current is Mode.IDLE


def test_a_recorder_that_falls_silent_ends_the_homing_of_a_run(peers: FakePeers) -> None:
    def home() -> None:
        peers.servo = dataclasses.replace(peers.servo, homed=False, enabled=True)  # it takes its time
        peers.recorder = ""

    peers.effects["servo/home"] = home
    begin = peers.clock.now()
    outcome = run(peers)
    assert outcome.message.startswith("recorder: has been silent for 0.8"), outcome.message
    assert peers.clock.now() - begin < 5.0
    assert "start_recording" not in peers.calls
    assert peers.calls[-1:] == ["servo/rest"]


def test_a_recorder_that_ends_as_it_begins_is_named(peers: FakePeers) -> None:
    """It has answered, and was terminated before it said that it records."""
    peers.effects["start_recording"] = lambda: setattr(peers, "recorder", "")
    outcome = run(peers)
    assert outcome.message.startswith("recorder: has been silent for 0.8"), outcome.message
    assert "start_experiment" not in peers.calls


def test_an_experiment_that_somebody_else_loaded_is_not_run(peers: FakePeers) -> None:
    peers.effects["start_recording"] = lambda: peers.supervisor.monitor.add_experiment_state("loaded", peers.clock.now())
    outcome = run(peers)
    assert outcome.message.startswith("generator: somebody has loaded another experiment")
    assert "start_experiment" not in peers.calls


def test_an_experiment_that_somebody_else_loads_while_the_bench_arms_moves_nothing(peers: FakePeers) -> None:
    """Afterwards, anybody could start it: it would be what the lease of the run lets the rod follow."""
    set_rate = peers.set_sample_rate

    def load(*arguments: Any) -> None:
        set_rate(*arguments)
        peers.supervisor.monitor.add_experiment_state("loaded", peers.clock.now())

    peers.set_sample_rate = load  # type: ignore[method-assign]
    outcome = run(peers)
    assert outcome.message.startswith("generator: somebody has loaded another experiment")
    assert [mode for mode, _ in peers.modes] == [Mode.IDLE, Mode.HOMING, Mode.IDLE]
    assert "servo/home" not in peers.calls


def test_an_experiment_that_somebody_else_starts_during_the_tare_ends_at_once(peers: FakePeers) -> None:
    peers.refusals["daq/tare"] = "position is not at rest"
    call = peers.call

    def start(service: str, *arguments: Any, **fields: Any) -> Any:
        if service == "daq/tare":
            peers.state = "running"
        peers.supervisor.monitor.add_setpoint(peers.clock.now())
        return call(service, *arguments, **fields)

    peers.call = start  # type: ignore[method-assign]
    begin = peers.clock.now()
    outcome = run(peers)
    assert outcome.message.startswith("generator: somebody has started the experiment before its recording")
    assert peers.clock.now() - begin < 3.0
    assert peers.calls[-1:] == ["servo/rest"]


def test_an_abort_of_the_experiment_ends_the_homing(peers: FakePeers) -> None:
    def home() -> None:
        peers.servo = dataclasses.replace(peers.servo, homed=False, enabled=True)  # it takes its time
        peers.supervisor.monitor.add_experiment_state("aborted: on request", peers.clock.now())
        peers.state = "aborted"

    peers.effects["servo/home"] = home
    begin = peers.clock.now()
    outcome = run(peers)
    assert outcome.message == "the generator aborted the experiment before its start; on request"
    assert peers.clock.now() - begin < 3.0


@pytest.mark.parametrize("by_supervisor", [False, True])
@pytest.mark.parametrize("homed", [False, True])
def test_a_stop_while_the_machine_is_measured_is_not_followed_by_a_drive_that_is_switched_on(
    peers: FakePeers, monkeypatch: pytest.MonkeyPatch, by_supervisor: bool, homed: bool
) -> None:
    """The next request was sent first, and only then somebody asked whether a stop had come."""
    supervisor = peers.supervisor
    peers.servo = dataclasses.replace(peers.servo, homed=homed)

    def stop(_now: float) -> str:
        if by_supervisor:
            supervisor.stop()
        peers.servo = dataclasses.replace(peers.servo, halt_time=peers.clock.now())
        return ""

    monkeypatch.setattr(supervisor._punctuality, "problem", stop)
    run(peers)
    assert not {"servo/home", "servo/enable True"} & set(peers.calls), peers.calls


def test_a_refused_reset_of_an_idle_bench_stops_nothing(peers: FakePeers) -> None:
    peers.force = 900.0
    peers.publish()
    with pytest.raises(RefusedError, match="not reset, force: 900 N"):
        peers.supervisor.reset_fault()
    assert peers.emergency_stops == []
    assert peers.supervisor.mode.current is Mode.IDLE


def press_servo(peers: FakePeers) -> None:
    """Its emergency stop came before the reset, which has erased it."""
    peers.servo = dataclasses.replace(peers.servo, halt_time=peers.clock.now())


def press_daq(peers: FakePeers) -> None:
    for _ in range(2):  # it tells again what it has told
        peers.supervisor.monitor.add_daq_problem("emergency stop; call reset_fault")
    peers.supervisor.monitor.add_daq_problem("")


def press_daq_that_has_no_problem(peers: FakePeers) -> None:
    """It was reset before, as a converter is that failed, or has been started anew."""
    peers.supervisor.monitor.add_daq_problem("")
    peers.supervisor.monitor.add_daq_problem("emergency stop; call reset_fault")
    peers.supervisor.monitor.add_daq_problem("")


@pytest.mark.parametrize("fault", [True, False])
@pytest.mark.parametrize("press", [press_servo, press_daq, press_daq_that_has_no_problem])
def test_a_button_of_servo_or_daq_is_not_erased_by_a_reset(
    peers: FakePeers, press: Callable[[FakePeers], None], fault: bool
) -> None:
    if fault:
        peers.supervisor.emergency_stop("interlock")
    peers.effects["servo/reset_fault"] = lambda: press(peers)
    with pytest.raises(RefusedError, match="a stop came during the reset"):
        peers.supervisor.reset_fault()
    assert peers.emergency_stops[-1]
    assert peers.supervisor.mode.current is Mode.FAULT
    del peers.effects["servo/reset_fault"]
    assert peers.supervisor.reset_fault().startswith("reset; ")


@pytest.mark.parametrize("presses", [0, 1])
def test_what_the_daq_tells_late_of_the_stop_that_is_reset_is_no_new_stop(peers: FakePeers, presses: int) -> None:
    """Whoever resets at once was refused: the DAQ had not told of the stop when the reset began."""

    def tell() -> None:
        for _ in range(1 + presses):
            peers.supervisor.monitor.add_daq_problem("emergency stop")

    peers.supervisor.emergency_stop("emergency stop by the service")
    peers.supervisor.monitor.add_daq_problem("")  # as before the stop
    peers.effects["servo/reset_fault"] = tell
    if presses:
        with pytest.raises(RefusedError, match="a stop came during the reset"):
            peers.supervisor.reset_fault()
    else:
        assert peers.supervisor.reset_fault().startswith("reset; ")


def test_an_emergency_stop_at_the_very_end_of_a_reset_is_not_erased_by_it(peers: FakePeers) -> None:
    peers.supervisor.emergency_stop("interlock")
    send, supervisor = peers._on_emergency_stop, peers.supervisor

    def press(stop: bool) -> None:
        send(stop)
        if not stop:
            supervisor.emergency_stop("emergency stop by the service")

    supervisor._send_emergency_stop = press
    with pytest.raises(RefusedError, match="a stop came during the reset"):
        supervisor.reset_fault()
    assert peers.modes[-1] == (Mode.FAULT, "a stop came during the reset")
    assert peers.servo.stopped


def test_a_stop_ends_a_control_by_hand_also_beside_a_request_that_is_refused(
    peers: FakePeers, monkeypatch: pytest.MonkeyPatch
) -> None:
    peers.supervisor.control()
    stopped, refused = threading.Event(), threading.Event()
    require_idle = peers.supervisor.mode.require_idle

    def take_long() -> None:
        try:
            require_idle()
        finally:
            stopped.wait(2)

    monkeypatch.setattr(peers.supervisor.mode, "require_idle", take_long)

    def ask() -> None:
        with pytest.raises(RefusedError, match="the bench is in mode"):
            peers.supervisor.home()
        refused.set()

    peers.effects["servo/rest"] = lambda: (threading.Thread(target=ask).start(), time.sleep(0.1))
    assert peers.supervisor.stop() == "stopped"
    assert peers.supervisor.mode.current is Mode.IDLE
    stopped.set()
    assert refused.wait(5)


@pytest.mark.parametrize("peers", [{"control_timeout": 0.5}], indirect=True)
def test_a_control_by_hand_without_setpoints_ends(peers: FakePeers) -> None:
    """Somebody who has forgotten it must not find a bench that moves hours later."""
    monitor, mode = peers.supervisor.monitor, peers.supervisor.mode
    monitor.add_setpoint(peers.clock.now())
    time.sleep(0.6)  # what came before the control does not count, nor does the time since then
    peers.supervisor.control()
    for _ in range(16):
        time.sleep(0.05)
        assert mode.current is Mode.CONTROL, mode.reason
        monitor.add_setpoint(peers.clock.now())
    for _ in range(20):  # nobody follows these, whose stamps are old
        time.sleep(0.05)
        monitor.add_setpoint(peers.clock.now(), lag=1.0)
    assert peers.modes[-1] == (Mode.IDLE, "no setpoint to follow came for 0.5 s; call control again")
    assert not peers.emergency_stops
    # Who sends none at all has as long.
    peers.supervisor.control()
    begin = peers.clock.now()
    while mode.current is Mode.CONTROL and peers.clock.now() < begin + 5:
        time.sleep(0.01)
    assert 0.4 < peers.clock.now() - begin < 2.0


def test_a_generator_that_runs_for_nobody_ends_no_control_by_hand(peers: FakePeers) -> None:
    peers.state = "running"
    assert peers.supervisor.control().startswith("the rod follows setpoints")
    time.sleep(0.3)
    assert peers.supervisor.mode.current is Mode.CONTROL, peers.supervisor.mode.reason
