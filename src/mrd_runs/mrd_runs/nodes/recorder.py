"""Recorder: writes one bag for each start_recording; stop_recording or the end of the node closes it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from std_msgs.msg import Bool

from mrd_base import InputError, quantity
from mrd_base.nodes.bench_node import LATCHED, RECORDED, BenchNode, run_node
from mrd_interfaces.msg import BenchSamples, BenchState, Calibration, ServoState, Setpoint
from mrd_interfaces.srv import StartRecording, StopRecording
from mrd_runs.bag import FLUSH_PERIOD, BagWriter
from mrd_runs.completeness import check_completeness
from mrd_runs.definitions import type_name, typestore
from mrd_runs.run_info import describe_calibration, format_run_info


@dataclass(frozen=True)
class RecorderSettings:
    """Parameters of the recorder."""

    stale: float = quantity(1.0, "s", "a recording without samples for longer is reported in the diagnostics", lower=0.0)


class Recorder(BenchNode[RecorderSettings]):
    """Subscribes from the start, so that a recording never waits for discovery; writes only between start and stop."""

    def __init__(self) -> None:
        super().__init__("recorder", RecorderSettings)
        self._writer: BagWriter | None = None
        self._failure = ""
        self._last_samples = 0.0
        # The latest message of each latched topic opens every bag, because it is still valid then.
        self._latched: dict[str, bytes] = {}
        self._types: dict[str, tuple[str, bool]] = {}
        self._samples = self._record("samples", BenchSamples)
        self._record("servo_state", ServoState)
        self._record("setpoint", Setpoint)
        self._calibration = self._record("calibration", Calibration, latched=True)
        self._record("bench_state", BenchState, latched=True)
        self._record("emergency_stop", Bool, latched=True)
        self._run_info = self.resolve_topic_name("run_info")
        self.create_service(StartRecording, "start_recording", self._start)
        self.create_service(StopRecording, "stop_recording", self._stop)
        self.create_timer(FLUSH_PERIOD, self._flush)

    def _record(self, name: str, message_type: Any, latched: bool = False) -> str:
        """Subscribe to a topic, as serialised bytes, and return its full name."""

        def on_message(cdr: bytes) -> None:
            if latched:
                self._latched[topic] = cdr
            self._write(topic, cdr)

        subscription = self.create_subscription(message_type, name, on_message, LATCHED if latched else RECORDED, raw=True)
        topic: str = subscription.topic_name
        self._types[topic] = (type_name(message_type), latched)
        return topic

    def _now(self) -> int:
        return int(self.bench.now() * 1e9)

    def _write(self, topic: str, cdr: bytes) -> None:
        if self._writer is None or self._failure:
            return
        if topic == self._samples:
            self._last_samples = self.bench.now()
        try:
            self._writer.write(topic, self._now(), cdr)
        except OSError as error:
            self._fail(error)

    def _flush(self) -> None:
        if self._writer is None or self._failure:
            return
        try:
            self._writer.flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        assert self._writer is not None
        self._failure = f"{self._writer.path}: cannot be written ({error.strerror}); the messages before are kept"
        self.get_logger().error(self._failure)

    def _start(self, request: StartRecording.Request, response: StartRecording.Response) -> StartRecording.Response:
        try:
            path = self._open(request)
        except InputError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.bag = True, str(path)
        response.message = f"recording into {path}"
        return response

    def _open(self, request: StartRecording.Request) -> Path:
        if self._writer is not None:
            raise InputError(f"already recording into {self._writer.path}; stop_recording first")
        if not request.bag:
            raise InputError("the request names no bag; expected the folder to make")
        cdr = self._latched.get(self._calibration)
        calibration = None if cdr is None else typestore().deserialize_cdr(cdr, self._types[self._calibration][0])
        info = format_run_info(
            experiment=request.experiment,
            seed=int(request.seed),
            calibration=None if calibration is None else describe_calibration(calibration),
            node=self.get_fully_qualified_name(),
        )
        writer = BagWriter(Path(request.bag).absolute())
        try:
            writer.add_topic(self._run_info, "std_msgs/msg/String", latched=True)
            for topic, (message_type, latched) in self._types.items():
                writer.add_topic(topic, message_type, depth=1 if latched else RECORDED.depth, latched=latched)
            writer.write_message(self._run_info, self._now(), writer.types.types["std_msgs/msg/String"](info))
            for topic, cdr in self._latched.items():
                writer.write(topic, self._now(), cdr)
            writer.flush()
        except OSError as error:
            writer.close()
            raise InputError(f"{writer.path}: cannot be written ({error.strerror})") from None
        self._writer, self._failure, self._last_samples = writer, "", self.bench.now()
        self.get_logger().info(f"recording into {writer.path}")
        return writer.path

    def _stop(self, _request: StopRecording.Request, response: StopRecording.Response) -> StopRecording.Response:
        if self._writer is None:
            response.success, response.message = False, "not recording; nothing to stop"
            return response
        writer, failure = self._writer, self._failure
        self.close()
        bag = check_completeness(writer.path, self._samples, writer.counts)
        problem = failure or bag.problem
        response.success = not problem
        response.message = problem or f"{bag.samples} samples in {bag.duration:.3f} s, none missing"
        response.bag, response.samples, response.lost = str(writer.path), bag.samples, bag.lost
        response.duration = bag.duration
        (self.get_logger().error if problem else self.get_logger().info)(f"closed {writer.path}: {response.message}")
        return response

    def health(self) -> tuple[str, dict[str, Any]]:
        if self._writer is None:
            return "", {"recording": "no"}
        silence = self.bench.now() - self._last_samples
        problem = self._failure
        if not problem and silence > self.config.stale:
            problem = f"no samples for {silence:.1f} s"
        return problem, {"recording": self._writer.path, "blocks": self._writer.counts[self._samples]}

    def close(self) -> None:
        writer, self._writer = self._writer, None
        if writer is None:
            return
        try:
            writer.close()
        except OSError as error:
            self.get_logger().error(f"{writer.path}: cannot be closed ({error.strerror}); read_run recovers it")


def main() -> None:
    run_node(Recorder)
