"""The controller as a process in wall-clock time: a missed deadline, and bad goals."""

import array
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest
import rclpy

from mrd_base.clock import BenchClock
from mrd_base.nodes.graph import CONTROL_CYCLE, CONTROL_STATE, LOAD_CONTROL, SAMPLES, SETPOINT, START_CONTROL
from mrd_control.experiment import format_control_experiment, read_control_experiment

pytestmark = pytest.mark.realtime

SHIPPED = read_control_experiment(Path(__file__).resolve().parents[3] / "config/control/hybrid_test.yaml")
COUNT, PERIOD = 4, 1e-3
AGE = 4e-3
"""s since the last sample of a block when it is sent, longer than the deadline of the test."""


class Bench:
    """The rest of the bench: samples for the controller, and what it says."""

    def __init__(self):
        self.node, self.clock = rclpy.create_node("rest_of_the_bench", namespace="test"), BenchClock()
        self.setpoints, self.states, self.cycles = [], [], []
        self._samples = SAMPLES.publisher(self.node)
        SETPOINT.subscription(self.node, self.setpoints.append)
        CONTROL_CYCLE.subscription(self.node, self.cycles.append)
        CONTROL_STATE.subscription(self.node, lambda state: self.states.append(state.data))
        self._callers = {
            service.name: self.node.create_client(service.type, service.name) for service in (LOAD_CONTROL, START_CONTROL)
        }
        self._sequence = 0

    def send_block(self):
        first = round(1e9 * (self.clock.now() - AGE - (COUNT - 1) * PERIOD))
        zeros = array.array("d", bytes(8 * COUNT))
        message = SAMPLES.type(sample_period=PERIOD, sequence=self._sequence)
        message.position = message.force = message.coil_current = message.acceleration = zeros
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(first, 10**9)
        self._samples.publish(message)
        self._sequence += COUNT

    def until(self, condition, samples=False):
        end = time.monotonic() + 120.0
        while not condition():
            assert time.monotonic() < end, f"timed out; states so far: {self.states}"
            if samples:
                self.send_block()
            rclpy.spin_once(self.node, timeout_sec=0.005)

    def call(self, service, samples=False, **fields):
        client = self._callers[service.name]
        self.until(client.service_is_ready)
        future = client.call_async(service.type.Request(**fields))
        self.until(future.done, samples)
        return future.result()


@pytest.fixture(scope="module")
def controller():
    command = ["ros2", "run", "mrd_control", "controller", "--ros-args", "-r", "__ns:=/test"]
    process = subprocess.Popen([*command, "-p", "deadline_ms:=1.0", "-p", "stale_ms:=130.0"])
    yield process
    process.send_signal(signal.SIGTERM)
    process.wait(60)


@pytest.fixture
def bench(controller):
    rclpy.init()
    try:
        bench = Bench()
        yield bench
        assert controller.poll() is None, "the controller has ended"
        bench.node.destroy_node()
    finally:
        rclpy.shutdown()


@pytest.mark.timeout(300)
def test_a_missed_deadline_ends_the_test_without_current_where_the_rod_is_and_is_named(bench):
    test = format_control_experiment(replace(SHIPPED, law="constant_current", gains={"current": 0.3}))
    for _ in range(20):
        assert bench.call(LOAD_CONTROL, experiment=test).success
        bench.setpoints.clear()
        bench.cycles.clear()
        bench.states.clear()
        assert bench.call(START_CONTROL, samples=True).success
        bench.until(lambda: any(state.startswith("aborted") for state in bench.states), samples=True)
        if "stale force" not in bench.states[-1]:  # where the machine paused for longer than that
            break
    assert "missed deadline: a setpoint came" in bench.states[-1]
    assert "ms after its sample, limit 1 ms; this machine is busy" in bench.states[-1]
    bench.until(lambda: len(bench.setpoints) >= 2 and bench.cycles)
    # It is the first cycle already; what comes later is answered by nothing.
    for _ in range(20):
        bench.send_block()
        rclpy.spin_once(bench.node, timeout_sec=0.02)
    late, last = bench.setpoints
    assert late.coil_current == 0.3
    assert last.coil_current == 0.0
    assert (last.position, last.velocity) == (late.position, late.velocity)
    (cycle,) = bench.cycles
    assert cycle.missed == 1
    assert cycle.latency > AGE


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("skyhook_viscous: 3000", "skyhook_viscous: much", "skyhook_viscous is 'much', expected a finite number"),
        ("system: quarter_car", "system: [quarter_car]", "unknown system"),
        ("viscous: 900", "viscous: null", "viscous is None, expected a finite number"),
    ],
)
def test_a_bad_goal_does_not_end_the_controller(bench, old, new, said):
    text = format_control_experiment(SHIPPED)
    bad = Path(__file__).resolve().parents[3].joinpath("config/control/hybrid_test.yaml").read_text().replace(old, new)
    refused = bench.call(LOAD_CONTROL, experiment=bad)
    assert not refused.success
    assert said in refused.message
    assert bench.call(LOAD_CONTROL, experiment=text).success
