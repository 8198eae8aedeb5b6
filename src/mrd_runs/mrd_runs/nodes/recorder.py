"""Recorder: writes one bag for each start_recording; stop_recording or the end of the node closes it."""

import contextlib
import math
import os
import shutil
import signal
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from mrd_base import InputError, quantity
from mrd_base.config import named_path
from mrd_base.lease import Mode
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import (
    CALIBRATION,
    EMERGENCY_STOP,
    LATCHED,
    RECORDED,
    RECORDER_STATE,
    SAMPLES,
    SERVO_STATE,
    START_RECORDING,
    STOP_RECORDING,
    TOPICS,
    Topic,
    type_name,
)
from mrd_base.nodes.lease import LeaseFollower, hear_emergency_stop
from mrd_base.tool import command
from mrd_interfaces.msg import ServoState
from mrd_interfaces.srv import StartRecording, StopRecording
from mrd_runs.bag import FLUSH_PERIOD, BagWriter, free_space
from mrd_runs.blocks import decode_blocks
from mrd_runs.completeness import check_completeness
from mrd_runs.definitions import typestore
from mrd_runs.rest import RestLimits, RestMonitor
from mrd_runs.run_info import describe_calibration, format_run_info

# Bench time in s between two repetitions of the state.
_REPEAT_PERIOD = 0.2
# Free space in bytes below which the diagnostics warn: an hour at 2 kHz.
_LITTLE_SPACE = 500e6


@dataclass(frozen=True)
class RecorderSettings:
    """Parameters of the recorder."""

    stale: float = quantity(1.0, "s", "a recording without samples for longer is reported in the diagnostics", lower=0.0)
    rest_speed: float = quantity(2e-3, "mm/s", "below, the rod is at rest; a bag is closed then", lower=0.0)
    rest_current: float = quantity(0.05, "A", "below, the coil is at rest", lower=0.0)
    rest_duration: float = quantity(0.5, "s", "how long they are at rest before a bag is closed", lower=0.0, upper=10.0)
    rest_timeout: float = quantity(5.0, "s", "longest wait for rest after stop_recording; 0: none", lower=0.0, upper=60.0)

    @property
    def rest(self) -> RestLimits:
        return RestLimits(self.rest_speed, self.rest_current, self.rest_duration)


class Recorder(BenchNode[RecorderSettings]):
    """Records the topics of the bench into bags.

    It subscribes from the start, so that a recording never waits for discovery; writes only between start and stop.

    Topics are served by the executor of this node. Requests are served one after the other by a second node in a thread of
    its own, because stop_recording waits until rod and coil are at rest while the recording goes on. The topic
    ``recorder_state`` tells at once when a recording fails. While the supervisor of a run watches, nobody else ends its
    recording; without it, anybody may, and the next recording does. On a simulated bench, time stands still during a
    request, except while stop_recording waits for rest; who calls it lets time pass while ``recorder_state`` is
    ``stopping``.
    """

    alone = True

    def __init__(self) -> None:
        super().__init__("recorder", RecorderSettings)
        self._lock = threading.RLock()  # held by whoever uses the attributes below
        self._writer: BagWriter | None = None
        self._failure = ""
        self._last_samples = 0.0
        self._rest: RestMonitor | None = None
        self._lease = LeaseFollower(self, self.config.stale, lambda _reason: None)
        self._run_lease = 0  # number of the lease of the run that is recorded; 0 for a recording by hand
        self._run_holder = ""  # its supervisor
        self._requested = 0.0  # bench time of the latest request
        self._end = math.inf  # bench time from which on nothing is written
        self._wait_over = self.bench.waiter()  # woken when the wait for rest is over
        # The latest message of each latched topic opens every bag, because it is still valid then.
        self._latched: dict[str, bytes] = {}
        self._types: dict[str, tuple[str, bool]] = {}
        self._typestore = typestore()
        self._state = RECORDER_STATE.publisher(self)
        names = {topic: self._record(topic) for topic in TOPICS if topic.recorded}
        self._samples, self._servo_state, self._calibration = names[SAMPLES], names[SERVO_STATE], names[CALIBRATION]
        self._run_info = self.resolve_topic_name("run_info")
        self.create_timer(FLUSH_PERIOD, self._flush)
        self._said = ("idle", "")
        # Repeated, so that the end of this process is noticed.
        self.create_bench_timer(_REPEAT_PERIOD, lambda: self._publish_state(*self._said))
        self._publish_state("idle")

        self._request_node = Node("recorder_requests", start_parameter_services=False, enable_rosout=False)
        START_RECORDING.serve(self._request_node, self._start)
        STOP_RECORDING.serve(self._request_node, self._stop)
        self._request_executor = SingleThreadedExecutor()
        self._request_executor.add_node(self._request_node)
        self._ending = threading.Event()
        self._request_thread = threading.Thread(target=self._serve_requests, name="requests", daemon=True)
        self._request_thread.start()

    def _record(self, declared: Topic) -> str:
        """Subscribe to a topic, as serialised bytes, and return its full name."""
        latched = declared.qos == LATCHED

        def on_message(cdr: bytes) -> None:
            with self._lock:
                if latched:
                    self._latched[topic] = cdr
                self._write(topic, cdr)

        topic: str
        if declared is EMERGENCY_STOP:  # anybody may stop the bench, by a publisher of any kind
            topic = hear_emergency_stop(self, on_message, raw=True)
        else:
            topic = declared.subscription(self, on_message, LATCHED if latched else RECORDED, raw=True).topic_name
        self._types[topic] = (type_name(declared.type), latched)
        return topic

    def _serve_requests(self) -> None:
        try:
            while not self._ending.is_set():
                self._request_executor.spin_once(timeout_sec=0.1)
        finally:
            # After an error, the recorder ends with a closed bag instead of being there without answering.
            if not self._ending.is_set():
                os.kill(os.getpid(), signal.SIGTERM)

    def _now(self) -> int:
        return int(self.bench.now() * 1e9)

    def _write(self, topic: str, cdr: bytes) -> None:
        now = self.bench.now()
        if self._writer is None or self._failure or now >= self._end:
            return
        # On a simulated bench, samples of the instant of a request may come before or after it. They neither begin a bag nor
        # show rest, so that each run of an experiment is recorded alike.
        later = now > self._requested
        if topic == self._samples:
            if not later and self._rest is None:
                return
            self._last_samples = now
        try:
            self._writer.write(topic, int(now * 1e9), cdr)
        except InputError as error:
            self._fail(error)
        if self._rest is not None and later:
            self._follow_rest(self._rest, topic, cdr)
            if self._rest.rested:
                self._end = now
                self._wait_over.wake()

    def _flush(self) -> None:
        with self._lock:
            if self._writer is None or self._failure:
                return
            try:
                self._writer.flush()
            except InputError as error:
                self._fail(error)

    def _fail(self, error: InputError) -> None:
        self._failure = str(error)
        self._wait_over.wake()
        self._publish_state("failed", self._failure)
        self.get_logger().error(self._failure)

    def _publish_state(self, state: str, problem: str = "") -> None:
        """Tell everyone whether the recorder is ``idle``, ``recording``, ``stopping`` or has ``failed``."""
        self._said = state, problem
        bag = "" if self._writer is None else str(self._writer.path)
        self._state.publish(
            DiagnosticStatus(
                level=DiagnosticStatus.ERROR if problem else DiagnosticStatus.OK,
                name=f"{self.get_fully_qualified_name().lstrip('/')}: recording",
                message=problem or state,
                values=[KeyValue(key="state", value=state), KeyValue(key="bag", value=bag)],
            )
        )

    # Start

    def _start(self, request: StartRecording.Request, response: StartRecording.Response) -> StartRecording.Response:
        try:
            with self.bench.busy():
                path = self._open(request)
        except InputError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.bag = True, str(path)
        response.message = f"recording into {path}"
        return response

    def _open(self, request: StartRecording.Request) -> Path:
        # A recording by hand would be in the way of the run that is about to begin.
        if not request.lease and (reason := self._lease.reason_not_to_change(self.bench.now())):
            raise InputError(f"{reason}, or give the number of its lease")
        if self._writer is not None:
            if not self._is_orphaned():
                raise InputError(f"already recording into {self._writer.path}; stop_recording first")
            self._end_orphaned_bag(self._writer.path)
        if not request.bag:
            raise InputError("the request names no bag; expected the folder to make")
        cdr = self._latched.get(self._calibration)
        calibration = None if cdr is None else self._typestore.deserialize_cdr(cdr, self._types[self._calibration][0])
        info = format_run_info(
            experiment=request.experiment,
            seed=int(request.seed),
            calibration=None if calibration is None else describe_calibration(calibration),
            node=self.get_fully_qualified_name(),
        )
        writer = BagWriter(named_path(request.bag))
        writer.add_topic(self._run_info, "std_msgs/msg/String", latched=True)
        for topic, (message_type, latched) in self._types.items():
            writer.add_topic(topic, message_type, depth=1 if latched else RECORDED.depth, latched=latched)
        writer.write_message(self._run_info, self._now(), writer.types.types["std_msgs/msg/String"](info))
        with self._lock:
            for topic, cdr in self._latched.items():
                writer.write(topic, self._now(), cdr)
            writer.flush()
            self._writer, self._failure = writer, ""
            self._run_lease, self._run_holder = int(request.lease), self._lease.lease.holder
            self._last_samples = self._requested = self.bench.now()
            self._end = math.inf
            self._publish_state("recording")
        self.get_logger().info(f"recording into {writer.path}")
        return writer.path

    def _end_orphaned_bag(self, path: Path) -> None:
        """Close a bag whose run nobody ends any more."""
        failure = self._close_bag()
        self.get_logger().warning(f"closed {path}, whose run has ended without stop_recording{failure and f': {failure}'}")

    # Stop

    def _stop(self, request: StopRecording.Request, response: StopRecording.Response) -> StopRecording.Response:
        recorded = self._run_lease if self._writer is not None else 0
        if recorded not in (0, request.lease) and not self._is_orphaned():
            response.success = False
            response.message = f"records a run of {self._run_holder}; call its stop"
            return response
        with self.bench.busy():
            return self._close_and_count(response)

    def _is_orphaned(self) -> bool:
        """Whether the run that is recorded is over, or has lost its supervisor. A new one could not end it."""
        lease = self._lease.lease
        watched = self._lease.is_valid(self.bench.now()) and lease.holder == self._run_holder
        return self._run_lease != 0 and not (watched and lease.mode is not Mode.IDLE)

    def _close_and_count(self, response: StopRecording.Response) -> StopRecording.Response:
        writer = self._writer
        if writer is None:
            response.success, response.message = False, "not recording; nothing to stop"
            return response
        unrest = self._await_rest()
        failure = self._close_bag()
        bag = check_completeness(writer.path, self._samples, writer.counts)
        problem = failure or bag.problem
        response.success = not problem
        response.message = problem or f"{bag.samples} samples in {bag.duration:.3f} s, none missing"
        if unrest:
            response.message += f"; {unrest}"
        response.bag, response.samples, response.lost = str(writer.path), bag.samples, bag.lost
        response.duration = bag.duration
        # One call for both would fail: rclpy keeps to the severity of the first message of each line of code.
        if problem:
            self.get_logger().error(f"closed {writer.path}: {response.message}")
        else:
            self.get_logger().info(f"closed {writer.path}: {response.message}")
        return response

    def _await_rest(self) -> str:
        """Wait in bench time until rod and coil have been at rest for long enough; return why they were not."""
        with self._lock:
            if not self.config.rest_timeout or self._failure:
                return ""
            rest = RestMonitor(self.config.rest)
            self._requested = begin = self.bench.now()
            self._rest, self._end = rest, (end := begin + self.config.rest_timeout)
            self._publish_state("stopping")
        while self._writer is not None and not self._failure and not rest.rested:
            silent = max(begin, self._last_samples) + self.config.stale
            if self.bench.now() >= end:
                return f"not at rest {self.config.rest_timeout:g} s after the stop ({rest.describe()})"
            if self.bench.now() >= silent:
                return "the samples ended before rest was seen"
            self._wait_over.wait(min(end, silent))
        return ""

    def _follow_rest(self, rest: RestMonitor, topic: str, cdr: bytes) -> None:
        if topic == self._samples:
            with contextlib.suppress(Exception):  # a block that cannot be decoded shows no rest; it is recorded all the same
                rest.add_samples(decode_blocks([cdr], self._typestore))
        elif topic == self._servo_state:
            state = deserialize_message(cdr, ServoState)
            if state.connected:
                rest.add_speed(seconds(state.header.stamp), state.velocity)

    def _close_bag(self) -> str:
        """Close the bag, if one is open; return why it is incomplete."""
        with self._lock:
            writer, self._writer, self._rest = self._writer, None, None
            failure = self._failure
            if writer is None:
                return failure
        try:
            writer.close()
        except InputError as error:
            self._failure = failure = failure or str(error)
        self._publish_state("idle")
        return failure

    # The base of a node

    def warning(self) -> str:
        with self._lock:
            path = None if self._writer is None else self._writer.path
        return f"only {free_space(path)}" if path and shutil.disk_usage(path).free < _LITTLE_SPACE else ""

    def health(self) -> tuple[str, dict[str, Any]]:
        with self._lock:
            if self._writer is None:
                return self._failure, {"recording": "no"}  # the failure of the latest one
            silence = self.bench.now() - self._last_samples
            problem = self._failure
            if not problem and silence > self.config.stale:
                problem = f"no samples for {silence:.1f} s"
            path, blocks = self._writer.path, self._writer.counts[self._samples]
            return problem, {"recording": path, "blocks": blocks, "space": free_space(path)}

    def close(self) -> None:
        failure = self._close_bag()
        if failure:
            self.get_logger().error(f"{failure}; `{command('mrd_runs', 'recover')}` completes the bag")
        self._ending.set()
        self._wait_over.wake()
        self._request_thread.join()
        self._wait_over.close()
        self._request_executor.shutdown()
        self._request_node.destroy_node()


def main() -> None:
    run_node(Recorder)
