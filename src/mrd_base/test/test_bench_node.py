"""A node as a process: the parameters that it accepts and refuses, and how it ends."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from mrd_base.nodes.bench_node import seconds

pytestmark = pytest.mark.realtime

NODE = [sys.executable, str(Path(__file__).with_name("tiny_node.py"))]


def start(*arguments):
    return subprocess.Popen([*NODE, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["-p", "prt:=/dev/x"], "error: node tiny: unknown parameter prt; did you mean port? (known: limits.stroke_mm, "),
        (["-p", "limits.stroek_mm:=40"], "unknown parameter limits.stroek_mm; did you mean limits.stroke_mm?"),
        (["-p", "limits.stroke_mm:=abc"], "error: node tiny: limits: stroke_mm: found str 'abc', expected a finite number"),
        (["-p", "limits.stroke_mm:=0.055"], "limits: stroke_mm: found 0.055, expected 1 to 1000 (travel of the damper)"),
        (["-p", "port:=5"], "error: node tiny: port: found int 5, expected str (serial line)"),
        (["-p", "port"], "error: Couldn't parse parameter override rule: '-p port'."),
        (["--params-file", "/nowhere.yaml"], "error: Couldn't parse params file: '--params-file /nowhere.yaml'."),
        (["--bogus"], "error: unknown ROS arguments ['--bogus']"),
    ],
)
def test_an_invalid_configuration_ends_the_node_with_one_line(arguments, line):
    node = subprocess.run([*NODE, "--ros-args", *arguments], capture_output=True, text=True, timeout=20)
    assert node.returncode == 2
    assert line in node.stderr
    assert node.stderr.count("\n") == 1
    assert "TinySettings(" not in node.stdout


def test_parameters_without_ros_args_are_refused():
    node = subprocess.run([*NODE, "-p", "port:=/dev/x"], capture_output=True, text=True, timeout=20)
    assert node.stderr == "error: unknown argument -p; parameters and remappings stand after --ros-args\n"
    assert node.returncode == 2


def test_the_command_line_takes_precedence_over_a_parameter_file(tmp_path):
    file = tmp_path / "bench.yaml"
    file.write_text("/**/tiny:\n  ros__parameters: {port: /dev/file, limits: {stroke_mm: 40.0, force_N: 5.0}}\n")
    node = start("--ros-args", "--params-file", str(file), "-p", "port:=/dev/line", "-p", "limits.stroke_mm:=30")
    try:
        config = node.stdout.readline()
    finally:
        node.terminate()
        node.communicate(timeout=20)
    assert "port='/dev/line'" in config
    assert "stroke=0.03, force=5.0" in config


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_parameters_become_the_configuration_and_every_signal_closes_the_node(tmp_path, end):
    file = tmp_path / "bench.yaml"
    file.write_text("""
/**:
  ros__parameters: {limits: {stroke_mm: 40.0}}
/**/other:
  ros__parameters: {what: ever}
""")
    node = start("--ros-args", "--params-file", str(file), "-p", "offset_mm:=3", "-p", "gains:=[1, 3]")
    assert node.stdout.readline() == (
        "TinySettings(limits=RodLimits(stroke=0.04, force=800.0), port='/dev/ttyUSB0', gains=(1.0, 3.0), "
        "offset=0.003, rate=25.0)\n"
    )
    node.send_signal(end)
    stdout, stderr = node.communicate(timeout=10)
    assert (node.returncode, stdout, stderr) == (0, "closed\n", "")


def test_a_running_node_publishes_diagnostics_and_accepts_only_dynamic_parameters():
    process = start("--ros-args", "-r", "__ns:=/bench")
    try:
        assert process.stdout.readline().startswith("TinySettings(")
        rclpy.init()
        listener = rclpy.create_node("listener")
        received = []
        listener.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
        client = listener.create_client(SetParameters, "/bench/tiny/set_parameters")
        assert client.wait_for_service(timeout_sec=10)

        def set_parameter(name, value):
            request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
            future = client.call_async(request)
            rclpy.spin_until_future_complete(listener, future, timeout_sec=10)
            return future.result().results[0]

        assert set_parameter("rate_hz", 100.0).successful
        assert process.stdout.readline() == "rate 100.0\n"
        refused = set_parameter("rate_hz", 9000.0)
        assert (refused.successful, refused.reason) == (False, "rate_hz: found 9000, expected 1 to 2000")
        assert not set_parameter("limits.stroke_mm", 90.0).successful

        deadline = time.monotonic() + 10
        while not received and time.monotonic() < deadline:
            rclpy.spin_once(listener, timeout_sec=0.1)
        (status,) = received[0].status
        assert (status.name, status.level, status.message) == ("bench/tiny: state", status.OK, "ok")
        assert seconds(received[0].header.stamp) == pytest.approx(time.time(), abs=5)
        listener.destroy_node()
    finally:
        rclpy.try_shutdown()
        process.terminate()
        process.communicate(timeout=10)
