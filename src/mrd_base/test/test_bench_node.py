"""A node as a process: the parameters that it accepts and refuses, and how it ends."""

import contextlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter

from mrd_base.nodes.bench_node import seconds

pytestmark = pytest.mark.realtime

NODE = [sys.executable, str(Path(__file__).with_name("tiny_node.py"))]


def start(*arguments):
    return subprocess.Popen([*NODE, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["-p", "prt:=/dev/x"], "error: node tiny: unknown parameter prt; did you mean port? (--help lists all "),
        (["-p", "limits.stroek_mm:=40"], "unknown parameter limits.stroek_mm; did you mean limits.stroke_mm?"),
        (["-p", "limits.stroke_mm:=abc"], "error: node tiny: limits: stroke_mm: found str 'abc', expected a finite number"),
        (["-p", "limits.stroke_mm:=0.055"], "limits: stroke_mm: found 0.055, expected 1 to 1000 (travel of the damper)"),
        (["-p", "port:=5"], "error: node tiny: port: found int 5, expected str (serial line)"),
        (["-p", "port"], "error: Couldn't parse parameter override rule: '-p port'."),
        (["--params-file", "/nowhere.yaml"], "error: Couldn't parse params file: '--params-file /nowhere.yaml'."),
        (["-p", "use_sim_time:=true"], "error: node tiny: use_sim_time is not supported: the time of this bench is no "),
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
        "offset=0.003, rate=25.0, count=0)\n"
    )
    node.send_signal(end)
    stdout, stderr = node.communicate(timeout=10)
    assert (node.returncode, stdout, stderr) == (0, "closed\n", "")


@contextlib.contextmanager
def listening(*arguments):
    """Run the node, and a listener of the same domain."""
    process = start("--ros-args", "-r", "__ns:=/bench", *arguments)
    rclpy.init()
    try:
        assert process.stdout.readline().startswith("TinySettings(")
        yield process, rclpy.create_node("listener")
    finally:
        rclpy.try_shutdown()
        process.terminate()
        process.communicate(timeout=10)


def call(listener, service_type, name, **fields):
    client = listener.create_client(service_type, f"/bench/tiny/{name}")
    assert client.wait_for_service(timeout_sec=10)
    future = client.call_async(service_type.Request(**fields))
    rclpy.spin_until_future_complete(listener, future, timeout_sec=10)
    return future.result()


def diagnosed(listener):
    received = []
    listener.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    deadline = time.monotonic() + 10
    while not received and time.monotonic() < deadline:
        rclpy.spin_once(listener, timeout_sec=0.1)
    return received[0]


def test_a_running_node_publishes_diagnostics_and_accepts_only_dynamic_parameters():
    with listening() as (process, listener):

        def set_parameter(name, value):
            parameter = Parameter(name, value=value).to_parameter_msg()
            return call(listener, SetParameters, "set_parameters", parameters=[parameter]).results[0]

        assert set_parameter("rate_hz", 100.0).successful
        assert process.stdout.readline() == "rate 100.0\n"
        refused = set_parameter("rate_hz", 101.0)
        assert (refused.successful, refused.reason) == (False, "rate_hz: found 101, expected a multiple of 5")
        assert set_parameter("rate_hz", 200).successful
        assert process.stdout.readline() == "rate 200\n"
        refused = set_parameter("rate_hz", 9000.0)
        assert not refused.successful
        assert "out of range Min: 1.0, Max: 2000.0" in refused.reason
        assert not set_parameter("limits.stroke_mm", 90.0).successful
        # A clock of ROS would let the node stamp by one time and wait by another.
        refused = set_parameter("use_sim_time", True)
        assert not refused.successful
        assert refused.reason.startswith("use_sim_time is not supported")

        message = diagnosed(listener)
        (status,) = message.status
        assert (status.name, status.level, status.message) == ("bench/tiny: state", status.OK, "ok")
        assert status.hardware_id == "tiny 7"
        assert seconds(message.header.stamp) == pytest.approx(time.time(), abs=5)


@pytest.mark.parametrize(
    ("port", "level", "text"),
    [("loose", DiagnosticStatus.WARN, "the port is loose"), ("gone", DiagnosticStatus.ERROR, "the port is gone")],
)
def test_the_diagnostics_tell_warnings_from_errors(port, level, text):
    with listening("-p", f"port:={port}") as (_, listener):
        (status,) = diagnosed(listener).status
        assert (status.level, status.message) == (level, text)


def test_descriptors_tell_unit_range_and_what_is_only_read_at_start():
    names = ["limits.stroke_mm", "limits.force_N", "port", "gains", "offset_mm", "rate_hz", "count", "clock"]
    with listening("-p", "limits.stroke_mm:=40", "-p", "count:=3") as (_, listener):
        descriptors = call(listener, DescribeParameters, "describe_parameters", names=names).descriptors
        values = call(listener, GetParameters, "get_parameters", names=names).values
    stroke, force, port, gains, offset, rate, count, clock = descriptors
    assert stroke.description == "travel of the damper"
    bounds = [(r.from_value, r.to_value) for r in stroke.floating_point_range]
    assert (bounds, stroke.additional_constraints) == ([(1.0, 1000.0)], "1 to 1000")
    assert not force.floating_point_range
    assert [(r.from_value, r.to_value) for r in count.integer_range] == [(0, 2**63 - 1)]
    assert count.additional_constraints == "at least 0"
    assert rate.floating_point_range[0].to_value == 2000.0
    assert [d.read_only for d in descriptors] == [True, True, True, True, True, False, True, True]
    assert (port.type, gains.type) == (ParameterType.PARAMETER_STRING, ParameterType.PARAMETER_DOUBLE_ARRAY)
    assert offset.dynamic_typing
    assert clock.description.startswith("socket of the owner")
    # A whole number is accepted for a real one, and becomes one.
    assert (values[0].type, values[0].double_value) == (ParameterType.PARAMETER_DOUBLE, 40.0)
    assert (values[6].type, values[6].integer_value) == (ParameterType.PARAMETER_INTEGER, 3)


@pytest.mark.parametrize("option", ["--help", "-h"])
def test_help_says_what_the_node_is(option):
    node = subprocess.run([*NODE, option], capture_output=True, text=True, timeout=20)
    assert (node.returncode, node.stderr) == (0, "")
    assert node.stdout.startswith("usage: tiny_node [--ros-args ")
    assert "\nDoes nothing, but does it well.\n" in node.stdout
    assert "\n  limits.stroke_mm  double = 55.0\n      travel of the damper; 1 to 1000\n" in node.stdout
    assert "\n  rate_hz  double = 25.0\n      1 to 2000; may change while the node runs\n" in node.stdout
    assert "\n  offset_mm  double\n" in node.stdout


def test_help_whose_reader_has_had_enough_says_nothing():
    node = subprocess.run(f"{' '.join(NODE)} --help | true", shell=True, capture_output=True, text=True, timeout=20)
    assert (node.stdout, node.stderr) == ("", "")


def test_a_second_node_of_a_name_is_refused_where_the_two_would_disturb_each_other():
    folder = str(Path(__file__).parent)
    program = (
        f"import sys; sys.path.insert(0, {folder!r}); from tiny_node import *; TinyNode.alone = True; run_node(TinyNode)"
    )
    node = [sys.executable, "-c", program]
    with subprocess.Popen(node, stdout=subprocess.PIPE, text=True) as first:
        try:
            assert "TinySettings(" in first.stdout.readline()
            second = subprocess.run(node, capture_output=True, text=True, timeout=20)
            elsewhere = subprocess.Popen([*node, "--ros-args", "-r", "__ns:=/other"], stdout=subprocess.PIPE, text=True)
            with elsewhere:
                assert "TinySettings(" in elsewhere.stdout.readline()
                elsewhere.terminate()
        finally:
            first.terminate()
    assert second.returncode == 2
    assert second.stderr.startswith("error: another /tiny runs on this machine in ROS domain ")
    assert second.stderr.count("\n") == 1
    with subprocess.Popen(node, stdout=subprocess.PIPE, text=True) as after:
        assert "TinySettings(" in after.stdout.readline()
        after.terminate()


@pytest.mark.parametrize(
    ("section", "hint"),
    [("/**/tny", "did you mean tiny?"), ("tini", "did you mean tiny?"), ("/bench/sevro", "did you mean servo?")],
)
def test_a_mistyped_section_of_a_parameter_file_is_named(section, hint, tmp_path):
    """Its parameters would reach nobody, and the node would run on its defaults."""
    file = tmp_path / "bench.yaml"
    file.write_text(f"{section}:\n  ros__parameters: {{port: /dev/file}}\n")
    node = subprocess.run([*NODE, "--ros-args", "--params-file", file], capture_output=True, text=True, timeout=20)
    assert node.returncode == 2
    assert node.stderr.startswith(
        f"error: {file}: section {section}: no node has this name; {hint} (nodes: controller, daq, "
    )
    assert node.stderr.count("\n") == 1
