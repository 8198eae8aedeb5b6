"""The DAQ as a process, with a fake of the simulated plant's terminals."""

import array
import contextlib
import itertools
import math
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED, seconds
from mrd_bench_driver.nodes.daq import DaqNode
from mrd_interfaces.msg import AnalogInput, AnalogOutput, BenchSamples, BenchState, Calibration, Lease, Setpoint

from .unread_pipe import fill, unread_pipe

pytestmark = pytest.mark.realtime

RATE, BLOCK = 2000.0, 20
# Volts at rest of ai0 to ai4, of which ai3 is not used.
REST = (0.4, 0.1, 2.51, 5.0, 1.66)


class Terminals:
    """Sends readings block by block, numbered on ai0, and receives what the DAQ publishes."""

    def __init__(self, graph: Any) -> None:
        self.graph = graph
        self.sequence = 0
        self.begin = graph.clock.now()
        self.analog_input = graph.node.create_publisher(AnalogInput, "analog_input", RECORDED)
        self._setpoint = graph.node.create_publisher(Setpoint, "setpoint", COMMAND)
        self.emergency_stop = graph.node.create_publisher(Bool, "emergency_stop", LATCHED)
        self.samples: list[BenchSamples] = graph.subscribe("samples", BenchSamples, RECORDED)
        self.calibration: list[Calibration] = graph.subscribe("calibration", Calibration, LATCHED)
        self.output: list[AnalogOutput] = graph.subscribe("analog_output", AnalogOutput, LATCHED)
        self._lease = graph.node.create_publisher(Lease, "lease", COMMAND)
        self.mode: int | None = BenchState.IDLE  # of the lease; None: it is not renewed
        graph.node.create_timer(0.02, self._renew)
        publishers = (self.analog_input, self._setpoint, self.emergency_stop, self._lease)
        self.ready = lambda: (
            all(publisher.get_subscription_count() for publisher in publishers) and self.calibration and self.output
        )

    def send(
        self, *, position: float | None = None, force: float = REST[1], current: float = REST[2], lost: bool = False
    ) -> None:
        """Send a block of voltages."""
        if not lost:
            numbers = self.sequence + np.arange(BLOCK)
            rows = [np.full(BLOCK, volts) for volts in (REST[0], force, current, *REST[3:])]
            rows[0] = 1e-4 * numbers if position is None else np.full(BLOCK, position)
            message = AnalogInput(
                sample_period=1 / RATE,
                sequence=self.sequence,
                channels=[f"ai{k}" for k in range(5)],
                voltage=array.array("d", np.concatenate(rows).tobytes()),
            )
            time = self.begin + self.sequence / RATE
            message.header.stamp.sec, message.header.stamp.nanosec = int(time), int(time % 1 * 1e9)
            self.analog_input.publish(message)
        self.sequence += BLOCK

    def _renew(self) -> None:
        if self.mode is not None:
            lease = Lease(holder="test", mode=self.mode, number=7 if self.mode == BenchState.IDENTIFICATION else 0)
            time = self.graph.clock.now()
            lease.header.stamp.sec, lease.header.stamp.nanosec = int(time), int(time % 1 * 1e9)
            self._lease.publish(lease)

    def enter(self, mode: int) -> None:
        """Change the mode of the bench, and let the DAQ hear it."""
        self.mode = mode
        self.graph.during(0.1)

    def reset_fault(self) -> Any:
        self.enter(BenchState.IDLE)
        return self.graph.call("daq/reset_fault", Trigger)

    def setpoint(self, current: float, age: float = 0.0, lease: int = 7) -> None:
        message = Setpoint(coil_current=current, lease=lease)
        time = self.graph.clock.now() - age
        message.header.stamp.sec, message.header.stamp.nanosec = int(time), int(time % 1 * 1e9)
        self._setpoint.publish(message)

    def set_rate(self, rate: Any) -> Any:
        parameters = [Parameter("rate_hz", value=rate).to_parameter_msg()]
        return self.graph.call("daq/set_parameters", SetParameters, parameters=parameters).results[0]

    def volts(self) -> float:
        return self.output[-1].coil_command

    def drive(self, current: float, volts: float) -> None:
        """Stream a current until its voltage is on the output."""
        if self.mode != BenchState.IDENTIFICATION:
            self.enter(BenchState.IDENTIFICATION)

        def arrived() -> bool:
            self.setpoint(current)
            self.graph.during(0.02)
            return self.volts() == pytest.approx(volts)

        self.graph.until(arrived)


def started(graph: Any) -> Terminals:
    terminals = Terminals(graph)
    graph.start("daq")
    graph.until(terminals.ready)
    return terminals


@pytest.fixture
def own_terminals(graph: Any) -> Terminals:
    """The terminals of a DAQ that a test has to itself."""
    return started(graph)


@pytest.fixture(scope="module")
def shared_terminals(shared_graph: Any) -> Terminals:
    return started(shared_graph)


@pytest.fixture
def terminals(shared_terminals: Terminals) -> Terminals:
    """The terminals of the DAQ that tests share, without a fault and with its averaging started again."""
    graph = shared_terminals.graph
    assert shared_terminals.reset_fault().success
    assert shared_terminals.set_rate(1000.0).successful
    graph.until(lambda: shared_terminals.volts() == 0.0 and shared_terminals.calibration[-1].rate == 1000.0)
    shared_terminals.sequence, shared_terminals.begin = 0, graph.clock.now()
    shared_terminals.samples.clear()
    return shared_terminals


def test_readings_become_samples_without_a_gap_unless_there_was_one(terminals: Terminals) -> None:
    graph = terminals.graph
    for index in range(31):
        terminals.send(lost=index in (10, 11, 20))
    graph.until(lambda: terminals.samples and terminals.samples[-1].sequence + len(terminals.samples[-1].position) == 310)
    numbers = np.concatenate([s.sequence + np.arange(len(s.position)) for s in terminals.samples])
    assert sorted(set(range(310)) - set(numbers.tolist())) == [*range(100, 120), *range(200, 210)]
    assert np.all(np.diff(numbers) > 0)
    position = np.concatenate([s.position for s in terminals.samples])
    # Two readings make a sample: their mean number is 2k + 1/2, at 0.1 mV each and 5 mm/V.
    np.testing.assert_allclose(position, 5e-3 * 1e-4 * (2 * numbers + 0.5), rtol=1e-9)
    for sample in terminals.samples:
        middle = terminals.begin + (2 * sample.sequence + 0.5) / RATE
        assert seconds(sample.header.stamp) == pytest.approx(middle, abs=1e-6)
    sample = terminals.samples[0]
    assert sample.sample_period == 1e-3
    assert sample.force[0] == pytest.approx(19.6133)
    assert sample.coil_current[0] == pytest.approx(0.01 / 0.185)
    assert sample.acceleration[0] == pytest.approx(0.01 * 12.2583125)
    calibration = terminals.calibration[-1]
    assert list(calibration.quantity) == ["position", "force", "coil_current", "acceleration"]
    assert list(calibration.channel) == ["ai0", "ai1", "ai2", "ai4"]
    assert (calibration.rate, calibration.hardware_rate, calibration.device) == (1000.0, 2000.0, "simulated")


def test_the_rate_changes_only_to_a_fraction_of_the_converters(terminals: Terminals) -> None:
    graph = terminals.graph
    refused = terminals.set_rate(30.0)
    assert not refused.successful
    assert refused.reason.endswith("the nearest is 30.303 or 29.8507")
    for _ in range(2):
        terminals.send()
    graph.until(lambda: terminals.samples)
    assert terminals.set_rate(25).successful
    graph.until(lambda: terminals.calibration[-1].rate == 25.0)
    terminals.samples.clear()
    for _ in range(12):
        terminals.send()
    graph.until(lambda: len(terminals.samples) == 3)
    assert [sample.sequence for sample in terminals.samples] == [0, 1, 2]
    assert all(len(sample.position) == 1 and sample.sample_period == 0.04 for sample in terminals.samples)
    assert terminals.samples[0].position[0] == pytest.approx(5e-3 * 1e-4 * (40 + 79 / 2))


def test_the_coil_follows_fresh_setpoints_within_its_limits(terminals: Terminals) -> None:
    graph = terminals.graph
    assert terminals.volts() == 0.0
    terminals.drive(0.5, 2.5)
    terminals.drive(7.0, 5.0)
    terminals.drive(-1.0, 0.0)
    terminals.drive(0.5, 2.5)
    terminals.drive(math.nan, 0.0)
    terminals.drive(0.5, 2.5)
    last = graph.clock.now()
    graph.until(lambda: terminals.volts() == 0.0)
    assert 0.05 < seconds(terminals.output[-1].header.stamp) - last < 1.0
    terminals.setpoint(0.5, age=0.3)
    graph.during(0.1)
    assert terminals.volts() == 0.0
    # A stamp from the future does not keep the coil on.
    terminals.setpoint(0.5, age=-0.09)
    graph.until(lambda: terminals.volts() != 0.0)
    graph.until(lambda: terminals.volts() == 0.0)


def test_a_coil_current_that_does_not_follow_its_command_stops_the_bench(terminals: Terminals) -> None:
    """The terminals read 0 A, whatever is commanded."""
    graph = terminals.graph
    states = graph.subscribe("daq_state", DiagnosticStatus, LATCHED)
    terminals.drive(0.5, 2.5)

    def stopped() -> bool:
        terminals.setpoint(0.5)
        terminals.send()
        graph.during(0.02)
        return bool(states[-1].message.startswith("the coil current is "))

    graph.until(stopped)
    assert "A, commanded 0.50 A; check coil, cable, supply and sensor; call reset_fault" in states[-1].message
    graph.until(lambda: terminals.volts() == 0.0)


@pytest.mark.parametrize("mode", [BenchState.IDLE, BenchState.HOMING])
def test_current_that_nobody_has_asked_for_stops_the_bench_in_every_mode(terminals: Terminals, mode: int) -> None:
    graph = terminals.graph
    states = graph.subscribe("daq_state", DiagnosticStatus, LATCHED)
    terminals.enter(mode)

    def stopped() -> bool:
        terminals.send(current=2.5 + 0.3 * 0.185)
        graph.during(0.02)
        return bool(states[-1].message)

    graph.until(lambda: states)
    graph.until(lambda: stopped() and states[-1].message != "ok")
    assert states[-1].message.startswith(
        "the coil current is 0.30 A, commanded 0.00 A; check coil, cable, supply and sensor"
    )


def test_a_peak_of_force_shorter_than_a_sample_stops_the_bench(terminals: Terminals) -> None:
    """At 25 Hz, a sample is the mean of four blocks, and 441 N."""
    graph = terminals.graph
    states = graph.subscribe("daq_state", DiagnosticStatus, LATCHED)
    assert terminals.set_rate(25.0).successful
    terminals.enter(BenchState.HOMING)
    terminals.send(force=8.4)
    graph.until(lambda: states and states[-1].message.startswith("1648 N on the load cell, limit ±800 N; reduce "))


def test_the_emergency_stop_latches_until_reset_fault(terminals: Terminals) -> None:
    graph = terminals.graph
    terminals.drive(0.5, 2.5)
    terminals.emergency_stop.publish(Bool(data=True))
    graph.until(lambda: terminals.volts() == 0.0)
    stopped = len(terminals.output)
    for _ in range(5):
        terminals.setpoint(0.5)
        graph.during(0.02)
    terminals.emergency_stop.publish(Bool(data=False))
    for _ in range(5):
        terminals.setpoint(0.5)
        graph.during(0.02)
    assert all(output.coil_command == 0.0 for output in terminals.output[stopped:])
    assert terminals.reset_fault().success
    terminals.drive(0.5, 2.5)


def test_the_coil_is_at_0_volts_when_the_node_ends(graph: Any, own_terminals: Terminals) -> None:
    terminals = own_terminals
    process = graph.process("daq")
    terminals.drive(0.5, 2.5)
    process.terminate()
    graph.until(lambda: terminals.volts() == 0.0)
    graph.until(lambda: process.poll() is not None)
    assert process.returncode == 0
    # On a busy machine, the first setpoint may come before the first lease.
    assert [
        line for line in graph.log("daq").splitlines() if "a setpoint is refused: no supervisor watches" not in line
    ] == []


def test_a_tare_needs_rest(graph: Any, own_terminals: Terminals) -> None:
    terminals = own_terminals
    refused = graph.call("daq/tare", Trigger)
    assert (refused.success, refused.message[:16]) == (False, "tare: 0 samples,")
    for _ in range(100):
        terminals.send(position=0.4)
    graph.until(lambda: len(terminals.samples) == 50)
    answer = graph.call("daq/tare", Trigger)
    assert answer.success
    assert answer.message == "zero: coil_current 2.5100 V, acceleration 1.6600 V"
    graph.until(lambda: terminals.calibration[-1].zero[2] == pytest.approx(2.51))
    assert list(terminals.calibration[-1].zero[:2]) == [0.0, 0.0]
    for _ in range(2):
        terminals.send(position=0.4)
    graph.until(lambda: len(terminals.samples) == 51)
    assert terminals.samples[-1].coil_current[-1] == pytest.approx(0.0, abs=1e-9)
    terminals.enter(BenchState.HOMING)
    graph.until(lambda: graph.call("daq/tare", Trigger).message == "the bench is in mode homing; call stop of test first")
    terminals.mode = BenchState.IDENTIFICATION  # in which a tare is allowed before the first setpoint
    graph.until(lambda: graph.call("daq/tare", Trigger).success)
    graph.node.create_timer(0.02, lambda: terminals.setpoint(0.5))
    graph.until(lambda: terminals.volts() != 0.0)
    assert "the bench is in mode identification; call stop of test first" in graph.call("daq/tare", Trigger).message


def test_current_flows_only_under_the_lease(terminals: Terminals) -> None:
    graph = terminals.graph
    for mode, number in ((BenchState.IDLE, 7), (BenchState.IDLE, 0), (BenchState.HOMING, 0), (BenchState.IDENTIFICATION, 6)):
        terminals.enter(mode)
        for _ in range(60 if mode == BenchState.IDENTIFICATION else 5):  # one warning per second
            terminals.setpoint(0.5, lease=number)
            graph.during(0.02)
        assert terminals.volts() == 0.0, (mode, number)
    assert "it carries lease 6, not 7; publishers of setpoint: " in graph.log("daq")
    terminals.drive(0.5, 2.5)
    refused = terminals.set_rate(500.0)
    assert (refused.successful, refused.reason) == (False, "the bench is in mode identification; call stop of test first")
    refused = graph.call("daq/reset_fault", Trigger)
    assert (refused.success, refused.message) == (False, "daq: the bench is in mode identification; call stop of test first")


def test_the_coil_is_off_when_the_supervisor_falls_silent(terminals: Terminals) -> None:
    graph = terminals.graph
    terminals.drive(0.5, 2.5)
    terminals.mode = None
    silent = graph.clock.now()
    graph.node.create_timer(0.02, lambda: terminals.setpoint(0.5))
    graph.until(lambda: terminals.volts() == 0.0)
    assert seconds(terminals.output[-1].header.stamp) - silent < 1.5  # of which 1.0 is the patience of `graph`
    # The stop is latched, whoever comes back.
    outputs = len(terminals.output)
    terminals.enter(BenchState.IDENTIFICATION)
    graph.during(0.2)
    assert len(terminals.output) == outputs
    assert "the supervisor test has been silent for " in graph.log("daq")


def test_a_lease_of_nonsense_ends_nothing(terminals: Terminals) -> None:
    graph = terminals.graph
    terminals.drive(0.5, 2.5)
    stranger = graph.node.create_publisher(Lease, "lease", COMMAND)
    graph.until(stranger.get_subscription_count)
    for mode in (5, 255):
        stranger.publish(Lease(holder="nobody", mode=mode, since=float("nan"), number=2**64 - 1))
    graph.during(0.2)
    assert "a lease of nobody is refused: its mode is 5, expected 0 to 4" in graph.log("daq")
    terminals.drive(0.5, 2.5)


def test_a_button_at_the_daq_works_without_anybody_else(terminals: Terminals) -> None:
    graph = terminals.graph
    states = graph.subscribe("daq_state", DiagnosticStatus, LATCHED)
    terminals.drive(0.5, 2.5)
    assert graph.call("daq/emergency_stop", Trigger).success
    graph.until(lambda: terminals.volts() == 0.0)
    graph.until(lambda: states and states[-1].message == "emergency stop by its service; call reset_fault")
    # It says so again when it is pressed again: a reset may be under way.
    states.clear()
    assert graph.call("daq/emergency_stop", Trigger).success
    graph.until(lambda: [state.message for state in states] == ["emergency stop by its service; call reset_fault"])
    assert terminals.reset_fault().success
    graph.until(lambda: states[-1].level == DiagnosticStatus.OK)


def test_a_plant_that_does_not_fit_is_a_fault_that_reset_fault_clears(terminals: Terminals) -> None:
    graph = terminals.graph
    terminals.drive(0.5, 2.5)
    terminals.analog_input.publish(AnalogInput(sample_period=1e-3, channels=["ai0"], voltage=[0.0]))
    graph.until(lambda: terminals.volts() == 0.0)
    graph.until(lambda: "the plant has no ai1, ai2, ai4" in graph.log("daq"))
    for _ in range(3):
        terminals.send()
        terminals.setpoint(0.5)
        graph.during(0.02)
    assert not terminals.samples
    assert terminals.volts() == 0.0
    assert terminals.reset_fault().success
    for _ in range(4):
        terminals.send()
    graph.until(lambda: terminals.samples)
    terminals.drive(0.5, 2.5)


@pytest.mark.parametrize(
    ("parameters", "line"),
    [
        ({"rate_hz": 30.0}, "the nearest is 30.303 or 29.8507"),
        ({"backend": "nidaq"}, "backend is 'nidaq', expected one of simulated, ni_usb_6216"),
        ({"channels.force.terminal": "SE"}, "terminal is 'SE', expected one of DIFF, RSE, NRSE"),
    ],
)
def test_a_daq_that_cannot_work_says_one_line(graph: Any, parameters: dict[str, Any], line: str) -> None:
    process = graph.start("daq", **parameters)
    assert process.wait(20) == 2
    said = graph.log("daq")
    assert said.startswith("error: ")
    assert line in said
    assert said.count("\n") == 1


BROKEN = """
import threading
from mrd_bench_driver.acquisition import Simulated
from mrd_bench_driver.nodes.daq import main

read, write = Simulated.read, Simulated.write

def read_or_fail(backend):
    block = read(backend)
    if block is not None and block.volts[0, 0] > 5:
        raise RuntimeError("torn")
    return block

def write_or_hang(backend, volts):
    if volts > 3:
        threading.Event().wait()
    write(backend, volts)

Simulated.read, Simulated.write = read_or_fail, write_or_hang
main()
"""
"""A DAQ that hangs in writing more than 3 V, and has a flaw in reading more than 5 V on the LVDT."""


@contextlib.contextmanager
def broken_daq(graph: Any, stderr: Any) -> Iterator[tuple[Terminals, "subprocess.Popen[bytes]"]]:
    terminals = Terminals(graph)
    options = ["--ros-args", "-r", f"__ns:={graph.node.get_namespace()}", "-p", "lease_timeout_ms:=1000.0"]
    with subprocess.Popen([sys.executable, "-c", BROKEN, *options], stderr=stderr) as process:
        try:
            graph.until(terminals.ready)
            yield terminals, process
        finally:
            process.kill()


def test_a_converter_that_hangs_while_it_takes_a_voltage_is_told_and_the_node_goes_on_and_ends(
    graph: Any, tmp_path: Path
) -> None:
    log = tmp_path / "daq.log"
    states = graph.subscribe("daq_state", DiagnosticStatus, LATCHED)
    arrays = graph.subscribe("/diagnostics", DiagnosticArray, 10)
    with log.open("wb") as stderr, broken_daq(graph, stderr) as (terminals, process):
        terminals.drive(0.5, 2.5)
        asked = graph.clock.now()
        terminals.setpoint(0.8)
        graph.until(lambda: states[-1].message != "ok")
        print(f"told after {1e3 * (graph.clock.now() - asked):.0f} ms")
        said = states[-1].message
        assert said.startswith("the coil may still have current, switch its supply off; the converter's output did not answ")
        assert graph.clock.now() - asked < 0.5  # a busy machine takes longer than 0.1 s
        name = f"{graph.node.get_namespace().lstrip('/')}/daq: state"
        graph.until(lambda: (name, said) in [(status.name, status.message) for array in arrays for status in array.status])
        graph.until(lambda: said in log.read_text())
        for _ in range(10):
            terminals.send()
        graph.until(lambda: len(terminals.samples) >= 5)
        # Nobody waits for the converter.
        assert graph.call("daq/emergency_stop", Trigger).success
        assert not terminals.reset_fault().success
        process.terminate()
        assert process.wait(4.0) == 0


def test_a_flaw_in_reading_ends_the_node_after_0_volts_and_with_its_traceback(graph: Any, tmp_path: Path) -> None:
    log = tmp_path / "daq.log"
    states = graph.subscribe("daq_state", DiagnosticStatus, LATCHED)
    with log.open("wb") as stderr, broken_daq(graph, stderr) as (terminals, process):
        terminals.drive(0.5, 2.5)
        terminals.send(position=6.0)
        graph.until(lambda: process.poll() is not None)
        graph.until(lambda: terminals.volts() == 0.0 and states[-1].message == "internal error: RuntimeError('torn')")
    assert "RuntimeError: torn" in log.read_text().splitlines()


def test_a_log_that_blocks_keeps_nobody_from_0_volts(graph: Any) -> None:
    """Nobody reads the pipe, as if a terminal stood still."""
    states = graph.subscribe("daq_state", DiagnosticStatus, LATCHED)
    with unread_pipe() as stderr, broken_daq(graph, stderr) as (terminals, _):
        terminals.drive(0.5, 2.5)
        fill(stderr)
        terminals.analog_input.publish(AnalogInput(sample_period=1e-3, channels=["ai0"], voltage=[0.0]))
        graph.until(lambda: terminals.volts() == 0.0)
        graph.until(lambda: states[-1].message.startswith("the plant has no ai1, ai2, ai4"))


def test_a_log_of_something_refused_that_blocks_keeps_nobody_from_0_volts(graph: Any) -> None:
    """ROS logs with Python locked: all threads of the node waited for a terminal that stood still."""
    with unread_pipe() as stderr, broken_daq(graph, stderr) as (terminals, _):
        terminals.drive(0.5, 2.5)
        fill(stderr)
        terminals.setpoint(0.8, lease=8)
        graph.during(0.3)
        terminals.emergency_stop.publish(Bool(data=True))
        graph.until(lambda: terminals.volts() == 0.0)


class HungDaq:
    """A DAQ node whose callbacks the test calls: nobody spins it, as if a callback hung. A plant follows its output."""

    def __init__(self) -> None:
        self.node = DaqNode()
        self.volts = [0.0]
        self.problems = [""]  # when each voltage was set
        self.node._backend.send = self._set
        self._numbers = itertools.count(0, BLOCK)

    def _set(self, volts: float) -> None:
        self.volts.append(volts)
        self.problems.append(self.node._daq.problem)

    def renew(self, mode: int) -> None:
        self.node._lease._on_lease(Lease(header=self._header(), holder="test", mode=mode, number=7))

    def drive(self) -> None:
        self.renew(BenchState.IDENTIFICATION)
        self.node._on_setpoint(Setpoint(header=self._header(), coil_current=0.5, lease=7))
        assert self.volts[-1] == 2.5

    def _header(self) -> Any:
        header = Lease().header
        header.stamp = self.node.stamp()
        return header

    def read(self) -> None:
        """Let the converter deliver a block, in which the coil has the current that was asked for."""
        current = 2.5 + 0.185 * 0.2 * self.volts[-1]
        rows = [np.full(BLOCK, volts) for volts in (REST[0], REST[1], current, REST[4])]
        inputs = ["ai0", "ai1", "ai2", "ai4"]
        self.node._backend.feed(next(self._numbers), self.node.bench.now(), 1 / RATE, inputs, np.concatenate(rows))
        time.sleep(0.01)


@pytest.fixture
def hung(monkeypatch: pytest.MonkeyPatch) -> Iterator[HungDaq]:
    # On a busy machine, neither may be old before the test has gone on.
    options = ["-p", "lease_timeout_ms:=1000.0", "-p", "setpoint_timeout_ms:=300.0"]
    monkeypatch.setattr("sys.argv", ["daq", "--ros-args", *options])
    rclpy.init(args=["--ros-args", "-r", "__ns:=/hung"])
    daq = HungDaq()
    yield daq
    daq.node.close()
    daq.node.destroy_node()
    rclpy.shutdown()


def test_a_daq_whose_callbacks_hang_sets_0_volts_as_long_as_it_reads(hung: HungDaq) -> None:
    hung.read()
    hung.drive()
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        hung.read()
    # The setpoint is old first, which stops nothing for good. Then the lease is lost.
    assert (hung.volts, hung.problems) == ([0.0, 2.5, 0.0], ["", "", ""])
    assert hung.node.health()[0].startswith("the supervisor test has been silent for ")


def test_the_coil_is_off_when_the_bench_may_move_no_more_and_the_next_run_may_switch_it_on(hung: HungDaq) -> None:
    hung.drive()
    hung.renew(BenchState.IDLE)
    assert hung.volts == [0.0, 2.5, 0.0]
    assert hung.node.health()[0] == ""
    hung.drive()
