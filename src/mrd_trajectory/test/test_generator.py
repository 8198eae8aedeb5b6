"""The generator as a process: it publishes the setpoints of a started experiment, and stops."""

import dataclasses
import signal
import subprocess
import time

import numpy as np
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from mrd_base.clock import BenchClock
from mrd_base.lease import Mode
from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED, seconds
from mrd_interfaces.msg import BenchSamples, Lease, Setpoint
from mrd_interfaces.srv import LoadExperiment
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

pytestmark = pytest.mark.realtime

TEXT = """
name: short
duration_s: 2.0
rate_hz: 100
rod: {waveform: sine, amplitude_mm: 5, frequency_hz: 1.0}
coil: {waveform: prbs, low_mA: 0, high_mA: 150, bit_s: 0.2}
"""


class Client:
    """Client of the generator: receives its setpoints and states, and calls its services."""

    def __init__(self):
        self.node = rclpy.create_node("rest_of_the_bench", namespace="test")
        self.setpoints, self.states = [], []
        everything = QoSProfile(depth=1000, reliability=COMMAND.reliability)
        self.node.create_subscription(Setpoint, "setpoint", self.setpoints.append, everything)
        self.node.create_subscription(String, "experiment_state", lambda state: self.states.append(state.data), LATCHED)
        self.stop = self.node.create_publisher(Bool, "emergency_stop", LATCHED)
        services = {"load_experiment": LoadExperiment, "start_experiment": Trigger, "abort_experiment": Trigger}
        self.callers = {name: self.node.create_client(kind, name) for name, kind in services.items()}

    def until(self, condition):
        end = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < end, f"timed out; states so far: {self.states}"
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def during(self, wall):
        end = time.monotonic() + wall
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def call(self, name, **fields):
        client = self.callers[name]
        assert client.wait_for_service(timeout_sec=60.0)
        future = client.call_async(client.srv_type.Request(**fields))
        self.until(future.done)
        return future.result()


@pytest.fixture
def start_generator():
    processes = []

    def start(*parameters):
        arguments = [part for parameter in parameters for part in ("-p", parameter)]
        processes.append(
            subprocess.Popen(
                ["ros2", "run", "mrd_trajectory", "generator", "--ros-args", "-r", "__ns:=/test", *arguments],
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return processes[-1]

    yield start
    for process in processes:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        process.communicate(timeout=60)


@pytest.fixture
def bench():
    rclpy.init()
    try:
        bench = Client()
        yield bench
        bench.node.destroy_node()
    finally:
        rclpy.shutdown()


def test_streams_the_plan_and_comes_to_rest(bench, start_generator):
    process = start_generator()
    bench.until(lambda: bench.states == ["idle"])
    refused = bench.call("start_experiment")
    assert not refused.success
    assert "no experiment is loaded" in refused.message

    loaded = bench.call("load_experiment", experiment=TEXT)
    expected = plan(parse_experiment(TEXT, "t"), Limits(), ForceEnvelope())
    assert loaded.success, loaded.message
    assert (loaded.duration, loaded.rate) == (pytest.approx(expected.duration), 100.0)
    bench.during(0.3)
    assert bench.setpoints == []  # nothing moves that was not asked to

    before = BenchClock().now()
    assert bench.call("start_experiment").success
    assert not bench.call("load_experiment", experiment=TEXT).success  # not while it runs
    assert not bench.call("start_experiment").success
    bench.until(lambda: bench.states[-1] == "done")
    bench.during(0.2)

    stamps = np.array([seconds(message.header.stamp) for message in bench.setpoints])
    start = stamps[0]
    assert before <= start <= before + 1.0
    assert np.median(np.diff(stamps)) == pytest.approx(0.01, rel=0.1)
    at = expected.at(stamps - start)
    for field, values in zip(("position", "velocity", "acceleration", "coil_current"), at, strict=True):
        received = np.array([getattr(message, field) for message in bench.setpoints])
        # The stamp is cut to nanoseconds, so a switch of the coil may fall on either side of it.
        close = np.isclose(received, values, atol=1e-5)
        assert close.mean() > 0.98, field
        assert close.all() or field == "coil_current"
    last = bench.setpoints[-1]
    assert (last.position, last.velocity, last.acceleration, last.coil_current) == (0, 0, 0, 0)
    assert stamps[-1] - start >= expected.duration

    again = bench.call("start_experiment")
    assert not again.success
    assert "load_experiment first" in again.message
    assert bench.states == ["idle", "loaded", "running", "done"]
    process.terminate()
    assert process.wait(timeout=60) == 0


def test_an_experiment_beyond_the_limits_unloads_the_previous_one(bench, start_generator):
    start_generator("limits.stroke_mm:=30.0")
    assert bench.call("load_experiment", experiment=TEXT).success
    refused = bench.call("load_experiment", experiment=TEXT.replace("amplitude_mm: 5", "amplitude_mm: 14"))
    assert not refused.success
    assert refused.message == "rod: position ±14 mm exceeds ±13.5 mm; reduce amplitude_mm from 14 to 13.5"
    assert not bench.call("start_experiment").success
    bench.during(0.2)
    assert bench.setpoints == []


def test_abort_and_emergency_stop_end_the_setpoints(bench, start_generator):
    start_generator()
    ends = {
        "on request": lambda: bench.call("abort_experiment"),
        "emergency stop": lambda: bench.stop.publish(Bool(data=True)),
    }
    for reason, end in ends.items():
        assert bench.call("load_experiment", experiment=TEXT).success
        assert bench.call("start_experiment").success
        count = len(bench.setpoints)
        bench.until(lambda count=count: len(bench.setpoints) > count + 20)
        end()
        bench.until(lambda: bench.states[-1].startswith("aborted"))
        assert bench.states[-1] == f"aborted: {reason}"
        count = len(bench.setpoints)
        bench.during(0.3)
        assert len(bench.setpoints) == count
        assert not bench.call("start_experiment").success
        bench.during(0.2)
        assert len(bench.setpoints) == count


def test_only_the_supervisor_releases_an_emergency_stop(bench, start_generator):
    """The stop is latched as long as the lease is in mode fault, whoever says false on the topic."""
    start_generator()
    leases = bench.node.create_publisher(Lease, "lease", COMMAND)
    bench.until(lambda: leases.get_subscription_count() and bench.stop.get_subscription_count())
    mode = Mode.FAULT

    def renew():
        lease = Lease(holder="supervisor", mode=int(mode))
        lease.header.stamp.sec, lease.header.stamp.nanosec = divmod(int(1e9 * BenchClock().now()), 10**9)
        leases.publish(lease)

    bench.node.create_timer(0.02, renew)
    assert bench.call("load_experiment", experiment=TEXT).success
    bench.stop.publish(Bool(data=True))
    bench.during(0.3)
    bench.stop.publish(Bool(data=False))
    bench.during(0.3)
    refused = bench.call("start_experiment")
    assert not refused.success
    assert refused.message == "the emergency stop is latched; call reset_fault of supervisor first"
    mode = Mode.IDLE
    bench.until(lambda: bench.call("start_experiment").success)
    bench.until(lambda: bench.setpoints)


def test_a_stall_aborts_the_run(bench, start_generator):
    # A stopped process, not a stopped `ros2 run`: the stand-in replaces itself by the node.
    process = start_generator()
    assert bench.call("load_experiment", experiment=TEXT).success
    assert bench.call("start_experiment").success
    bench.until(lambda: len(bench.setpoints) > 20)
    process.send_signal(signal.SIGSTOP)
    bench.during(0.4)
    count = len(bench.setpoints)
    process.send_signal(signal.SIGCONT)
    bench.until(lambda: bench.states[-1].startswith("aborted: no setpoint for "))
    bench.during(0.2)
    assert len(bench.setpoints) == count


def test_a_wrong_parameter_is_refused_in_one_line(start_generator):
    process = start_generator("setpoint_rate:=100.0")
    _, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert err.startswith("error: node generator: unknown parameter setpoint_rate")


PASSES = """
name: passes
duration_s: 0.2
rate_hz: 100
repeats: 200
rod: {waveform: sine, amplitude_mm: 0.1, frequency_hz: 5}
until: {settled_percent: 2}
"""


def publish_samples(bench, publisher, force):
    """Publish the samples of the last 20 ms, whose force is a constant."""
    message = BenchSamples(sample_period=0.005, position=[0.0] * 4, force=[force] * 4, coil_current=[0.0] * 4)
    message.header.stamp = (bench.node.get_clock().now() - Duration(seconds=0.02)).to_msg()
    publisher.publish(message)


def test_ends_with_a_pass_once_the_samples_have_settled(bench, start_generator):
    publisher = bench.node.create_publisher(BenchSamples, "samples", RECORDED)
    start_generator()
    bench.until(lambda: bench.states == ["idle"] and publisher.get_subscription_count())
    assert bench.call("load_experiment", experiment=PASSES).success
    expected = plan(parse_experiment(PASSES, "t"), Limits(), ForceEnvelope())
    assert bench.call("start_experiment").success
    begin, force = time.monotonic(), 200.0

    def ended():
        nonlocal force
        force = max(100.0, 200.0 - 200.0 * (time.monotonic() - begin))  # settles after half a second
        publish_samples(bench, publisher, force)
        return bench.states[-1].startswith("done")

    bench.until(ended)
    assert "done: the peak force settled after " in bench.states[-1]
    last = bench.setpoints[-1]
    assert (last.position, last.velocity, last.coil_current) == (0.0, 0.0, 0.0)
    # The way out is that of the plan, and the rod has taken it from the end of a pass.
    times = np.array([seconds(setpoint.header.stamp) for setpoint in bench.setpoints])
    positions = np.array([setpoint.position for setpoint in bench.setpoints])
    passes = round((times[-1] - times[0] - expected.duration) / expected.period) + 200
    assert 4 < passes < 100
    short = dataclasses.replace(expected, experiment=dataclasses.replace(expected.experiment, repeats=passes))
    assert positions == pytest.approx(short.at(times - times[0]).position, abs=1e-9)


def test_refuses_to_wait_for_a_temperature_that_no_sample_has(bench, start_generator):
    publisher = bench.node.create_publisher(BenchSamples, "samples", RECORDED)
    start_generator()
    bench.until(lambda: bench.states == ["idle"] and publisher.get_subscription_count())
    warm = PASSES.replace("settled_percent: 2", "temperature_degC: 40")

    def refused():
        publish_samples(bench, publisher, 1.0)
        return not bench.call("load_experiment", experiment=warm).success

    bench.until(refused)
    response = bench.call("load_experiment", experiment=warm)
    assert response.message.startswith("until: temperature_degC: no sample has a temperature of the damper; connect its")
