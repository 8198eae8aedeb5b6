"""Recorder and replay as processes; the test takes the part of the other nodes."""

import array
import itertools
import resource
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from mrd_base import BenchClock
from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED
from mrd_interfaces.msg import BenchSamples, BenchState, Calibration, Lease, Setpoint
from mrd_interfaces.srv import StartRecording, StopRecording
from mrd_runs import read_run
from mrd_runs.bag import read_bag
from mrd_runs.blocks import decode_as_table

pytestmark = pytest.mark.realtime

PERIOD = 0.02  # s, of the blocks


class FakeDaq:
    """Publishes blocks of samples, calls services, runs nodes."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("bench", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.processes: list[subprocess.Popen[str]] = []
        self.samples = self.node.create_publisher(BenchSamples, "samples", RECORDED)
        self.calibration = self.node.create_publisher(Calibration, "calibration", LATCHED)
        self.setpoint = self.node.create_publisher(Setpoint, "setpoint", RECORDED)
        self.published: list[tuple[float, int]] = []  # when, and number of the last sample
        self.rest_from = np.inf  # number of the sample at which the rod comes to rest
        self._clients: dict[str, Any] = {}
        self._streaming = threading.Event()
        self._stream: threading.Thread | None = None

    def run(self, executable: str, **parameters: object) -> subprocess.Popen[str]:
        command = ["ros2", "run", "mrd_runs", executable, "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={value}"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.processes.append(process)
        return process

    def publish(self, first: int) -> None:
        """Publish a block of a rod that swings, or stands where `rest_from` says so; the force counts the samples."""
        message = BenchSamples(sample_period=1e-3, sequence=first)
        message.header.stamp.sec = 1000 + first // 1000
        message.header.stamp.nanosec = first % 1000 * 10**6
        numbers = np.arange(first, first + 20)
        moving = numbers < self.rest_from
        message.position = array.array("d", 0.01 * np.sin(np.minimum(numbers, self.rest_from) / 100))
        message.force = array.array("d", numbers.astype(float))
        message.coil_current = array.array("d", np.where(moving, 0.15, 0.0))
        message.acceleration = array.array("d", -np.sin(numbers / 100))
        self.samples.publish(message)
        self.published.append((time.monotonic(), first + 20))

    def stream(self, skip: tuple[int, ...] = ()) -> None:
        """Publish 1 kHz from another thread, without the blocks of ``skip``."""

        def work() -> None:
            start = time.monotonic()
            for block in range(10**6):
                while (rest := start + block * PERIOD - time.monotonic()) > 0:
                    time.sleep(rest)
                if self._streaming.is_set():
                    return
                if block not in skip:
                    self.publish(block * 20)

        self._streaming.clear()
        self._stream = threading.Thread(target=work)
        self._stream.start()

    def stop_stream(self) -> None:
        self._streaming.set()
        if self._stream:
            self._stream.join()

    def until(self, condition: Callable[[], Any], timeout: float = 20.0) -> None:
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, "timed out"
            self._executor.spin_once(timeout_sec=0.01)

    def during(self, duration: float) -> None:
        """Process messages for a while."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.01)

    def call(self, name: str, kind: Any, **fields: Any) -> Any:
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            self.until(self._clients[name].service_is_ready)
            # The service may find the way back a little later than its client finds it; an answer before that is lost.
            time.sleep(0.3)
        future = self._clients[name].call_async(kind.Request(**fields))
        self.until(future.done)
        return future.result()

    def start_recording(self, bag: Path) -> Any:
        # A service may be discovered before the topic is.
        self.until(lambda: self.samples.get_subscription_count() > 0)
        return self.call("start_recording", StartRecording, bag=str(bag), experiment="name: demo\n", seed=7)

    def stop_recording(self) -> Any:
        return self.call("stop_recording", StopRecording)

    def recorder_states(self) -> list[DiagnosticStatus]:
        """Return a list that receives what the recorder tells about itself."""
        received: list[DiagnosticStatus] = []
        self.node.create_subscription(DiagnosticStatus, "recorder_state", received.append, LATCHED)
        return received

    def receive_samples(self) -> list[BenchSamples]:
        """Return a list that receives the samples; a long queue keeps them when the machine is busy."""
        received: list[BenchSamples] = []
        patient = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
        self.node.create_subscription(BenchSamples, "samples", received.append, patient)
        return received

    def close(self) -> None:
        self.stop_stream()
        for process in self.processes:
            process.kill()
            process.communicate()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def bench() -> Iterator[FakeDaq]:
    bench = FakeDaq()
    yield bench
    bench.close()


def test_recording_is_complete_and_describes_itself(bench: FakeDaq, tmp_path: Path) -> None:
    bench.calibration.publish(
        Calibration(quantity=["position"], unit=["m"], channel=["ai0"], gain=[0.005], zero=[0.1], device="simulated")
    )
    recorder = bench.run("recorder", rest_timeout_s=0.0)
    bench.stream()
    bench.until(lambda: len(bench.published) > 10)
    assert list(tmp_path.iterdir()) == []  # nothing on the disk before the start
    started = bench.start_recording(tmp_path / "run")
    assert (started.success, started.bag) == (True, str(tmp_path / "run"))
    assert not bench.start_recording(tmp_path / "other").success
    bench.setpoint.publish(Setpoint(position=0.001))
    count = len(bench.published)
    bench.until(lambda: len(bench.published) > count + 60)
    stopped = bench.stop_recording()
    assert stopped.success, stopped.message
    assert stopped.lost == 0
    run = read_run(stopped.bag)
    assert len(run) == stopped.samples >= 1180
    first = int(run.force[0])
    np.testing.assert_array_equal(run.force, np.arange(first, first + len(run)))
    np.testing.assert_array_equal(run.position, 0.01 * np.sin(np.arange(first, first + len(run)) / 100))
    assert run.info["experiment_name"] == "demo"
    assert run.info["seed"] == 7
    assert run.info["calibration"]["position"] == {"unit": "m", "channel": "ai0", "gain": 0.005, "zero_V": 0.1}
    assert run.info["versions"]["mrd_runs"]
    bag = read_bag(tmp_path / "run")
    assert [message.position for message in bag.decode("/setpoint")] == [0.001]
    assert decode_as_table(bag.topics["/samples"].messages) is not None  # the fast way is the one that ROS's bytes take

    # A second run by the same recorder is as good, and the first one is not touched.
    before = (tmp_path / "run/run.mcap").read_bytes()
    assert not bench.start_recording(tmp_path / "run").success
    assert bench.start_recording(tmp_path / "second").success
    count = len(bench.published)
    bench.until(lambda: len(bench.published) > count + 15)
    assert bench.stop_recording().success
    assert len(read_run(tmp_path / "second")) >= 280
    assert (tmp_path / "run/run.mcap").read_bytes() == before
    assert not bench.stop_recording().success
    recorder.terminate()
    assert recorder.wait(10) == 0


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
def test_everybodys_emergency_stop_is_recorded(bench: FakeDaq, tmp_path: Path, reliability: ReliabilityPolicy) -> None:
    bench.run("recorder", rest_timeout_s=0.0)
    button = bench.node.create_publisher(Bool, "emergency_stop", QoSProfile(depth=5, reliability=reliability))
    bench.until(button.get_subscription_count)
    assert bench.start_recording(tmp_path / "run").success
    bench.stream()
    for _ in range(20):  # what is sent best effort may be lost
        button.publish(Bool(data=True))
        bench.during(0.02)
    assert bench.stop_recording().success
    presses = [message.data for message in read_bag(tmp_path / "run").decode("/emergency_stop")]
    assert presses
    assert all(presses)


def test_nobody_records_in_the_way_of_a_run(bench: FakeDaq, tmp_path: Path) -> None:
    bench.run("recorder", rest_timeout_s=0.0)
    leases = bench.node.create_publisher(Lease, "lease", COMMAND)
    bench.until(leases.get_subscription_count)

    mode = BenchState.HOMING

    def renew() -> None:
        lease = Lease(holder="supervisor", mode=mode)
        lease.header.stamp.sec, lease.header.stamp.nanosec = divmod(int(1e9 * BenchClock().now()), 10**9)
        leases.publish(lease)

    bench.node.create_timer(0.02, renew)
    bench.during(0.3)
    refused = bench.start_recording(tmp_path / "by_hand")
    assert not refused.success
    assert "the bench is in mode homing; call stop of supervisor first, or give the number of its lease" in refused.message
    run = bench.call("start_recording", StartRecording, bag=str(tmp_path / "run"), lease=7)
    assert run.success, run.message
    assert not (tmp_path / "by_hand").exists()
    assert bench.stop_recording().message == "records a run of supervisor; call its stop"
    # The request that should have ended the recording was lost: the run is over, and nobody else would end it.
    mode = BenchState.IDLE
    bench.during(0.3)
    assert bench.stop_recording().bag == str(tmp_path / "run")


def test_missing_samples_are_reported(bench: FakeDaq, tmp_path: Path) -> None:
    """A recorder that has closed a bad bag closes a good one, and the reverse: its log takes both."""
    recorder = bench.run("recorder", rest_timeout_s=0.0)
    assert bench.start_recording(tmp_path / "none").success
    nothing = bench.stop_recording()
    assert (nothing.success, nothing.samples) == (False, 0)
    assert "no sample arrived" in nothing.message
    bench.stream(skip=(100, 101))
    bench.until(lambda: len(bench.published) > 10)
    for name, lost in (("good", 0), ("bad", 40), ("good_again", 0)):
        assert bench.start_recording(tmp_path / name).success
        until = 110 if lost else len(bench.published) + 10
        bench.until(lambda until=until: len(bench.published) > until)
        stopped = bench.stop_recording()
        assert (stopped.success, stopped.lost) == (not lost, lost), stopped.message
        assert "40 of" in stopped.message or not lost
    assert recorder.poll() is None


def test_recording_goes_on_until_rod_and_coil_are_at_rest(bench: FakeDaq, tmp_path: Path) -> None:
    bench.run("recorder")
    states = bench.recorder_states()
    bench.stream()
    assert bench.start_recording(tmp_path / "run").success
    bench.rest_from = bench.published[-1][1] + 2000
    stopped = bench.stop_recording()  # about 2 s before the rod stands
    assert stopped.success, stopped.message
    run = read_run(stopped.bag)
    assert 500 <= run.force[-1] + 1 - bench.rest_from < 1000
    # The recorder repeats what it tells.
    assert [message for message, _ in itertools.groupby(states, lambda state: state.message)][-4:] == [
        "idle",
        "recording",
        "stopping",
        "idle",
    ]
    # At rest, half a second is recorded as well, because the rod might move on.
    assert bench.start_recording(tmp_path / "rest").success
    asked = bench.published[-1][1]
    run = read_bag(bench.stop_recording().bag)
    assert 500 <= run.decode("/samples")[-1].force[-1] - asked < 1200


def test_rod_that_never_rests(bench: FakeDaq, tmp_path: Path) -> None:
    bench.run("recorder", rest_timeout_s=1.2)
    bench.stream()
    bench.start_recording(tmp_path / "run")
    begin = time.monotonic()
    stopped = bench.stop_recording()
    assert 1.0 < time.monotonic() - begin < 3
    assert stopped.success
    assert "; not at rest 1.2 s after the stop (" in stopped.message
    # Without samples, rest cannot be seen.
    bench.start_recording(tmp_path / "second")
    bench.until(lambda: len(bench.published) > 100)
    bench.stop_stream()
    assert bench.stop_recording().message.endswith("; the samples ended before rest was seen")


def test_blocks_that_cannot_be_decoded(bench: FakeDaq, tmp_path: Path) -> None:
    """They are recorded and reported; the recorder goes on."""
    recorder = bench.run("recorder", rest_timeout_s=1.0)
    bench.start_recording(tmp_path / "run")
    for _ in range(60):
        bench.samples.publish(BenchSamples(sample_period=1e-3, position=array.array("d", [0.0]), force=array.array("d")))
        time.sleep(0.01)
    stopped = bench.stop_recording()
    assert not stopped.success
    assert "the messages of /samples cannot be read (a block has series of unequal lengths" in stopped.message
    assert bench.start_recording(tmp_path / "next").success
    assert recorder.poll() is None


def test_full_disk_is_told_at_once(bench: FakeDaq, tmp_path: Path) -> None:
    """A limit of the size of its files is to the recorder what a full disk is."""
    recorder = bench.run("recorder")
    bench.stream()
    assert bench.start_recording(tmp_path / "run").success
    states = bench.recorder_states()
    bench.until(lambda: states)
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))
    bench.until(lambda: states[-1].level == DiagnosticStatus.ERROR, timeout=10)
    failed = states[-1]
    assert failed.message.startswith(f"{tmp_path}/run: cannot be written (File too large; ")
    assert "MB free in " in failed.message
    assert {value.key: value.value for value in failed.values} == {"state": "failed", "bag": f"{tmp_path}/run"}
    late = bench.recorder_states()  # also told to who comes late
    bench.until(lambda: late)
    assert late[-1].message == failed.message
    stopped = bench.stop_recording()
    assert not stopped.success
    assert stopped.message == failed.message
    assert stopped.samples > 300
    assert (tmp_path / "run/run.mcap").stat().st_size <= 60_000
    bench.until(lambda: (states[-1].level, states[-1].message) == (DiagnosticStatus.OK, "idle"))
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert bench.start_recording(tmp_path / "next").success
    bench.until(lambda: states[-1].message == "recording")


def test_recorder_refuses_impossible_folders(bench: FakeDaq, tmp_path: Path) -> None:
    bench.run("recorder")
    (tmp_path / "file").write_text("")
    assert "exists already" in bench.start_recording(tmp_path / "file").message
    assert "File name too long" in bench.start_recording(tmp_path / (300 * "a")).message
    assert "cannot be made" in bench.start_recording(tmp_path / "file/run").message
    assert "names no bag" in bench.call("start_recording", StartRecording).message


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
def test_signals_close_the_bag(bench: FakeDaq, tmp_path: Path, sign: int) -> None:
    recorder = bench.run("recorder")
    bench.start_recording(tmp_path / "run")
    bench.stream()
    bench.until(lambda: len(bench.published) > 30)
    recorder.send_signal(sign)
    assert recorder.wait(10) == 0
    run = read_run(tmp_path / "run")
    assert not run.info["recovered"]
    assert len(run) >= 500


@pytest.mark.parametrize("seed", range(2))
def test_killed_recorder_loses_at_most_a_second(bench: FakeDaq, tmp_path: Path, seed: int) -> None:
    recorder = bench.run("recorder")
    bench.start_recording(tmp_path / "run")
    bench.stream()
    begin = time.monotonic()
    delay = float(np.random.default_rng(seed).uniform(0.6, 2.5))
    bench.until(lambda: time.monotonic() > begin + delay)
    killed = time.monotonic()
    recorder.kill()
    recorder.wait()
    bench.stop_stream()
    before = max(number for at, number in bench.published if at < killed)
    run = read_run(tmp_path / "run") if before > 1100 else None
    kept = len(run) if run else sum(len(block.position) for block in read_bag(tmp_path / "run").decode("/samples"))
    assert before - kept <= 1000
    if run:
        assert run.info["recovered"]
        assert run.info["experiment_name"] == "demo"
        np.testing.assert_array_equal(run.force, np.arange(len(run)))


def test_replay_loses_nothing_and_keeps_the_stamps(bench: FakeDaq, tmp_path: Path, make_columns, fill_bag) -> None:
    columns = make_columns(20_000)
    fill_bag(tmp_path / "run", columns).close()
    received = bench.receive_samples()
    replay = bench.run("replay", bag=tmp_path / "run", speed=0.0, wait_for_subscriber=True, max_rate_hz=1000.0)
    bench.until(lambda: len(received) == 1000, timeout=40)
    assert replay.wait(10) == 0
    np.testing.assert_array_equal(np.concatenate([block.force for block in received]), columns["force_N"])
    assert [block.sequence for block in received] == list(range(0, 20_000, 20))
    assert (received[1].header.stamp.sec, received[1].header.stamp.nanosec) == (1_700_000_000, 20_000_000)


def test_replay_keeps_to_its_speed(bench: FakeDaq, tmp_path: Path, make_columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", make_columns(8000)).close()
    received = bench.receive_samples()
    bench.run("replay", bag=tmp_path / "run", speed=4.0, wait_for_subscriber=True)
    bench.until(lambda: len(received) > 0)
    begin = time.monotonic()
    bench.until(lambda: len(received) == 400)
    assert time.monotonic() - begin == pytest.approx(2.0, abs=0.4)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "bag is missing"),
        ({"bag": "/nowhere/run"}, "no such file"),
        ({"bag": "run.csv"}, "expected a bag"),
        ({"bag": "/nowhere/run", "topics": "[sample]"}, "unknown sample"),
        ({"bag": "/nowhere/run", "speed": -1.0}, "speed"),
    ],
)
def test_replay_refuses_in_one_line(bench: FakeDaq, parameters: dict[str, object], message: str) -> None:
    replay = bench.run("replay", **parameters)
    _, stderr = replay.communicate(timeout=20)
    assert replay.returncode == 2
    assert message in stderr
    assert stderr.count("\n") == 1
