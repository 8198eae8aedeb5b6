"""The plant as a process: serial port, analog topics, faults on purpose."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
import serial
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from mrd_base.nodes.bench_node import LATCHED, RECORDED, seconds
from mrd_interfaces.msg import AnalogInput, AnalogOutput

pytestmark = pytest.mark.realtime

NODE = [sys.executable, "-c", "from mrd_sim.nodes.plant import main; main()", "--ros-args"]


class Graph:
    """A plant in a process of its own and someone who listens."""

    def __init__(self, link, *parameters):
        arguments = [text for p in (f"port_link:={link}", *parameters) for text in ("-p", p)]
        self.process = subprocess.Popen([*NODE, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        rclpy.init()
        self.node = rclpy.create_node("listener")
        self.blocks = []
        self.states = []
        self.node.create_subscription(AnalogInput, "analog_input", self.blocks.append, RECORDED)
        self.node.create_subscription(JointState, "plant/true_state", self.states.append, 10)
        self.output = self.node.create_publisher(AnalogOutput, "analog_output", LATCHED)
        self.client = self.node.create_client(SetParameters, "plant/set_parameters")
        try:
            self.until(lambda: self.blocks and self.states and self.client.service_is_ready())
        except BaseException:
            self.end()  # or ROS could not be started for the next test
            raise

    def until(self, condition):
        deadline = time.monotonic() + 60.0
        while not condition():
            assert time.monotonic() < deadline, "nothing came"
            assert self.process.poll() is None, self.process.stderr.read()
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def spin(self, duration):
        deadline = time.monotonic() + duration
        while time.monotonic() < deadline:
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def set_fault(self, fault):
        request = SetParameters.Request(parameters=[Parameter("fault", value=fault).to_parameter_msg()])
        future = self.client.call_async(request)
        self.until(future.done)
        return future.result().results[0]

    def end(self):
        self.node.destroy_node()
        rclpy.try_shutdown()
        self.process.send_signal(signal.SIGINT)
        return self.process.communicate(timeout=60)


@pytest.fixture
def graph(tmp_path):
    started = Graph(tmp_path / "motor", "start_position_mm:=-5.0", "pace:=1.0")
    yield started
    if started.process.poll() is None:
        started.end()


def test_serial_port_to_analog_volts(graph, tmp_path):
    link = tmp_path / "motor"
    graph.output.publish(AnalogOutput(coil_command=2.5))
    with serial.Serial(str(link), 9600, timeout=1, write_timeout=1, exclusive=True) as port:
        port.write(b"EIGN(W,0) ZS EL=8000 ADT=1638 VT=131072 PT=3000 G RB(0,2) ")
        assert port.read_until(b"\r") == b"1\r"
        graph.spin(1.2)
        port.write(b"RPA ")
        assert int(port.read_until(b"\r")) == pytest.approx(3000, abs=60)
    first, last = graph.blocks[0], graph.blocks[-1]
    assert list(last.channels) == ["ai0", "ai1", "ai2", "ai3", "ai4", "ai5"]
    assert last.sample_period == 1 / 2000
    # No sample is left out: each block starts where the one before ended, in number and in time.
    expected = first.sequence
    for block in graph.blocks:
        assert block.sequence == expected
        expected += len(block.voltage) // 6
        elapsed = seconds(block.header.stamp) - seconds(first.header.stamp)
        assert elapsed == pytest.approx((block.sequence - first.sequence) / 2000, abs=1e-5)
    assert seconds(last.header.stamp) == pytest.approx(time.time(), abs=10.0)
    volts = np.array(last.voltage).reshape(6, -1)
    position = -0.005 + 3000 * np.pi * 0.064 / 320000
    assert volts[0].mean() == pytest.approx(0.002 + 200 * position, abs=0.02)
    assert volts[2].mean() == pytest.approx(2.508 + 0.5 * 0.185, abs=0.01)
    assert graph.states[-1].position[0] == pytest.approx(position, abs=5e-5)
    assert len(graph.states[-1].velocity) == len(graph.states[-1].effort) == 2

    assert graph.end()[1] == ""
    assert graph.process.returncode == 0
    assert not os.path.lexists(link)


def test_faults_come_and_go(graph, tmp_path):
    link = tmp_path / "motor"
    refused = graph.set_fault("fire")
    assert not refused.successful
    assert "unknown fault fire" in refused.reason

    assert graph.set_fault("unplug").successful
    assert not os.path.lexists(link)
    assert graph.set_fault("freeze_daq").successful
    assert link.exists()
    graph.spin(0.2)
    graph.blocks.clear()
    graph.states.clear()
    graph.spin(0.5)
    assert graph.blocks == []
    assert graph.states, "the plant itself goes on"
    assert graph.set_fault("").successful
    graph.until(lambda: graph.blocks)


def test_time_waits_for_nothing_but_its_pace(tmp_path):
    graph = Graph(tmp_path / "motor", "pace:=0.0")
    graph.blocks.clear()
    graph.spin(1.0)
    free = len(graph.blocks) * 0.02
    graph.end()
    graph = Graph(tmp_path / "motor", "pace:=2.0")
    graph.blocks.clear()
    graph.spin(1.0)
    paced = len(graph.blocks) * 0.02
    graph.end()
    assert 0.5 < paced < 2.5 < free


def test_a_link_that_is_taken_is_one_line(tmp_path):
    (tmp_path / "motor").write_text("precious")
    node = subprocess.run([*NODE, "-p", f"port_link:={tmp_path / 'motor'}"], capture_output=True, text=True, timeout=60)
    assert node.returncode == 2
    assert node.stderr.startswith("error: port_link ")
    assert node.stderr.count("\n") == 1
