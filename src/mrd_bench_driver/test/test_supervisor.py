"""The supervisor as a process, with servo, daq, generator and recorder played here."""

import array
from collections.abc import Callable
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED
from mrd_interfaces.action import RunExperiment, RunSet
from mrd_interfaces.msg import BenchSamples, BenchState, ServoState, Setpoint
from mrd_interfaces.srv import LoadExperiment, StartRecording, StopRecording

EXPERIMENT = "{name: short, duration_s: 0.5, rate_hz: 1000, rod: {waveform: constant}}"
SET = [EXPERIMENT.replace("short", name) for name in ("01_a", "02_b", "03_c")]
ALL = ("servo", "daq", "generator", "recorder")


def said(feedback: Any) -> str:
    """Phase of an experiment; in a set, with its number and name."""
    which = f"{feedback.number} {feedback.experiment} " if isinstance(feedback, RunSet.Feedback) else ""
    return which + str(feedback.phase)


class Fakes:
    """Peers that do what they are asked, note it, and can be broken."""

    def __init__(self, graph: Any, peers: tuple[str, ...] = ALL) -> None:
        self.graph = graph
        self.calls: list[str] = []
        self.force, self.position, self.rate, self.sequence = 100.0, -1e-3, 100.0, 0
        self.current = 0.0
        self.sampling = self.reporting = self.generating = self.hearing = True
        self.servo = ServoState(connected=True, position=float("nan"))
        self.stop_answer = {"success": True, "samples": 500, "lost": 0, "duration": 0.5, "bag": "/tmp/bag"}
        self.trouble: dict[str, str] = {}  # answer of a service that refuses
        self.remaining = 0
        node = graph.node
        self._samples = node.create_publisher(BenchSamples, "samples", RECORDED)
        self._servo = node.create_publisher(ServoState, "servo_state", RECORDED)
        self._setpoint = node.create_publisher(Setpoint, "setpoint", COMMAND)
        self._experiment = node.create_publisher(String, "experiment_state", LATCHED)
        self.emergency_stop = node.create_publisher(Bool, "emergency_stop", LATCHED)
        self.stops: list[tuple[float, bool]] = []
        node.create_subscription(Bool, "emergency_stop", self._on_stop, LATCHED)
        self.states: list[BenchState] = graph.hear("bench_state", BenchState, LATCHED)
        services: dict[str, dict[str, tuple[Any, Callable[[Any, Any], None]]]] = {
            "servo": {
                "servo/enable": (SetBool, self._enable),
                "servo/home": (Trigger, self._home),
                "servo/stop": (Trigger, self._halt),
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

    def _serve(self, name: str, work: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
        def serve(request: Any, response: Any) -> Any:
            self.calls.append(name + (f" {request.data}" if name == "servo/enable" else ""))
            if name in self.trouble:
                response.message = self.trouble[name]
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
        if message.data and self.hearing:
            self.servo.stopped, self.servo.enabled, self.servo.velocity = True, False, 0.0
            self._abort(None, None)

    def _enable(self, request: Any, _response: Any) -> None:
        self.servo.enabled = request.data

    def _home(self, _request: Any, _response: Any) -> None:
        self.position = self.servo.position = 0.0
        self.servo.homed = self.servo.enabled = True

    def _halt(self, _request: Any, _response: Any) -> None:
        self.servo.velocity = 0.0

    def _reset_servo(self, _request: Any, _response: Any) -> None:
        self.servo.stopped = self.servo.fault = False

    def _set_rate(self, request: Any, response: Any) -> None:
        self.rate, self.sequence = request.parameters[0].value.double_value, 0
        response.results = [SetParametersResult(successful=True)]

    def _load(self, request: Any, response: Any) -> None:
        assert request.experiment in (EXPERIMENT, *SET)
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
        self.stop_answer["bag"] = request.bag

    def _stop_recording(self, _request: Any, response: Any) -> None:
        for name, value in self.stop_answer.items():
            setattr(response, name, value)

    def _stamped(self, message: Any, time: float) -> Any:
        message.header.stamp.sec, message.header.stamp.nanosec = int(time), int(time % 1 * 1e9)
        return message

    def _tick(self) -> None:
        now = self.graph.clock.now()
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
            self._setpoint.publish(self._stamped(Setpoint(), now))
            self.remaining -= 1
            if not self.remaining:
                self._experiment.publish(String(data="done"))

    # What a person does

    def send(self, experiment: str = EXPERIMENT) -> Any:
        return self._send(self.action, RunExperiment.Goal(experiment=experiment, bag="/tmp/bag", seed=3))

    def send_set(self, folder: str, experiments: list[str] = SET) -> Any:
        return self._send(self.set_action, RunSet.Goal(experiments=experiments, folder=folder, seed=3))

    def _send(self, action: ActionClient, goal: Any) -> Any:
        self.feedback: list[str] = []
        self.graph.until(action.server_is_ready, failure=self.graph.log("supervisor"))
        sent = action.send_goal_async(goal, feedback_callback=lambda m: self.feedback.append(said(m.feedback)))
        self.graph.until(sent.done)
        return sent.result()

    def result(self, handle: Any) -> Any:
        ended = handle.get_result_async()
        self.graph.until(ended.done, failure="the action did not end")
        return ended.result()

    def running(self) -> Any:
        """Send an experiment and wait until it moves the rod."""
        handle = self.send()
        self.graph.until(lambda: 0 < self.remaining < 20)
        return handle

    def mode(self) -> int:
        return int(self.states[-1].mode)


@pytest.fixture
def start(graph: Any) -> Callable[..., Fakes]:
    def start(peers: tuple[str, ...] = ALL, **parameters: Any) -> Fakes:
        fakes = Fakes(graph, peers)
        graph.start("supervisor", **parameters)
        graph.until(lambda: fakes.states)
        return fakes

    return start


COURSE = [
    "load_experiment",
    "daq/set_parameters",
    "servo/home",
    "daq/tare",
    "servo/enable True",
    "start_recording",
    "start_experiment",
]
AWAY = ["servo/stop", "servo/enable False", "stop_recording"]


def test_an_experiment_runs_from_arming_to_the_closed_bag(start: Callable[..., Fakes]) -> None:
    fakes = start()
    ended = fakes.result(fakes.send())
    result = ended.result
    assert (ended.status, result.success) == (GoalStatus.STATUS_SUCCEEDED, True), result.message
    assert (result.bag, result.samples, result.lost, result.duration) == ("/tmp/bag", 500, 0, 0.5)
    assert fakes.calls == [*COURSE, *AWAY]
    phases = list(dict.fromkeys(fakes.feedback))
    assert phases == [p for p in ("arming", "recording", "running", "stopping", "closing") if p in phases]
    assert "running" in phases
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert [state.mode for state in fakes.states][:1] == [BenchState.IDLE]
    assert not fakes.stops
    # The second run finds the rod homed.
    fakes.calls.clear()
    assert fakes.result(fakes.send()).result.success
    assert fakes.calls == [call for call in [*COURSE, *AWAY] if call != "servo/home"]


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
    ("stale samples", breaking("fakes", "sampling", False), "limit 140 ms; check the daq"),
    ("lost servo", breaking("fakes", "reporting", False), "limit 150 ms; check the servo node"),
    ("lost servo", breaking("servo", "connected", False), "the motor does not answer; check its power"),
    ("servo fault", breaking("servo", "fault", True), "the motor or its driver stopped"),
    ("stale setpoint", breaking("fakes", "generating", False), "limit 150 ms; check the generator"),
]


def test_each_interlock_stops_the_bench_at_once_and_closes_the_bag(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start()
    for name, break_it, line in BREAKS:
        handle = fakes.running()
        fakes.calls.clear()
        fakes.stops.clear()
        broken = graph.clock.now()
        repair = break_it(fakes)
        graph.until(lambda: fakes.stops, timeout=5.0)
        # 150 ms of patience, a tick of 20 ms, and what a busy machine needs.
        assert fakes.stops[0][1], name
        assert fakes.stops[0][0] - broken < 0.3, name
        ended = fakes.result(handle)
        assert ended.status == GoalStatus.STATUS_ABORTED
        assert ended.result.message.startswith(f"interlock {name}: ")
        assert line in ended.result.message
        assert ended.result.bag == "/tmp/bag"
        assert fakes.calls == [*AWAY[:2], "abort_experiment", AWAY[2]], name
        assert fakes.mode() == BenchState.FAULT
        assert fakes.states[-1].message == ended.result.message
        repair()
        graph.during(0.1)
        fakes.position = 0.0
        answer = graph.call("reset_fault", Trigger)
        assert answer.success, answer.message
        graph.until(lambda: fakes.mode() == BenchState.IDLE)


def test_a_stop_latches_until_reset_fault_finds_the_inputs_healthy(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start()
    handle = fakes.running()
    fakes.force = 900.0
    fakes.result(handle)
    assert [on for _, on in fakes.stops] == [True]
    # Neither time, nor a False on the topic, nor a new order takes it back.
    fakes.emergency_stop.publish(Bool(data=False))
    fakes.calls.clear()
    result = fakes.result(fakes.send()).result
    assert "the bench is in mode fault (interlock force" in result.message
    assert "call reset_fault" in result.message
    assert not graph.call("home", Trigger).success
    assert not graph.call("control", SetBool, data=True).success
    assert fakes.calls == []
    refused = graph.call("reset_fault", Trigger)
    assert not refused.success
    assert refused.message.startswith("not reset, force: 900 N on the load cell")
    assert fakes.stops[-1][1]
    assert fakes.mode() == BenchState.FAULT
    assert "servo/reset_fault" not in fakes.calls

    fakes.force = 100.0
    answer = graph.call("reset_fault", Trigger)
    assert answer.success, answer.message
    graph.until(lambda: not fakes.stops[-1][1] and fakes.mode() == BenchState.IDLE)
    assert fakes.calls == ["servo/reset_fault", "daq/reset_fault"]
    graph.during(0.1)
    assert fakes.mode() == BenchState.IDLE
    assert not fakes.servo.enabled
    assert fakes.result(fakes.send()).result.success


@pytest.mark.parametrize("way", ["service", "topic"])
def test_anyone_may_stop_the_bench_at_any_time(graph: Any, start: Callable[..., Fakes], way: str) -> None:
    fakes = start()
    handle = fakes.running()
    if way == "service":
        assert graph.call("emergency_stop", Trigger).success
    else:
        fakes.emergency_stop.publish(Bool(data=True))
    result = fakes.result(handle).result
    assert result.message == f"emergency stop {'by the service' if way == 'service' else 'on the topic'}"
    assert fakes.mode() == BenchState.FAULT
    assert fakes.calls[-4:] == [*AWAY[:2], "abort_experiment", AWAY[2]]


def test_a_cancelled_experiment_is_stopped_and_its_bag_closed(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start()
    handle = fakes.running()
    fakes.calls.clear()
    graph.until(handle.cancel_goal_async().done)
    ended = fakes.result(handle)
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert (ended.result.message, ended.result.samples) == ("cancelled", 500)
    assert fakes.calls == [*AWAY[:2], "abort_experiment", AWAY[2]]
    graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert not fakes.stops


def test_stop_ends_an_experiment_and_control(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start()
    handle = fakes.running()
    assert graph.call("stop", Trigger).success
    assert fakes.result(handle).result.message == "cancelled"
    graph.until(lambda: fakes.mode() == BenchState.IDLE)

    assert graph.call("control", SetBool, data=True).success
    graph.until(lambda: fakes.mode() == BenchState.CONTROL)
    assert fakes.servo.enabled
    refused = fakes.result(fakes.send()).result
    assert refused.message == "the bench is in mode control (control); call stop first"
    assert fakes.servo.enabled
    assert graph.call("stop", Trigger).success
    graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert not fakes.servo.enabled

    # The interlocks watch in control, too.
    assert graph.call("control", SetBool, data=True).success
    fakes.force = -900.0
    graph.until(lambda: fakes.mode() == BenchState.FAULT)
    assert fakes.stops[-1][1]


def test_what_is_missing_refuses_the_experiment_before_anything_moves(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start(("servo", "daq", "recorder"), discovery_timeout_s=0.3)
    result = fakes.result(fakes.send()).result
    assert result.message.startswith("not there: generator (no service ")
    assert fakes.calls == []
    # Homing needs no generator.
    assert graph.call("home", Trigger).success
    assert fakes.calls == ["servo/home", "servo/stop", "servo/enable False"]
    graph.until(lambda: fakes.mode() == BenchState.IDLE)


@pytest.mark.parametrize(
    ("service", "done"), [("load_experiment", 1), ("servo/home", 3), ("start_recording", 6), ("start_experiment", 7)]
)
def test_a_peer_that_refuses_ends_the_experiment(start: Callable[..., Fakes], service: str, done: int) -> None:
    fakes = start()
    fakes.trouble[service] = "because"
    result = fakes.result(fakes.send()).result
    assert result.message.endswith(": because")
    assert fakes.calls[:done] == COURSE[:done]
    assert not set(COURSE[done:]) & set(fakes.calls)
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)
    assert not fakes.servo.enabled


def test_lost_samples_are_reported(start: Callable[..., Fakes]) -> None:
    fakes = start()
    fakes.stop_answer.update(success=False, message="20 samples are missing", lost=20, samples=480)
    ended = fakes.result(fakes.send())
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert (ended.result.message, ended.result.lost) == ("20 samples are missing", 20)


def test_nothing_is_armed_on_stale_inputs(start: Callable[..., Fakes]) -> None:
    fakes = start(answer_timeout_s=0.3)
    fakes.servo.connected = False
    fakes.graph.during(0.2)
    result = fakes.result(fakes.send()).result
    assert result.message.startswith("not armed, lost servo: the motor does not answer")
    assert fakes.calls == COURSE[:2]


def test_a_supervisor_that_is_ended_stops_the_bench_first(graph: Any, start: Callable[..., Fakes]) -> None:
    fakes = start()
    fakes.running()
    process = graph.process("supervisor")
    process.terminate()
    graph.until(lambda: fakes.stops and fakes.stops[-1][1], timeout=3.0)
    graph.until(lambda: process.poll() is not None)
    assert process.returncode == 0
    assert "Traceback" not in graph.log("supervisor")


def test_a_stop_from_before_its_start_is_seen(start: Callable[..., Fakes], graph: Any) -> None:
    fakes = start()
    fakes.servo.stopped = True
    graph.until(lambda: fakes.mode() == BenchState.FAULT)
    assert fakes.states[-1].message == "the servo's emergency stop is latched; call reset_fault"


def test_a_set_is_recorded_by_one_order_each_run_in_its_own_bag(start: Callable[..., Fakes], tmp_path: Any) -> None:
    fakes = start()
    # What an action publishes before its client is matched is lost: orders that are refused, until one of them is heard.
    fakes.trouble["load_experiment"] = "not yet"
    while True:
        assert not fakes.result(fakes.send_set(str(tmp_path))).result.success
        if fakes.feedback:
            break
    fakes.trouble.clear()
    fakes.calls.clear()
    ended = fakes.result(fakes.send_set(str(tmp_path)))
    result = ended.result
    assert (ended.status, result.success) == (GoalStatus.STATUS_SUCCEEDED, True), result.message
    assert result.message == "3 runs recorded, none of their samples lost"
    assert [(r.experiment, r.complete, r.bag, r.samples) for r in result.recordings] == [
        (name, True, str(tmp_path / name), 500) for name in ("01_a", "02_b", "03_c")
    ]
    # All are planned before the first moves the rod, which is homed once.
    again = [call for call in COURSE if call != "servo/home"]
    assert fakes.calls == [*["load_experiment"] * 3, *COURSE, *AWAY, *again, *AWAY, *again, *AWAY]
    order = list(dict.fromkeys(fakes.feedback))
    checks = [f"{number} {name} checking" for number, name in enumerate(("01_a", "02_b", "03_c"), 1)]
    assert order[:3] == checks
    assert [line for line in order if "running" in line] == [line.replace("checking", "running") for line in checks]
    fakes.graph.until(lambda: fakes.mode() == BenchState.IDLE)


@pytest.mark.parametrize("way", ["stop", "cancel", "interlock"])
def test_what_stops_a_run_ends_its_set_and_keeps_what_is_recorded(
    start: Callable[..., Fakes], tmp_path: Any, way: str
) -> None:
    fakes = start()
    handle = fakes.send_set(str(tmp_path))
    fakes.graph.until(lambda: "2 02_b running" in fakes.feedback and 0 < fakes.remaining < 20)
    refused = fakes.result(fakes.send()).result
    assert refused.message == "the bench is busy: run_set; wait for its end or call stop"
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


def test_a_set_that_cannot_be_recorded_as_a_whole_is_refused_before_anything_moves(
    start: Callable[..., Fakes], tmp_path: Any
) -> None:
    fakes = start()
    (tmp_path / "02_b").mkdir()
    for experiments, line in (
        ([], "the set has no experiments"),
        (["name: x"], "experiment 1: duration_s is missing"),
        ([SET[0], SET[0]], "experiment 2: another one of the set has the name 01_a"),
        (SET, "02_b: exists already and is not overwritten"),
    ):
        result = fakes.result(fakes.send_set(str(tmp_path), experiments)).result
        assert (result.success, result.recordings) == (False, [])
        assert line in result.message
    assert fakes.calls == []
    fakes.trouble["load_experiment"] = "speed exceeds"
    result = fakes.result(fakes.send_set(str(tmp_path / "new"))).result
    assert result.message == "01_a: generator: speed exceeds (completely recorded of 3: none)"
    assert fakes.calls == ["load_experiment"]
