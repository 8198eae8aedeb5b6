"""The manners of the bench towards users of ROS, as docs/ros.md describes them."""

import ast
import contextlib
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from ament_index_python import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray

from mrd_base.nodes.graph import ACTIONS, NODES, SERVICES, TOPICS
from mrd_bench_driver.processes import ProcessSpec, bench_processes, find_executable
from mrd_runs import read_run
from mrd_runs.bag import read_bag

sys.path.insert(0, str(Path(__file__).parent))
from stranger import load, rows, section
from whole_bench import WholeBench

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/ros.md"
BENCH = ROOT / "config/bench.yaml"
SHORT = """
name: short
duration_s: 1.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 8.0, frequency_hz: 1.0}
coil: {waveform: constant, level_mA: 100.0}
"""


# The page


def test_the_page_is_written_from_the_code() -> None:
    written = subprocess.run([sys.executable, ROOT / "docs/tables/ros.py", "--check"], capture_output=True, text=True)
    assert written.returncode == 0, written.stderr


def test_the_names_of_the_graph_stand_in_one_place() -> None:
    making = {"create_publisher", "create_subscription", "create_service", "create_client", "ActionServer", "ActionClient"}
    found = []
    for file in sorted((ROOT / "src").glob("mrd_*/mrd_*/nodes/*.py")):
        for call in (node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Call)):
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            if name in making and any(isinstance(argument, ast.Constant) for argument in call.args):
                found.append(f"{file}:{call.lineno}: declare this in mrd_base/nodes/graph.py")
    assert not found


@pytest.fixture(scope="class")
def again(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WholeBench]:
    """The whole bench, the nodes that analyse, and a replay of a first run in a namespace of its own."""
    tmp_path = tmp_path_factory.mktemp("again")
    with WholeBench(tmp_path, control_cycle=0.004) as bench:
        first = bench.client.run_experiment(SHORT, tmp_path / "first", 0)
        assert first.success, first.message
        for package, name in (("mrd_identification", "identifier"), ("mrd_diagnosis", "diagnoser")):
            bench.processes.specs[name] = ProcessSpec(package, name)
            bench.processes.start(name)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        bench.processes.specs["page"] = ProcessSpec(
            "mrd_dashboard", "page", {"port": port, "runs": str(tmp_path), "bench": str(BENCH)}, (BENCH,), guest=True
        )
        bench.processes.start("page")
        options = ["-r", "__ns:=/again", "-p", f"bag:={tmp_path / 'first'}", "-p", "wait_for_subscriber:=true"]
        replay = subprocess.Popen([find_executable("mrd_runs", "replay"), "--ros-args", *options])
        yield bench
        replay.terminate()
        replay.wait(20)


@pytest.mark.realtime
class TestEveryNode:
    """Tests that share the nodes, because the start of all of them takes long."""

    @pytest.mark.timeout(240)
    def test_the_running_graph_is_the_declared_one(self, again: WholeBench) -> None:
        """Who publishes and subscribes, and with which quality of service. The client of the fixture has ends of its own."""
        node, running = again.client.node, set(again.processes.running)
        # A node publishes `refusals` from its first refusal on.
        assert not again.client.run_experiment("", Path("/nowhere"), 0).success
        later = {"identifier", "diagnoser"}

        def wrong() -> list[str]:
            found = []
            for topic in TOPICS:
                name = topic.name if topic.name.startswith("/") else f"/bench/{topic.name}"
                publishers, subscribers = node.get_publishers_info_by_topic(name), node.get_subscriptions_info_by_topic(name)
                for infos, declared in ((publishers, topic.publishers), (subscribers, topic.subscribers)):
                    actual, expected = {info.node_name for info in infos} & running, set(declared) & running
                    if actual != expected and not (topic.name == "refusals" and expected - actual == later):
                        found.append(f"{topic.name}: {sorted(actual)}, declared {sorted(expected)}")
                for profile in (info.qos_profile for info in publishers if info.node_name in running):
                    if (profile.reliability, profile.durability) != (topic.qos.reliability, topic.qos.durability):
                        found.append(f"{topic.name}: {profile}")
            return found

        again.client.spin(lambda: not wrong(), 60)  # the page takes some seconds to start
        assert wrong() == []

    @pytest.mark.timeout(500)
    def test_a_stranger_gets_an_answer_to_every_name(self, again: WholeBench, tmp_path: Path) -> None:
        (tmp_path / "short.yaml").write_text(SHORT)
        command = [sys.executable, ROOT / "tests/stranger.py", PAGE, tmp_path / "short.yaml", tmp_path / "stranger"]
        stranger = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while stranger.poll() is None:
            again.client.spin(lambda: False, 0.2)
        output, errors = stranger.communicate()
        assert stranger.returncode == 0, errors
        report = json.loads(output)
        assert report["wrong"] == []
        page = PAGE.read_text()
        assert {row["topic"] for row in rows(section(page, "topics"))} == set(report["topics"])
        assert [name for name, count in report["topics"].items() if not count] == []
        assert {row["service"] for row in rows(section(page, "services"))} == set(report["services"])
        assert [name for name, (success, message) in report["services"].items() if not (success or message)] == []
        for name in ("reset_fault", "stop", "load_experiment", "start_recording", "stop_recording"):
            assert report["services"][name][0], (name, report["services"][name])
        answers = report["actions"]
        for name in ("run_experiment", "run_control", "run_set", "identify", "diagnose"):
            assert answers[name]["good"][0] == "succeeded", answers[name]
            assert answers[name]["good"][2] > 0, f"{name} gives no feedback"
        status, message, _ = answers["diagnose_on_bench"]["good"]
        assert status == "aborted"
        assert message.startswith("budget: found 1 s of bench time, expected at least ")
        for name in ("run_experiment", "run_set", "identify", "diagnose", "diagnose_on_bench"):
            status, message, _ = answers[name]["cancelled"]
            assert status == "cancelled", answers[name]
            assert "cancelled" in message
        for name, answer in answers.items():
            assert answer["empty"][0] == "rejected", name
            assert answer["empty"][1].startswith(f"{name}: "), name
        assert report["efforts"]
        assert set(report["efforts"]) == {1}
        assert report["not a number"] == 0


@pytest.mark.realtime
@pytest.mark.timeout(240)
def test_plots_have_scalars_and_joint_states_come_once_the_rod_is_homed(new_bench: Any, tmp_path: Path) -> None:
    bench = new_bench
    joints = bench.subscribe("joint_states", *next((t.type, t.qos) for t in TOPICS if t.name == "joint_states"))
    bench.client.spin(lambda: len(bench.servo) > 20, 20)
    assert not any(state.homed for state in bench.servo)
    assert joints == []
    result = bench.client.run_experiment(SHORT, tmp_path / "bag", 0)
    assert result.success, result.message
    run = read_run(tmp_path / "bag")
    bag = read_bag(tmp_path / "bag")
    means = [
        bag.types.deserialize_cdr(cdr, "mrd_interfaces/msg/Measurement") for cdr in bag.topics["/bench/measurement"].messages
    ]
    assert len(means) == pytest.approx(len(run) / 10, abs=3)
    first = bag.types.deserialize_cdr(bag.topics["/bench/samples"].messages[0], "mrd_interfaces/msg/BenchSamples")
    start = first.header.stamp.sec + 1e-9 * first.header.stamp.nanosec
    times = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in means]) - start
    inside = (times > 0.05) & (times < run.time[-1] - run.time[0] - 0.05)
    for scalar, samples in (("position", run.position), ("force", run.force), ("coil_current", run.current)):
        smooth = np.convolve(samples, np.ones(10) / 10, "same")
        values = np.array([getattr(m, scalar) for m in means])
        expected = np.interp(times, run.time - run.time[0] - 0.5 * 0.002, smooth)
        assert np.allclose(values[inside], expected[inside], atol=1e-3 * np.ptp(samples)), scalar
    velocity = np.array([m.velocity for m in means])
    assert np.max(np.abs(velocity)) == pytest.approx(2 * np.pi * 8e-3, rel=0.1)
    recorded = bag.topics["/bench/joint_states"]
    joint = bag.types.deserialize_cdr(recorded.messages[-1], "sensor_msgs/msg/JointState")
    assert list(joint.name) == ["rod"]
    assert joint.effort[0] == pytest.approx(run.force[-100:].mean(), abs=20)


# Share


def share(path: str) -> Path:
    return Path(get_package_share_directory("mrd_bringup"), path)


def test_the_launch_file_starts_the_nodes_of_a_real_bench(tmp_path: Path) -> None:
    bench = tmp_path / "bench.yaml"
    bench.write_text((ROOT / "config/bench.yaml").read_text().replace("backend: simulated", "backend: ni_usb_6216"))
    expected = [(spec.package, spec.executable) for spec in bench_processes(bench, None, tmp_path / "motor")]
    launch = ElementTree.parse(share("launch/bench.launch.xml")).getroot()
    nodes = list(launch.iter("node"))
    assert [(node.get("pkg"), node.get("exec")) for node in nodes] == expected
    for node in nodes:
        find_executable(node.get("pkg"), node.get("exec"))
        assert node.get("name") == node.get("exec") in NODES
        assert [parameter.get("from") for parameter in node.findall("param")] == ["$(var bench)"]
    defaults = {argument.get("name"): argument.get("default") for argument in launch.iter("arg")}
    assert defaults == {"namespace": "bench", "bench": "$(env MRD_BENCH)"}
    assert [push.get("namespace") for push in launch.iter("push-ros-namespace")] == ["$(var namespace)"]


def test_the_layouts_show_fields_that_exist() -> None:
    curves = ElementTree.parse(share("layouts/plotjuggler.xml")).getroot().iter("curve")
    paths = {
        curve.get(key).replace("/", ".") for curve in curves for key in ("name", "curve_x", "curve_y") if curve.get(key)
    }
    layout = json.loads(share("layouts/foxglove.json").read_text())
    for panel in layout["configById"].values():
        plotted = [*panel.get("paths", []), *filter(None, [panel.get("xAxisPath")])]
        paths |= {path["value"].replace("/", ".") for path in plotted}
    placed = re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
    fields = {
        f".bench.{topic.name}.{field}"
        for topic in TOPICS
        if hasattr(topic.type, "get_fields_and_field_types")
        for field in topic.type.get_fields_and_field_types()
    }
    assert len(paths) > 5
    assert {path for path in paths if "[" not in path} <= fields
    assert {
        f".bench.measurement.{name}" for name in ("position", "velocity", "force", "coil_current", "acceleration")
    } <= paths
    assert ".bench.temperature.temperature" in paths


def test_sourcing_the_workspace_is_enough() -> None:
    """No env.sh: the discovery, the transport and the parameter file come by a hook."""
    names = ["ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "MRD_BENCH"]
    program = find_executable("mrd_bench_driver", "servo")
    script = f". {ROOT}/install/setup.bash; printenv {' '.join(names)}; {program} --help"
    clean = {"PATH": "/usr/bin:/bin", "HOME": os.environ["HOME"]}
    entered = subprocess.run(["bash", "-c", script], env=clean, capture_output=True, text=True)
    assert (entered.returncode, entered.stderr) == (0, "")
    discovery, profiles, bench, *help_text = entered.stdout.splitlines()
    assert discovery == "SYSTEM_DEFAULT"
    assert Path(profiles).resolve() == ROOT / "config/fastdds.xml"
    assert Path(bench) == share("config/bench.yaml")
    assert Path(bench).resolve() == ROOT / "config/bench.yaml"
    assert help_text[0].startswith("usage: servo ")


@pytest.mark.parametrize("row", sorted(NODES))
def test_every_node_explains_itself(row: str) -> None:
    (package,) = re.findall(rf"^`ros2 run (\w+) {row}`$", PAGE.read_text(), re.MULTILINE)
    told = subprocess.run(["ros2", "run", package, row, "--help"], capture_output=True, text=True, timeout=60)
    assert (told.returncode, told.stderr) == (0, "")
    assert told.stdout.startswith(f"usage: {row} [--ros-args")
    for topic in TOPICS:
        assert (f"\n  {topic.name}  " in told.stdout) == (row in topic.publishers + topic.subscribers), topic.name


@pytest.mark.realtime
@pytest.mark.parametrize("keys", ["none", "empty"])
def test_without_its_keys_no_node_of_a_secured_bench_starts(keys: str, tmp_path: Path) -> None:
    """Nor where the middleware knows no security: nothing runs unprotected that was to be protected."""
    enclave = tmp_path / "enclaves/bench/generator"
    if keys == "empty":
        enclave.mkdir(parents=True)
    secured = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(tmp_path)}
    command = ["ros2", "run", "mrd_trajectory", "generator", "--ros-args", "--enclave", "/bench/generator"]
    node = subprocess.run(command, env={**os.environ, **secured}, capture_output=True, text=True, timeout=60)
    assert node.returncode == 2
    assert node.stderr.startswith("error: ")
    assert node.stderr.count("\n") == 1
    assert "SECURITY ERROR: directory" in node.stderr or "security" in node.stderr


def test_only_supervisor_and_operator_may_command() -> None:
    enclaves = {
        enclave.get("path"): {
            (group.tag, *group.attrib): [entry.text for entry in group]
            for group in enclave.iter()
            if "ALLOW" in group.attrib.values()
        }
        for enclave in ElementTree.parse(share("security/policies.xml")).getroot().iter("enclave")
    }
    assert enclaves.keys() == {f"/bench/{name}" for name in (*NODES, "operator", "observer")}

    def may(kind: str, right: str, name: str = "") -> set[str]:
        return {
            path
            for path, rules in enclaves.items()
            if any(not name or name == entry for entry in rules.get((kind, right), []))
        }

    assert may("topics", "publish", "lease") == {"/bench/supervisor"}
    assert may("topics", "publish", "emergency_stop") == {"/bench/supervisor", "/bench/operator", "/bench/page"}
    assert may("topics", "publish", "setpoint") == {"/bench/generator", "/bench/controller", "/bench/replay"}
    assert may("services", "request") == {"/bench/supervisor", "/bench/operator"}
    assert may("actions", "call") == {"/bench/operator", "/bench/diagnoser"}
    assert may("actions", "call", "run_set") == {"/bench/operator"}
    assert may("actions", "call", "run_experiment") == {"/bench/operator", "/bench/diagnoser"}
    assert set(enclaves["/bench/observer"]["topics", "publish"]) == {"/rosout", "/parameter_events"}


# Bring-up by hand


def commands(name: str) -> list[str]:
    """Return the lines of a block of commands of the page."""
    text = section(PAGE.read_text(), name)
    return [line for line in text.splitlines() if line and not line.startswith("```")]


@pytest.mark.realtime
@pytest.mark.timeout(240)
def test_the_bring_up_by_hand_works_as_it_is_written(tmp_path: Path) -> None:
    """The nodes are started as the page says, and the script of the page homes the rod and runs the experiment."""
    for folder in ("config", "examples"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    environment = {**os.environ, "HOME": str(tmp_path), "MRD_BENCH": str(share("config/bench.yaml"))}
    with contextlib.ExitStack() as stack:
        processes = []

        def end() -> None:
            for process in reversed(processes):
                os.killpg(process.pid, signal.SIGINT)
                process.wait(30)

        stack.callback(end)
        for line in commands("nodes by hand"):
            options = {"cwd": tmp_path, "env": environment, "start_new_session": True}
            processes.append(subprocess.Popen(["bash", "-c", f"exec {line}"], **options))
        context = rclpy.Context()
        rclpy.init(context=context)
        stack.callback(context.try_shutdown)
        node = rclpy.create_node("hand", context=context)
        executor = rclpy.executors.SingleThreadedExecutor(context=context)
        executor.add_node(node)
        up: set[str] = set()
        node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda message: up.update(status.name for status in message.status), 10
        )
        deadline = time.monotonic() + 90.0
        while len(up) < len(processes):
            assert [process.poll() for process in processes] == [None] * len(processes)
            assert time.monotonic() < deadline
            executor.spin_once(timeout_sec=0.05)
        node.destroy_node()
        for line in commands("script by hand"):
            done = subprocess.run(
                ["bash", "-c", line], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=150
            )
            assert done.returncode == 0, f"{line}\n{done.stderr}"
    assert " 0 lost" in done.stdout or "lost           │ 0 " in done.stdout


def test_the_calls_of_an_installed_ros_say_what_the_script_does() -> None:
    """`ros2 service` and `ros2 action` are not among the wheels: these lines are compared with the graph and the script."""
    call, goal, _ = commands("calls by hand")
    _, _, _, name, kind, text = shlex.split(call)
    load(kind).Request(**yaml.safe_load(text))
    assert name.removeprefix("/bench/") in {service.name for service in SERVICES}
    _, _, _, _, name, kind, text = shlex.split(goal)
    request = load(kind).Goal(**yaml.safe_load(text))
    assert name.removeprefix("/bench/") in {action.name for action in ACTIONS}
    assert shlex.split(commands("script by hand")[0])[2:] == [request.experiment, request.bag]


def test_the_script_says_what_to_do_where_no_bench_runs() -> None:
    script = [sys.executable, ROOT / "examples/run_experiment.py", "none.yaml", "none", "--timeout", "0.1"]
    stopped = subprocess.run(script, capture_output=True, text=True, timeout=60)
    assert (stopped.returncode, stopped.stderr) == (
        1,
        "error: no supervisor in /bench; start the nodes first (docs/ros.md)\n",
    )
