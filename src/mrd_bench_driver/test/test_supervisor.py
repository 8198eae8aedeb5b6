"""The supervisor as a process, with fakes of servo, DAQ, generator and recorder."""

import array
import re
import signal
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from mrd_base.nodes.graph import COMMAND, LATCHED, RECORDED, REFUSALS
from mrd_bench_driver.nodes.supervisor import SupervisorNode
from mrd_bench_driver.supervision.modes import BenchMode, Mode
from mrd_interfaces.action import RunExperiment, RunSet
from mrd_interfaces.msg import BenchSamples, BenchState, Lease, ServoState, Setpoint
from mrd_interfaces.srv import LoadExperiment, StartRecording, StopRecording

pytestmark = pytest.mark.realtime

PATIENCE = 1.0  # s, of `graph`
EXPERIMENT = "{name: short, duration_s: 0.5, rate_hz: 1000, rod: {waveform: constant}}"
SET = [EXPERIMENT.replace("short", name) for name in ("01_a", "02_b", "03_c")]
ALL = ("servo", "daq", "generator", "recorder")


def phase(feedback: Any) -> str:
    """Phase of an experiment, preceded in a set by its number and name."""
    prefix = f"{feedback.number} {feedback.experiment} " if isinstance(feedback, RunSet.Feedback) else ""
    return prefix + str(feedback.phase)


class Fakes:
    """Fakes of the other nodes. They do what they are asked, note it, and can be broken."""

    def __init__(self, graph: Any, peers: tuple[str, ...] = ALL) -> None:
        self.graph = graph
        self.calls: list[str] = []
        self.stops: list[tuple[float, bool]] = []
        self.ticks = 0
        self.restore()
        node = graph.node
        self._samples = node.create_publisher(BenchSamples, "samples", RECORDED)
        self._servo = node.create_publisher(ServoState, "servo_state", RECORDED)
        self._setpoint = node.create_publisher(Setpoint, "setpoint", COMMAND)
        self._experiment = node.create_publisher(String, "experiment_state", LATCHED)
        self.recorder_state = node.create_publisher(DiagnosticStatus, "recorder_state", LATCHED)
        self.emergency_stop = node.create_publisher(Bool, "emergency_stop", LATCHED)
        node.create_subscription(Bool, "emergency_stop", self._on_stop, LATCHED)
        self.refusals: list[String] = graph.subscribe(REFUSALS.name, REFUSALS.type, REFUSALS.qos)
        self.states: list[BenchState] = graph.subscribe("bench_state", BenchState, LATCHED)
        self.leases: list[Lease] = graph.subscribe("lease", Lease, COMMAND)
        services: dict[str, dict[str, tuple[Any, Callable[[Any, Any], None]]]] = {
            "servo": {
                "servo/enable": (SetBool, self._enable),
                "servo/home": (Trigger, self._home),
                "servo/rest": (Trigger, self._rest),
                "servo/reset_fault": (Trigger, self._reset_servo),
            },
            "daq": {
                "daq/tare": (Trigger, self._nothing),
                "daq/reset_fault": (Trigger, self._nothing),
                "daq/set_parameters": (SetParameters, self._set_rate),
            },
            "generator": {
                "load_experiment": (LoadExperiment, self._load),
                "start_experiment": (Trigger, self._start),
                "abort_experiment": (Trigger, self._abort),
            },
            "recorder": {
                "start_recording": (StartRecording, self._start_recording),
                "stop_recording": (StopRecording, self._stop_recording),
            },
        }
        for peer in peers:
            for name, (kind, work) in services[peer].items():
                node.create_service(kind, name, self._serve(name, work))
        node.create_timer(0.02, self._tick)
        self.action = ActionClient(node, RunExperiment, "run_experiment")
        self.set_action = ActionClient(node, RunSet, "run_set")

    def restore(self) -> None:
        """Repair everything; the rod is not homed."""
        self.force, self.position, self.rate, self.sequence = 100.0, -1e-3, 100.0, 0
        self.current = 0.0
        self.sampling = self.reporting = self.generating = True
        self.hears = True  # whether the generator hears the lease
        self.servo = ServoState(connected=True, position=float("nan"))
        self.bag = {"success": True, "samples": 500, "lost": 0, "duration": 0.5, "bag": "/tmp/bag"}
        self.refusing: dict[str, str] = {}  # message of each service that refuses
        self.planning = 0.0  # wall time in s that the generator takes to plan
        self.meanwhile: dict[str, Callable[[], None]] = {}  # what happens when a service is called
        self.deaf = False  # whether the servo has forgotten the emergency stop that it heard
        self.remaining, self.lag = 0, 0.0  # setpoints to come, and the time in s by which their stamps are behind
        self.recorder_said = "idle", ""

    def reset(self) -> None:
        """Bring the bench to idle, as it is after the start of the supervisor."""
        self.restore()
        self.await_ticks()
        if self.mode() != BenchState.IDLE:
            answer = self.graph.call("reset_fault" if self.mode() == BenchState.FAULT else "stop", Trigger)
            assert answer.success, answer.message
            self.graph.until(lambda: self.mode() == BenchState.IDLE)
            self.restore()
            self.await_ticks()
        self.calls.clear()
        self.stops.clear()

    def await_ticks(self, count: int = 3) -> None:
        """Wait until the supervisor has received what the fakes publish."""
        last = self.ticks + count
        self.graph.until(lambda: self.ticks >= last)

    def _serve(self, name: str, work: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
        def serve(request: Any, response: Any) -> Any:
            self.calls.append(name + (f" {request.data}" if name == "servo/enable" else ""))
            self.meanwhile.get(name, lambda: None)()
            if name in self.refusing:
                response.message = self.refusing[name]
                return response
            if hasattr(response, "success"):
                response.success = True
            work(request, response)
            return response

        return serve

    def _nothing(self, _request: Any, _response: Any) -> None:
        pass

    def _on_stop(self, message: Bool) -> None:
        self.stops.append((self.graph.clock.now(), message.data))
        if message.data and not self.deaf:
            self.servo.stopped, self.servo.enabled, self.servo.velocity = True, False, 0.0
            self._abort(None, None)

    def _enable(self, request: Any, _response: Any) -> None:
        self.servo.enabled = request.data

    def note_halt(self) -> None:
        self.servo.halt_time = self.graph.clock.now()

    def _home(self, _request: Any, _response: Any) -> None:
        self.position = self.servo.position = 0.0
        self.servo.homed = self.servo.enabled = True

    def _rest(self, _request: Any, _response: Any) -> None:
        self.servo.velocity, self.servo.enabled = 0.0, False

    def _reset_servo(self, _request: Any, _response: Any) -> None:
        self.servo.stopped = self.servo.fault = False

    def _set_rate(self, request: Any, response: Any) -> None:
        self.rate, self.sequence = request.parameters[0].value.double_value, 0
        response.results = [SetParametersResult(successful=True)]

    def _load(self, request: Any, response: Any) -> None:
        assert request.experiment.startswith(("{name: ", "name: short"))
        time.sleep(self.planning)
        response.duration, response.rate = 0.5, 1000.0
        self._experiment.publish(String(data="loaded"))

    def _start(self, _request: Any, _response: Any) -> None:
        self.remaining = 25
        self._experiment.publish(String(data="running"))

    def _abort(self, _request: Any, _response: Any) -> None:
        if self.remaining:
            self.remaining = 0
            self._experiment.publish(String(data="aborted"))

    def _start_recording(self, request: Any, _response: Any) -> None:
        self.bag["bag"] = request.bag
        self.tell_recorder_state("recording")

    def tell_experiment(self, state: str) -> None:
        self._experiment.publish(String(data=state))

    def tell_recorder_state(self, state: str, problem: str = "") -> None:
        self.recorder_said = state, problem
        level = DiagnosticStatus.ERROR if problem else DiagnosticStatus.OK
        values = [KeyValue(key="state", value=state)]
        self.recorder_state.publish(DiagnosticStatus(level=level, message=problem or state, values=values))

    def _stop_recording(self, _request: Any, response: Any) -> None:
        self.tell_recorder_state("idle")
        for name, value in self.bag.items():
            setattr(response, name, value)

    def _stamped(self, message: Any, time: float) -> Any:
        message.header.stamp.sec, message.header.stamp.nanosec = int(time), int(time % 1 * 1e9)
        return message

    def _tick(self) -> None:
        now = self.graph.clock.now()
        self.ticks += 1
        self.tell_recorder_state(*self.recorder_said)
        if self.sampling:
            count = max(1, round(0.02 * self.rate))
            columns = {"position": self.position, "force": self.force, "coil_current": self.current, "acceleration": 0.0}
            message = BenchSamples(sample_period=1 / self.rate, sequence=self.sequence)
            for name, value in columns.items():
                setattr(message, name, array.array("d", [value] * count))
            self.sequence += count
            self._samples.publish(self._stamped(message, now - count / self.rate))
        if self.reporting:
            self._servo.publish(self._stamped(self.servo, now))
        if self.remaining and self.generating:
            self._setpoint.publish(self._stamped(Setpoint(lease=self.leases[-1].number * self.hears), now - self.lag))
            self.remaining -= 1
            if not self.remaining:
                self._experiment.publish(String(data="done"))

    # The client

    def send(self, experiment: str = EXPERIMENT) -> Any:
        return self._send(self.action, RunExperiment.Goal(experiment=experiment, bag="/tmp/bag", seed=3))

    def send_set(self, folder: str, experiments: list[str] = SET, stops: int = 0) -> Any:
        return self._send(self.set_action, RunSet.Goal(experiments=experiments, folder=folder, seed=3, stops=stops))

    def _send(self, action: ActionClient, goal: Any) -> Any:
        self.feedback: list[str] = []
        self.refusals.clear()
        self.graph.until(action.server_is_ready, failure=self.graph.log("supervisor"))
        sent = action.send_goal_async(goal, feedback_callback=lambda m: self.feedback.append(phase(m.feedback)))
        self.graph.until(sent.done)
        return sent.result()

    def result(self, handle: Any) -> Any:
        ended = handle.get_result_async()
        self.graph.until(ended.done, failure="the action did not end")
        return ended.result()

    def refusal(self, handle: Any) -> str:
        """Return why a goal was rejected."""
        assert not handle.accepted
        self.graph.until(lambda: self.refusals, failure="no reason came")
        return str(self.refusals.pop(0).data)

    def running(self) -> Any:
        """Send an experiment and wait until it moves the rod."""
        handle = self.send()
        self.graph.until(lambda: 0 < self.remaining < 20)
        return handle

    def mode(self) -> int:
        return int(self.states[-1].mode)


@pytest.fixture
def start(graph: Any) -> Callable[..., Fakes]:
    """Start a supervisor of the test's own."""

    def start(peers: tuple[str, ...] = ALL, **parameters: Any) -> Fakes:
        fakes = Fakes(graph, peers)
        graph.start("supervisor", **parameters)
        graph.until(lambda: fakes.states)
        return fakes

    return start


@pytest.fixture(scope="module")
def shared_fakes(shared_graph: Any) -> Fakes:
    fakes = Fakes(shared_graph)
    # The fakes break one sensor at a time. That its disagreement with the other one is named first is tested elsewhere.
    shared_graph.start("supervisor", **{"interlocks.position_difference_mm": 100.0})
    shared_graph.until(lambda: fakes.states)
    return fakes


@pytest.fixture
def fakes(shared_fakes: Fakes) -> Fakes:
    """The fakes and the supervisor that the tests of this module share, idle and in order."""
    shared_fakes.reset()
    return shared_fakes


STEPS = [
    "load_experiment",
    "daq/set_parameters",
    "servo/home",
    "daq/tare",
    "servo/enable True",
    "start_recording",
    "start_experiment",
]
END_STEPS = ["servo/rest", "stop_recording"]


def test_an_experiment_runs_from_arming_to_the_closed_bag(fakes: Fakes) -> None:
    ended = fakes.result(fakes.send())
    result = ended.result
    assert (ended.status, result.success) == (GoalStatus.STATUS_SUCCEEDED, True), result.message
    assert (result.bag, result.samples, result.lost, result.duration) == ("/tmp/bag", 500, 0, 0.5)
    assert fakes.calls == [*STEPS, *END_STEPS]
    phases = list(dict.fromkeys(fakes.feedback))
    assert phases == [p for p in ("arming", "recording", "running", "stopping", "closing") if p in phases]
    assert "running" in phases
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert [state.mode for state in fakes.states][:1] == [BenchState.IDLE]
    assert not fakes.stops
    # The second run finds the rod homed.
    fakes.calls.clear()
    assert fakes.result(fakes.send()).result.success
    assert fakes.calls == [call for call in [*STEPS, *END_STEPS] if call != "servo/home"]


def test_a_generator_that_plans_for_long_is_asked_once(fakes: Fakes) -> None:
    """It would load the experiment twice, and the second time look like somebody else's."""
    fakes.planning = 2.5  # longer than the time after which other requests are repeated
    result = fakes.result(fakes.send()).result
    assert result.success, result.message
    assert fakes.calls.count("load_experiment") == 1


def breaking(target: str, name: str, value: Any) -> Callable[[Fakes], Callable[[], None]]:
    """Set an attribute of the fakes or of their servo; what it returns puts it back."""

    def break_it(fakes: Fakes) -> Callable[[], None]:
        thing = fakes.servo if target == "servo" else fakes
        before = getattr(thing, name)
        setattr(thing, name, value)
        return lambda: setattr(thing, name, before)

    return break_it


BREAKS = [
    ("force", breaking("fakes", "force", 850.0), "850 N on the load cell, limit ±800 N; reduce"),
    ("stroke", breaking("fakes", "position", 0.0271), "the rod is at 27.10 mm by the LVDT, limit ±26.75 mm"),
    ("current", breaking("fakes", "current", 1.3), "1.300 A through the coil, allowed -0.100 to 1.100 A"),
    ("speed", breaking("servo", "velocity", 0.3), "the rod moves at 300 mm/s by the encoder"),
    ("following error", breaking("servo", "following_error", 0.006), "6.00 mm off its setpoint"),
    ("stale samples", breaking("fakes", "sampling", False), f"limit {1e3 * PATIENCE:.0f} ms; check the daq"),
    ("lost servo", breaking("fakes", "reporting", False), f"limit {1e3 * PATIENCE:.0f} ms; check the servo node"),
    ("lost servo", breaking("servo", "connected", False), "the motor does not answer; check its power"),
    ("servo fault", breaking("servo", "fault", True), "the motor or its driver stopped"),
    ("stale setpoint", breaking("fakes", "generating", False), f"limit {1e3 * PATIENCE:.0f} ms; check the generator"),
    # A generator whose time is ahead by more than its stall_s takes every lease for an old one.
    ("stale setpoint", breaking("fakes", "hears", False), f"limit {1e3 * PATIENCE:.0f} ms; check the generator"),
]


def test_each_interlock_stops_the_bench_at_once_and_closes_the_bag(fakes: Fakes) -> None:
    for name, break_it, line in BREAKS:
        handle = fakes.running()
        fakes.remaining = 10_000  # so that the run does not end first
        fakes.calls.clear()
        fakes.stops.clear()
        repair = break_it(fakes)
        broken = fakes.graph.clock.now()
        fakes.graph.until(lambda: fakes.stops, timeout=5.0)
        assert fakes.stops[0][1], name
        # What a busy machine needs, beside the patience.
        assert fakes.stops[0][0] - broken < PATIENCE + 0.5, name
        ended = fakes.result(handle)
        assert ended.status == GoalStatus.STATUS_ABORTED
        assert ended.result.message.startswith(f"interlock {name}: ")
        assert line in ended.result.message
        assert ended.result.bag == "/tmp/bag"
        assert fakes.calls == [END_STEPS[0], "abort_experiment", END_STEPS[1]], name
        assert fakes.mode() == BenchState.FAULT
        assert fakes.states[-1].message == ended.result.message
        repair()
        fakes.position = 0.0
        fakes.await_ticks()
        answer = fakes.graph.call("reset_fault", Trigger)
        assert answer.success, answer.message
        fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)


@pytest.mark.parametrize(("lag", "when"), [(3.0, "before"), (-3.0, "after")])
def test_setpoints_that_nobody_follows_for_their_stamps_end_the_run(fakes: Fakes, lag: float, when: str) -> None:
    """The rod would stand, and the run end as a success."""
    handle = fakes.running()
    fakes.lag, fakes.remaining = lag, 120
    message = fakes.result(handle).result.message
    stamped = rf"those of the generator are stamped (3|2\.9\d|3\.0\d) s {when} they come"
    assert re.match(rf"interlock stale setpoint: the latest setpoint is \d+ ms old, limit 1000 ms; {stamped}", message), (
        message
    )


def test_a_stop_latches_until_reset_fault_finds_the_inputs_healthy(fakes: Fakes) -> None:
    handle = fakes.running()
    fakes.force = 900.0
    fakes.result(handle)
    assert [on for _, on in fakes.stops] == [True]
    # Neither time, nor a False on the topic, nor a new order takes it back.
    fakes.emergency_stop.publish(Bool(data=False))
    fakes.calls.clear()
    refusal = fakes.refusal(fakes.send())
    assert "the bench is in mode fault (interlock force" in refusal
    assert "call reset_fault" in refusal
    assert not fakes.graph.call("home", Trigger).success
    assert not fakes.graph.call("control", SetBool, data=True).success
    assert fakes.calls == []
    refused = fakes.graph.call("reset_fault", Trigger)
    assert not refused.success
    assert refused.message.startswith("not reset, force: 900 N on the load cell")
    assert fakes.stops[-1][1]
    assert fakes.mode() == BenchState.FAULT
    assert "servo/reset_fault" not in fakes.calls

    fakes.force = 100.0
    answer = fakes.graph.call("reset_fault", Trigger)
    assert answer.success, answer.message
    fakes.graph.until(lambda: not fakes.stops[-1][1] and fakes.mode() == BenchState.IDLE)
    assert fakes.calls == ["servo/reset_fault", "daq/reset_fault"]
    fakes.await_ticks()
    assert fakes.mode() == BenchState.IDLE
    assert not fakes.servo.enabled
    assert fakes.result(fakes.send()).result.success


@pytest.mark.parametrize("way", ["service", "topic"])
def test_anyone_may_stop_the_bench_at_any_time(fakes: Fakes, way: str) -> None:
    handle = fakes.running()
    if way == "service":
        assert fakes.graph.call("emergency_stop", Trigger).success
    else:
        fakes.emergency_stop.publish(Bool(data=True))
    result = fakes.result(handle).result
    assert result.message == f"emergency stop {'by the service' if way == 'service' else 'on the topic'}"
    assert fakes.mode() == BenchState.FAULT
    assert fakes.calls[-3:] == [END_STEPS[0], "abort_experiment", END_STEPS[1]]


def test_a_cancelled_experiment_is_stopped_and_its_bag_closed(fakes: Fakes) -> None:
    handle = fakes.running()
    fakes.calls.clear()
    fakes.graph.until(handle.cancel_goal_async().done)
    ended = fakes.result(handle)
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert (ended.result.message, ended.result.samples) == ("cancelled by stop or through its goal", 500)
    assert fakes.calls == [END_STEPS[0], "abort_experiment", END_STEPS[1]]
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert not fakes.stops


def test_stop_ends_an_experiment_and_control(fakes: Fakes) -> None:
    handle = fakes.running()
    assert fakes.graph.call("stop", Trigger).success
    assert fakes.result(handle).result.message == "cancelled by stop or through its goal"
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)

    assert fakes.graph.call("control", SetBool, data=True).success
    fakes.graph.until(lambda: fakes.mode() == BenchState.CONTROL)
    assert fakes.servo.enabled
    assert fakes.refusal(fakes.send()) == "run_experiment: the bench is in mode control (control); call stop first"
    assert fakes.servo.enabled
    assert fakes.graph.call("stop", Trigger).success
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert not fakes.servo.enabled

    # The interlocks watch in control, too.
    assert fakes.graph.call("control", SetBool, data=True).success
    fakes.force = -900.0
    fakes.graph.until(lambda: fakes.mode() == BenchState.FAULT)
    assert fakes.stops[-1][1]


LONG_NAME = "/tmp/" + 300 * "a"


def test_a_goal_with_an_impossible_name_is_refused_and_deafens_nobody(fakes: Fakes) -> None:
    goal = RunExperiment.Goal(experiment=EXPERIMENT, bag=LONG_NAME)
    assert fakes.refusal(fakes._send(fakes.action, goal)).endswith("aaa: cannot be used (File name too long)")
    refusal = fakes.refusal(fakes.send_set(LONG_NAME))
    assert refusal.endswith("01_a: cannot be used (File name too long)"), refusal
    for _ in range(3):
        assert fakes.graph.call("stop", Trigger).success


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_supervisor_whose_requests_nobody_serves_any_more_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would go on renewing the lease of a bench that hears no stop."""
    signals: list[int] = []
    monkeypatch.setattr("sys.argv", ["supervisor"])
    monkeypatch.setattr("os.kill", lambda _process, number: signals.append(number))
    rclpy.init(args=["--ros-args", "-r", "__ns:=/deaf"])
    node = SupervisorNode()
    for _ in range(2):  # the executor looks at the errors of a request when the next one comes
        node._request_executor.create_task(lambda: 1 / 0)
    end = time.monotonic() + 5
    while not signals and time.monotonic() < end:
        time.sleep(0.01)
    node.close()
    node.destroy_node()
    rclpy.shutdown()
    assert signals == [signal.SIGTERM]


class SlowMode(BenchMode):
    """It lets another thread work for a while between any two changes of what it is."""

    threads: list[threading.Thread]

    def __init__(self, meanwhile: Callable[[], None]) -> None:
        object.__setattr__(self, "_meanwhile", lambda: None)
        object.__setattr__(self, "threads", [])
        super().__init__(lambda _mode: None)
        object.__setattr__(self, "_meanwhile", meanwhile)

    def __setattr__(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)
        self.threads.append(threading.Thread(target=self._meanwhile))
        self.threads[-1].start()
        self.threads[-1].join(0.05)


def test_a_renewal_during_a_change_has_mode_and_number_of_one_instant(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lease that lets the rod follow the number 0 would let it follow whoever gives none."""
    monkeypatch.setattr("sys.argv", ["supervisor"])
    rclpy.init(args=["--ros-args", "-r", "__ns:=/changing"])
    node = SupervisorNode()
    leases: list[Lease] = []
    monkeypatch.setattr(node, "_lease", SimpleNamespace(publish=leases.append))
    mode = SlowMode(lambda: node._renew_lease(mode))
    for new in (Mode.HOMING, Mode.IDENTIFICATION):
        mode.enter(new, "run_experiment")
        node._renew_lease(mode)
    mode.leave("stopped")
    for thread in mode.threads:
        thread.join()
    node.close()
    node.destroy_node()
    rclpy.shutdown()
    assert Mode.IDENTIFICATION in {lease.mode for lease in leases}
    assert [lease for lease in leases if Mode(lease.mode).takes_setpoints is not (lease.number > 0)] == []


@pytest.mark.parametrize("step", STEPS[:3])
def test_a_stop_of_a_rod_that_does_not_move_yet_ends_the_procedure(fakes: Fakes, step: str) -> None:
    """The servo answers that it has stopped; what it then forgets, the supervisor must not."""
    fakes.meanwhile[step] = fakes.note_halt
    result = fakes.result(fakes.send()).result
    # It may come before the homing, or after it has begun.
    expected = tuple(f"servo: somebody stopped the {what}" for what in ("rod before the run", "homing"))
    assert result.message.startswith(expected), result.message
    assert "start_experiment" not in fakes.calls
    fakes.meanwhile.clear()
    assert fakes.result(fakes.send()).result.success, "the stop is over with the procedure"


@pytest.mark.parametrize("step", END_STEPS)
def test_a_stop_between_two_runs_ends_their_set(fakes: Fakes, step: str, tmp_path: Any) -> None:
    """It may come at the very moment at which the supervisor itself lets the rod rest."""
    fakes.meanwhile[step] = fakes.note_halt
    result = fakes.result(fakes.send_set(str(tmp_path))).result
    assert result.message.startswith("02_b: servo: somebody stopped the rod"), result.message
    assert [recording.experiment for recording in result.recordings] == ["01_a"]


@pytest.mark.parametrize("moment", ["closing", "ended", "sent"])
def test_a_stop_around_the_end_of_a_part_of_a_set_ends_the_set(fakes: Fakes, moment: str, tmp_path: Any) -> None:
    """The next part is sent as soon as the result of the one before is there, as by `bench`."""
    graph, stops = fakes.graph, fakes.states[-1].stops
    client = graph.node.create_client(Trigger, "stop")
    graph.until(client.service_is_ready)
    stopped: list[Any] = []

    def stop() -> None:
        stopped.append(client.call_async(Trigger.Request()))

    if moment == "closing":
        fakes.meanwhile["stop_recording"] = stop
    assert fakes.result(fakes.send_set(str(tmp_path), SET[:1], stops)).result.success
    if moment == "ended":
        stop()
    following = fakes.send_set(str(tmp_path), SET[1:2], stops)
    if moment == "sent":
        stop()
    graph.until(stopped[0].done)
    calls = len(fakes.calls)
    if following.accepted:
        assert not fakes.result(following).result.success
    else:
        assert "somebody stopped the bench before this run" in fakes.refusal(following)
    assert not {"servo/home", "servo/enable True", "start_experiment"} & set(fakes.calls[calls:])
    graph.until(lambda: fakes.states[-1].stops > stops)
    client.destroy()


def test_an_abort_before_the_start_ends_the_run(fakes: Fakes) -> None:
    fakes.meanwhile["servo/home"] = lambda: fakes.tell_experiment("aborted: on request")
    result = fakes.result(fakes.send()).result
    assert result.message.startswith("the generator aborted the experiment before its start; on request"), result.message
    assert "start_experiment" not in fakes.calls


def test_an_emergency_stop_during_the_reset_is_not_erased_by_it(fakes: Fakes) -> None:
    assert fakes.graph.call("emergency_stop", Trigger).success
    fakes.graph.until(lambda: fakes.servo.stopped)
    fakes.await_ticks(10)  # longer than the supervisor takes what it hears for its own stop
    fakes.deaf = True  # the servo has heard it before it was reset
    fakes.meanwhile["daq/reset_fault"] = lambda: fakes.emergency_stop.publish(Bool(data=True))
    fakes.meanwhile["servo/reset_fault"] = lambda: fakes.emergency_stop.publish(Bool(data=True))
    answer = fakes.graph.call("reset_fault", Trigger)
    assert not answer.success
    assert answer.message.startswith("a stop came during the reset"), answer.message
    assert fakes.mode() == BenchState.FAULT


def test_the_lease_names_whose_setpoints_are_followed(fakes: Fakes) -> None:
    handle = fakes.running()
    assert fakes.leases[-1].source == "generator"
    fakes.result(handle)
    assert fakes.graph.call("control", SetBool, data=True).success
    fakes.graph.until(lambda: fakes.leases[-1].mode == BenchState.CONTROL)
    assert (fakes.leases[-1].source, fakes.leases[-1].number > 0) == ("", True)


def test_a_stop_of_the_servo_ends_a_control_by_hand(fakes: Fakes) -> None:
    assert fakes.graph.call("control", SetBool, data=True).success
    fakes.graph.until(lambda: fakes.mode() == BenchState.CONTROL)
    fakes.note_halt()
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert fakes.states[-1].message.startswith("somebody stopped the rod")
    fakes.graph.until(lambda: fakes.leases[-1].number == 0)


def test_what_is_missing_refuses_the_experiment_before_anything_moves(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start(("servo", "daq", "recorder"), discovery_timeout_s=0.3)
    result = fakes.result(fakes.send()).result
    assert result.message.startswith("not there: generator (no service ")
    assert fakes.calls == []
    # Homing needs no generator.
    assert graph.call("home", Trigger).success
    assert fakes.calls == ["servo/home", "servo/rest"]
    graph.until(lambda: fakes.mode() == BenchState.IDLE)


@pytest.mark.parametrize(
    ("service", "done"), [("load_experiment", 1), ("servo/home", 3), ("start_recording", 6), ("start_experiment", 7)]
)
def test_a_peer_that_refuses_ends_the_experiment(fakes: Fakes, service: str, done: int) -> None:
    fakes.refusing[service] = "because"
    result = fakes.result(fakes.send()).result
    assert result.message.endswith(": because")
    assert fakes.calls[:done] == STEPS[:done]
    assert not set(STEPS[done:]) & set(fakes.calls)
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert not fakes.servo.enabled


def test_lost_samples_are_reported(fakes: Fakes) -> None:
    fakes.bag.update(success=False, message="20 samples are missing", lost=20, samples=480)
    ended = fakes.result(fakes.send())
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert (ended.result.message, ended.result.lost) == ("20 samples are missing", 20)


def test_a_recording_that_fails_ends_the_experiment_at_once(fakes: Fakes) -> None:
    failure = "/tmp/bag: cannot be written (No space left on device)"
    fakes.tell_recorder_state("recording")
    handle = fakes.running()
    fakes.remaining = 10_000
    fakes.calls.clear()
    fakes.bag.update(success=False, message=failure)
    told = fakes.graph.clock.now()
    fakes.tell_recorder_state("failed", failure)
    fakes.graph.until(lambda: fakes.calls, timeout=5.0)
    assert fakes.graph.clock.now() - told < 1.5
    ended = fakes.result(handle)
    assert (ended.status, ended.result.message) == (GoalStatus.STATUS_ABORTED, failure)
    assert fakes.calls == [END_STEPS[0], "abort_experiment", END_STEPS[1]]
    fakes.tell_recorder_state("idle")
    fakes.reset()
    assert fakes.result(fakes.send()).result.success


def test_nothing_is_armed_on_stale_inputs(start: Callable[..., Fakes]) -> None:
    fakes = start(answer_timeout_s=0.3)
    fakes.servo.connected = False
    fakes.await_ticks()
    result = fakes.result(fakes.send()).result
    assert result.message.startswith("not armed, lost servo: the motor does not answer")
    assert fakes.calls == STEPS[:2]


def test_a_supervisor_that_is_ended_stops_the_bench_first(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start()
    fakes.running()
    process = graph.process("supervisor")
    process.terminate()
    graph.until(lambda: fakes.stops and fakes.stops[-1][1], timeout=3.0)
    graph.until(lambda: process.poll() is not None)
    assert process.returncode == 0
    assert "Traceback" not in graph.log("supervisor")


def test_a_stop_that_another_supervisor_left_is_seen(fakes: Fakes) -> None:
    fakes.servo.stopped = True
    fakes.graph.until(lambda: fakes.mode() == BenchState.FAULT)
    assert fakes.states[-1].message == "servo: its emergency stop is latched; call reset_fault"


def test_a_set_is_recorded_by_one_order_each_run_in_its_own_bag(fakes: Fakes, tmp_path: Any) -> None:
    # What an action publishes before its client is matched is lost: orders that are refused, until one of them is heard.
    fakes.refusing["load_experiment"] = "not yet"
    while True:
        assert not fakes.result(fakes.send_set(str(tmp_path))).result.success
        if fakes.feedback:
            break
    fakes.refusing.clear()
    fakes.calls.clear()
    ended = fakes.result(fakes.send_set(str(tmp_path)))
    result = ended.result
    assert (ended.status, result.success) == (GoalStatus.STATUS_SUCCEEDED, True), result.message
    assert result.message == "3 runs recorded, none of their samples lost"
    assert [(r.experiment, r.complete, r.bag, r.samples) for r in result.recordings] == [
        (name, True, str(tmp_path / name), 500) for name in ("01_a", "02_b", "03_c")
    ]
    # All are planned before the first moves the rod, which is homed once.
    again = [call for call in STEPS if call != "servo/home"]
    assert fakes.calls == [*["load_experiment"] * 3, *STEPS, *END_STEPS, *again, *END_STEPS, *again, *END_STEPS]
    order = list(dict.fromkeys(fakes.feedback))
    checks = [f"{number} {name} checking" for number, name in enumerate(("01_a", "02_b", "03_c"), 1)]
    assert order[:3] == checks
    assert [line for line in order if "running" in line] == [line.replace("checking", "running") for line in checks]
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)


@pytest.mark.parametrize("way", ["stop", "cancel", "interlock"])
def test_what_stops_a_run_ends_its_set_and_keeps_what_is_recorded(fakes: Fakes, tmp_path: Any, way: str) -> None:
    handle = fakes.send_set(str(tmp_path))
    fakes.graph.until(lambda: "2 02_b running" in fakes.feedback and fakes.remaining > 0)
    fakes.remaining = 10_000  # so that a busy machine does not end the run before it is stopped
    assert fakes.refusal(fakes.send()) == "run_experiment: the bench is busy: run_set; wait for its end or call stop"
    fakes.calls.clear()
    if way == "stop":
        assert fakes.graph.call("stop", Trigger).success
    elif way == "cancel":
        fakes.graph.until(handle.cancel_goal_async().done)
    else:
        fakes.force = 850.0
    ended = fakes.result(handle)
    assert ended.status == (GoalStatus.STATUS_CANCELED if way == "cancel" else GoalStatus.STATUS_ABORTED)
    why = "interlock force" if way == "interlock" else "cancelled"
    assert ended.result.message.startswith(f"02_b: {why}")
    assert ended.result.message.endswith("(completely recorded of 3: 01_a)")
    assert [(r.experiment, r.complete) for r in ended.result.recordings] == [("01_a", True), ("02_b", False)]
    assert fakes.calls[-1] == "stop_recording"
    assert "start_recording" not in fakes.calls
    mode = BenchState.FAULT if way == "interlock" else BenchState.IDLE
    fakes.graph.until(lambda: fakes.mode() == mode)


def test_a_set_that_cannot_be_recorded_as_a_whole_is_refused_before_anything_moves(fakes: Fakes, tmp_path: Any) -> None:
    (tmp_path / "02_b").mkdir()
    for experiments, line in (
        ([], "the set has no experiments"),
        (["name: x"], "experiment 1: duration_s is missing"),
        ([SET[0], SET[0]], "experiment 2: another one of the set has the name 01_a"),
        (SET, "02_b: exists already and is not overwritten"),
    ):
        refusal = fakes.refusal(fakes.send_set(str(tmp_path), experiments))
        assert refusal.startswith("run_set: ")
        assert line in refusal
    assert fakes.calls == []
    fakes.refusing["load_experiment"] = "speed exceeds"
    result = fakes.result(fakes.send_set(str(tmp_path / "new"))).result
    assert result.message == "01_a: generator: speed exceeds (completely recorded of 3: none)"
    assert fakes.calls == ["load_experiment"]


def test_a_goal_may_name_a_file(fakes: Fakes, tmp_path: Any) -> None:
    file = tmp_path / "short.yaml"
    file.write_text(EXPERIMENT)
    ended = fakes.result(fakes.send(str(file)))
    assert ended.result.success, ended.result.message
    refusal = fakes.refusal(fakes.send(str(tmp_path / "shrot.yaml")))
    assert refusal == f"run_experiment: {tmp_path}/shrot.yaml: cannot be read (No such file or directory)"
    assert refusal in fakes.graph.log("supervisor").replace(" is refused: ", ": ")


@pytest.mark.parametrize(
    ("experiment", "line"),
    [
        ("", "experiment: is empty, expected a mapping of names to values"),
        ("{name: short}", "experiment: duration_s is missing"),
        (EXPERIMENT.replace("constant", "sinus"), "experiment: rod: unknown waveform sinus"),
    ],
)
def test_a_bad_goal_is_rejected_and_calls_nobody(fakes: Fakes, experiment: str, line: str) -> None:
    assert fakes.refusal(fakes.send(experiment)).startswith(f"run_experiment: {line}")
    assert fakes.calls == []
