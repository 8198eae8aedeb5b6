"""The safety concept on the whole bench: who may move rod and coil, who stops them, what happens without a supervisor."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from whole_bench import without_progress

from mrd_base.nodes.bench_node import LATCHED, RECORDED, seconds
from mrd_base.nodes.graph import RUN_EXPERIMENT
from mrd_bench_driver.nodes.bench_client import BenchClient
from mrd_interfaces.msg import BenchSamples, BenchState, Setpoint
from mrd_interfaces.srv import StopRecording
from mrd_runs import read_run
from mrd_runs.bag import read_bag

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(180)]

LONG = """
name: long
duration_s: 30.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 8.0, frequency_hz: 1.0}
coil: {waveform: constant, level_mA: 100.0}
"""
SHORT = LONG.replace("duration_s: 30.0", "duration_s: 1.0")

DRIVE_OFF = 1 << 1  # in status word 0 of the motor
ORDINARY = QoSProfile(depth=10)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


def result_of(bench: Any, ended: Any) -> Any:
    assert bench.client.spin(ended.done, 90, watch=False)
    return ended.result().result


def reset(bench: Any) -> None:
    response = bench.service("reset_fault")
    assert response.success, response.message
    assert bench.client.spin(lambda: bench.modes[-1].mode == BenchState.IDLE, 10)


def publish(bench: Any, qos: QoSProfile) -> None:
    """Press the button as any client does, once ROS has connected it."""
    publisher = bench.client.node.create_publisher(Bool, "emergency_stop", qos)
    # Servo, DAQ, generator, supervisor and recorder subscribe reliably and best effort.
    heard = 5 if qos is SENSOR else 10
    # ROS takes one that was killed for alive for 20 s.
    assert bench.client.spin(lambda: publisher.get_subscription_count() == heard, 30), "not everybody hears this publisher"
    bench.pressed = bench.clock.now()
    # The nodes may not know a new publisher yet. To one that sends best effort, nobody says what was lost.
    for _ in range(10 if qos is SENSOR else 1):
        publisher.publish(Bool(data=True))
        bench.client.spin(lambda: False, 0.02)
    # As long as `ros2 topic pub --once` stays.
    bench.client.spin(lambda: False, 0.1)
    bench.client.node.destroy_publisher(publisher)


# Sensors


def test_a_dead_lvdt_homes_no_rod(new_bench: Any, tmp_path: Path) -> None:
    """Unplugged, it reads mid-stroke; the rod stands elsewhere. Neither a retry nor a run sets the encoder by it."""
    bench = new_bench
    bench.set_fault("disconnect_position")
    assert bench.client.spin(lambda: bool(bench.truth and bench.servo), 10)
    begin = bench.truth[-1].position[0]
    assert abs(begin) > 5e-3
    for bag in ("first", "second"):
        result = bench.client.run_experiment(SHORT, tmp_path / bag, 0)
        assert not result.success
        assert "homing: LVDT and encoder disagree" in result.message
        assert "by 0.00 mm by the LVDT; look for an unplugged or stuck LVDT" in result.message
        assert bench.client.spin(lambda: bench.modes[-1].mode == BenchState.FAULT, 10)
        reset(bench)
    response = bench.service("home", timeout=60.0)
    assert not response.success
    assert "homing: LVDT and encoder disagree" in response.message
    bench.time_to_rest(bench.clock.now(), 0.2)
    assert not any(state.homed for state in bench.servo)
    assert 1.9e-3 < max(abs(state.position[0] - begin) for state in bench.truth) < 2.2e-3
    bench.set_fault("")
    reset(bench)
    result = bench.client.run_experiment(SHORT, tmp_path / "mended", 0)
    assert result.success, result.message


# Watchdogs

HANGING_OUTPUT = """
import sys, time
from pathlib import Path
if Path(sys.orig_argv[1]).name == "daq":
    from mrd_bench_driver.acquisition import Simulated
    write = Simulated.write
    def write_or_hang(backend, volts):
        while Path(__file__).with_name("hang").exists():
            time.sleep(0.01)
        write(backend, volts)
    Simulated.write = write_or_hang
"""
"""Python runs this at its start. It makes a DAQ whose converter takes no voltage as long as there is a file ``hang``."""


def test_a_converter_that_hangs_while_it_takes_a_voltage_ends_the_run_by_this_cause(
    whole_bench: Any, tmp_path: Path
) -> None:
    """It comes before the tests that share a bench, because that one would have to end for it."""
    (tmp_path / "sitecustomize.py").write_text(HANGING_OUTPUT)
    path = f"{tmp_path}:{os.environ['PYTHONPATH']}"
    with whole_bench(tmp_path / "bench", PYTHONPATH=path) as bench:
        output = bench.output
        states = bench.subscribe("daq_state", DiagnosticStatus, LATCHED)
        ended = bench.run_at_speed(LONG, tmp_path / "bag")
        with bench.clock.busy():
            begun = bench.clock.now()
            (tmp_path / "hang").touch()
        result = result_of(bench, ended)
        cause = "the coil may still have current, switch its supply off; the converter's output did not answer within 80 ms"
        assert result.message.startswith(f"interlock daq fault: {cause}"), result.message
        assert result.lost == 0
        assert bench.time_to_rest(begun) < 0.2
        assert output[-1].coil_command > 0
        assert "does not answer" in bench.service("reset_fault").message
        (tmp_path / "hang").unlink()
        assert bench.client.spin(lambda: output[-1].coil_command == 0, 10)
        assert bench.client.spin(lambda: not states[-1].message.startswith("the coil may still have current"), 10)
        bench.time_to_rest(bench.clock.now(), 0.1)  # by then, the supervisor has heard it, too
        response = bench.service("reset_fault")
        assert response.success, response.message
        again = bench.client.run_experiment(SHORT, tmp_path / "again", 0)
        assert again.success, again.message


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_without_its_supervisor_the_bench_stops_by_itself(bench: Any, end: signal.Signals, tmp_path: Path) -> None:
    output = bench.output
    samples = bench.subscribe("samples", BenchSamples, RECORDED)
    ended = bench.run_at_speed(LONG, tmp_path / "bag")
    supervisor = bench.processes.running["supervisor"]
    with bench.clock.busy():
        begun = bench.clock.now()
        assert output[-1].coil_command > 0
        supervisor.send_signal(end)
        if end is signal.SIGKILL:
            supervisor.wait()
            del bench.processes.running["supervisor"]
    stopped = bench.time_to_rest(begun)
    off = seconds(output[-1].header.stamp) - begun
    print(f"supervisor {end.name}: the rod stood after {1e3 * stopped:.0f} ms, the coil was off after {1e3 * off:.0f} ms")
    assert 0 < stopped < 0.2
    assert output[-1].coil_command == 0
    assert 0 < off < 0.2
    assert np.abs(np.mean(samples[-1].coil_current)) < 0.02
    assert bench.servo[-1].stopped
    assert "has been silent for" in bench.servo[-1].message
    # Nothing moves until somebody resets it, and then not without a supervisor.
    assert "no supervisor watches" in bench.service("servo/enable", SetBool, data=True).message
    assert "no supervisor watches" in bench.service("servo/home").message
    if end is signal.SIGKILL:
        bench.processes.start("supervisor")
        modes = bench.subscribe("bench_state", BenchState, LATCHED)
        assert bench.client.spin(lambda: modes and modes[-1].mode == BenchState.FAULT, 60)
        assert "has been silent for" in modes[-1].message
        # The recorder does not cling to the run of the dead. ROS takes these for alive for 20 s. When the bench did, too, it
        # waited in vain for messages to the new supervisor, 10 s each.
        begun = time.monotonic()
        response = bench.service("reset_fault")
        assert response.success, response.message
        assert time.monotonic() - begun < 5.0
        again = bench.client.run_experiment(SHORT, tmp_path / "again", 0)
        assert again.success, again.message
        assert len(read_run(tmp_path / "bag")) > 100
        return
    supervisor.send_signal(signal.SIGCONT)
    result = result_of(bench, ended)
    assert result.message.startswith("the supervisor was stalled for "), result.message
    assert not result.success
    assert len(read_run(tmp_path / "bag")) == result.samples > 100


@pytest.mark.parametrize("victim", ["servo", "daq", "generator"])
def test_a_node_that_goes_on_after_a_pause_moves_nothing(victim: str, bench: Any, tmp_path: Path) -> None:
    """It finds the commands of its absence waiting, which are old, and a lease in mode fault."""
    output = bench.output
    ended = bench.run_at_speed(LONG, tmp_path / "bag")
    bench.processes.running[victim].send_signal(signal.SIGSTOP)
    result = result_of(bench, ended)
    assert not result.success
    begun = bench.clock.now()
    bench.processes.running[victim].send_signal(signal.SIGCONT)
    # The bench's time has left it behind, so that how soon it goes on is a matter of the machine.
    bench.client.spin(lambda: False, 1.0, watch=False)
    assert bench.client.spin(lambda: output[-1].coil_command == 0, 30, watch=False), "the coil stays on"
    bench.time_to_rest(bench.clock.now(), 3.0)
    afterwards = [state for state in bench.truth if seconds(state.header.stamp) > begun]
    assert np.ptp([state.position[0] for state in afterwards]) < 2e-4
    assert [state.effort[1] for state in afterwards[-10:] if state.effort[1] >= 0.02] == []
    assert not bench.service("home").success


def find_node(tool: "subprocess.Popen[str]", name: str) -> psutil.Process:
    (found,) = [
        child for child in psutil.Process(tool.pid).children(recursive=True) if f"/{name}" in " ".join(child.cmdline()[:3])
    ]
    return found


def wait_until_moving(tool: "subprocess.Popen[str]", folder: Path) -> None:
    """Wait until a tool records a rod that moves."""
    deadline = time.monotonic() + 90
    while sum(file.stat().st_size for file in folder.glob("bag/*.mcap")) < 60_000:
        assert tool.poll() is None, tool.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)


DIES = ("supervisor", signal.SIGKILL, "supervisor ended with status -9", 20)
HANGS = ("supervisor", signal.SIGSTOP, "supervisor has been silent for 2", 50)
# The tool is told of the end of any node in the same way.
DAQ_DIES = ("daq", signal.SIGKILL, "daq ended with status -9", 20)


@pytest.mark.parametrize(
    "ends", [(HANGS, DIES), pytest.param((DAQ_DIES,), marks=pytest.mark.slow)], ids=["supervisor", "daq"]
)
def test_the_tool_stops_everything_when_a_node_dies_or_hangs(
    ends: tuple[tuple[str, signal.Signals, str, int], ...], tmp_path: Path
) -> None:
    """Two benches run at once, because a node has to be silent for 20 s of wall time before it counts as hanging."""
    (tmp_path / "long.yaml").write_text(LONG)
    with contextlib.ExitStack() as stack:
        folders = [tmp_path / f"out{number}" for number in range(len(ends))]
        tools = [stack.enter_context(bench_tool(folder, str(tmp_path / "long.yaml"))) for folder in folders]
        begun = []
        for tool, folder, (victim, end, _, _) in zip(tools, folders, ends, strict=True):
            wait_until_moving(tool, folder)
            find_node(tool, victim).send_signal(end)
            begun.append(time.monotonic())
        # The last one first, which ends first.
        for tool, folder, begin, (victim, end, line, within) in reversed(
            list(zip(tools, folders, begun, ends, strict=True))
        ):
            _, errors = tool.communicate(timeout=60)
            print(f"{victim} {end.name}: bench ended after {time.monotonic() - begin:.1f} s")
            assert time.monotonic() - begin < within
            assert tool.returncode == 1
            assert f"error: {line}" in errors
            run = read_run(folder / "bag")
            if victim != "daq":  # the rest of the braking is recorded, too
                last = run.position[-100:].reshape(-1, 10).mean(axis=1)
                assert np.ptp(last) < 2e-4


def test_a_bench_that_others_use_stops_everything_when_its_supervisor_dies(tmp_path: Path) -> None:
    """The tool runs no experiment itself, so that no goal of its own tells it of the end."""
    domain = os.environ["ROS_DOMAIN_ID"]
    tool = bench_tool(tmp_path / "out", "--namespace", "shared", ROS_DOMAIN_ID=domain)
    assert tool.stdout
    assert tool.stdout.readline().startswith("the bench starts; logs: ")
    assert tool.stdout.readline().startswith("the bench is up in namespace /shared"), tool.communicate()
    with BenchClient("/shared") as client:
        action = RUN_EXPERIMENT.client(client.node)
        assert client.spin(action.server_is_ready, 60)
        sent = action.send_goal_async(RUN_EXPERIMENT.type.Goal(experiment=LONG, bag=str(tmp_path / "bag")))
        assert client.spin(sent.done, 60)
        assert sent.result().accepted
        assert client.spin(lambda: sum(f.stat().st_size for f in tmp_path.glob("bag/*.mcap")) > 60_000, 60)
        find_node(tool, "supervisor").kill()
        _, errors = tool.communicate(timeout=60)
        action.destroy()
    assert tool.returncode == 1
    assert "error: supervisor ended with status -9" in errors
    stops = read_bag(tmp_path / "bag").decode("/shared/emergency_stop")
    assert stops[-1].data
    last = read_run(tmp_path / "bag").position[-100:].reshape(-1, 10).mean(axis=1)
    assert np.ptp(last) < 2e-4  # the rest of the braking is recorded, too


# The emergency stop

BUTTONS: dict[str, Callable[[Any], Any]] = {
    "an ordinary publisher": lambda bench: publish(bench, ORDINARY),
    "a best-effort publisher": lambda bench: publish(bench, SENSOR),
    "a latched publisher": lambda bench: publish(bench, LATCHED),
    "the service of the servo": lambda bench: bench.service("servo/emergency_stop"),
    "the service of the DAQ": lambda bench: bench.service("daq/emergency_stop"),
    "the service of the supervisor": lambda bench: bench.service("emergency_stop"),
}


@pytest.mark.parametrize("button", BUTTONS)
def test_everybodys_emergency_stop_stops_rod_and_coil_and_latches(button: str, bench: Any, tmp_path: Path) -> None:
    ended = bench.run_at_speed(LONG, tmp_path / "bag")
    bench.pressed = bench.clock.now()
    BUTTONS[button](bench)
    result = result_of(bench, ended)
    assert not result.success
    assert "emergency stop" in result.message
    assert bench.client.spin(lambda: bench.modes[-1].mode == BenchState.FAULT and bench.servo[-1].stopped, 10)
    assert bench.output[-1].coil_command == 0
    # How long the message was under way on the wall's clock counts, too: nobody announces it to the time of the bench.
    print(f"{button}: the rod stood after {1e3 * bench.time_to_rest(bench.pressed, 0.1):.0f} ms")
    again = bench.client.run_experiment(SHORT, tmp_path / "again", 0)
    assert "call reset_fault" in again.message
    assert not bench.service("servo/home").success
    reset(bench)


def test_a_reset_directly_after_a_stop_is_accepted(bench: Any) -> None:
    """The DAQ may have yet to tell of the stop; once in twenty times, that was taken for another one."""
    stop, release = (bench.client.node.create_client(Trigger, name) for name in ("emergency_stop", "reset_fault"))
    assert bench.client.spin(lambda: stop.service_is_ready() and release.service_is_ready(), 10)
    for _ in range(40):
        assert bench.call(stop, Trigger.Request()).success
        response = bench.call(release, Trigger.Request())
        assert response.success, response.message


# Ownership


def test_an_idle_bench_obeys_nobody(bench: Any) -> None:
    bench.truth.clear()
    outputs = len(bench.output)
    stranger = bench.client.node.create_publisher(Setpoint, "setpoint", ORDINARY)
    assert bench.client.spin(lambda: stranger.get_subscription_count() >= 2, 10)
    for _ in range(50):
        message = bench.setpoint_of_now(position=0.01, velocity=0.05, coil_current=1.0)
        stranger.publish(message)
        bench.client.spin(lambda: False, 0.02)
    assert all(output.coil_command == 0 for output in bench.output[outputs - 1 :])
    refusals = {"servo/enable": (SetBool, {"data": True}), "servo/home": (Trigger, {})}
    for name, (kind, fields) in refusals.items():
        response = bench.service(name, kind, **fields)
        assert not response.success
        assert "the bench is in mode idle; call home, control or run_experiment of /bench/supervisor" in response.message
    assert all(abs(state.velocity[0]) < 2e-3 for state in bench.truth)
    log = bench.processes.log("daq").read_text()
    assert "a setpoint is refused: the bench is in mode idle; " in log
    assert f"/bench/{bench.client.node.get_name()}" in log
    bench.client.node.destroy_publisher(stranger)


class Answer:
    """An answer in the form of a Trigger's."""

    def __init__(self, success: bool, message: str) -> None:
        self.success, self.message = success, message


def set_rate(bench: Any) -> Answer:
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=100.0)
    parameters = [Parameter(name="rate_hz", value=value)]
    (result,) = bench.service("daq/set_parameters", SetParameters, parameters=parameters).results
    return Answer(result.successful, result.reason)


def test_a_run_goes_on_undisturbed_by_what_would_spoil_it(bench: Any, tmp_path: Path) -> None:
    ended = bench.run_at_speed(LONG.replace("30.0", "12.0"), tmp_path / "bag")
    stranger = bench.client.node.create_publisher(Setpoint, "setpoint", ORDINARY)
    assert bench.client.spin(lambda: stranger.get_subscription_count() >= 2, 10)
    attempts: dict[str, Callable[[], Any]] = {
        "servo/reset_fault": lambda: bench.service("servo/reset_fault"),
        "daq/reset_fault": lambda: bench.service("daq/reset_fault"),
        "daq/tare": lambda: bench.service("daq/tare"),
        "rate_hz": lambda: set_rate(bench),
        "stop_recording": lambda: bench.service("stop_recording", StopRecording),
        "servo/home": lambda: bench.service("servo/home"),
        "home": lambda: bench.service("home"),
        "reset_fault": lambda: bench.service("reset_fault"),
        "control": lambda: bench.service("control", SetBool, data=True),
    }
    for name, attempt in attempts.items():
        answer = attempt()
        assert not answer.success, name
        assert answer.message, name
        message = bench.setpoint_of_now(position=0.01, coil_current=1.0)
        stranger.publish(message)
    result = result_of(bench, ended)
    assert result.success, result.message
    assert result.lost == 0
    run = read_run(tmp_path / "bag")
    assert run.rate == pytest.approx(500.0)
    assert np.abs(run.position).max() < 0.0085
    assert np.percentile(run.current, 99) < 0.2
    assert "it carries lease 0, not " in bench.processes.log("servo").read_text()
    bench.client.node.destroy_publisher(stranger)


STOPS = {
    "servo/stop": lambda bench: bench.service("servo/stop"),
    "servo/enable": lambda bench: bench.service("servo/enable", SetBool, data=False),
    "abort_experiment": lambda bench: bench.service("abort_experiment"),
    "stop": lambda bench: bench.service("stop"),
}


@pytest.mark.parametrize("way", STOPS)
def test_a_stop_always_stops_and_the_result_says_so(way: str, bench: Any, tmp_path: Path) -> None:
    ended = bench.run_at_speed(LONG, tmp_path / "bag")
    assert STOPS[way](bench).success
    called = bench.clock.now()
    if way.startswith("servo"):
        # Nor does whoever switches it on again hide that it stood.
        assert not bench.service("servo/enable", SetBool, data=True).success
    result = result_of(bench, ended)
    assert bench.time_to_rest(called, 0.5) < 0.2
    assert not result.success
    expected = {"abort_experiment": "the generator aborted the experiment", "stop": "cancelled"}
    assert result.message.startswith(expected.get(way, "servo: somebody stopped the rod during the run")), result.message
    assert bench.client.spin(lambda: bench.modes[-1].mode == BenchState.IDLE, 10)
    assert len(read_run(tmp_path / "bag")) == result.samples


def test_a_stop_ends_the_homing_whenever_it_comes(bench: Any, tmp_path: Path) -> None:
    """The earliest comes before the supervisor has asked the servo to home. A quiet machine simulates a homing in 0.3 s."""
    home, stop = (bench.client.node.create_client(Trigger, name) for name in ("home", "servo/stop"))
    assert bench.client.spin(lambda: home.service_is_ready() and stop.service_is_ready(), 10)
    for wait in (0.0, 0.002, 0.005, 0.01, 0.02, 0.03):
        homing = home.call_async(Trigger.Request())
        assert bench.client.spin(lambda: bool(bench.modes) and bench.modes[-1].mode == BenchState.HOMING, 10)
        bench.client.spin(lambda: False, wait)
        assert bench.call(stop, Trigger.Request()).success
        assert bench.client.spin(homing.done, 20)
        message = homing.result().message
        assert message.startswith(("servo: somebody stopped the homing", "servo: somebody called a stop")), (wait, message)
        assert bench.client.spin(lambda: bench.modes[-1].mode == BenchState.IDLE, 10)
    home.destroy()
    stop.destroy()
    result = bench.client.run_experiment(SHORT, tmp_path / "bag", 0)
    assert result.success, result.message


def test_a_stop_in_any_phase_of_a_run_leaves_a_bench_that_runs_again(bench: Any, tmp_path: Path) -> None:
    stop = bench.client.node.create_client(Trigger, "stop")
    assert bench.client.spin(stop.service_is_ready, 10)
    three_seconds = LONG.replace("30.0", "3.0")  # so that a stop while it runs comes before its end
    for phase in ("arming", "recording", "running", "stopping", "closing"):
        answers: list[Any] = []

        def on_feedback(feedback: Any, phase: str = phase, answers: list[Any] = answers) -> None:
            if feedback.phase == phase and not answers:
                answers.append(stop.call_async(Trigger.Request()))

        for number in range(5):  # on a busy machine, the result may come before the feedback of a short phase
            result = bench.client.run_experiment(three_seconds, tmp_path / f"{phase}_{number}", 0, on_feedback)
            if answers:
                break
        assert answers, phase
        assert bench.client.spin(answers[0].done, 20), phase
        # A stop that comes after the last setpoint may find the run complete.
        assert result.message.startswith("cancelled") or (phase in ("stopping", "closing") and result.success), phase
        assert bench.client.spin(lambda: bench.modes[-1].mode == BenchState.IDLE, 10), phase
        bench.time_to_rest(bench.clock.now(), 0.3)
        assert abs(bench.truth[-1].velocity[0]) < 2e-3, phase
        assert bench.output[-1].coil_command == 0, phase
    stop.destroy()
    result = bench.client.run_experiment(SHORT, tmp_path / "again", 0)
    assert result.success, result.message


CONTROL_ENDS = {
    "silence": (lambda _bench: None, "no setpoint to follow came for 10 s; call control again"),
    "servo/stop": (lambda bench: bench.service("servo/stop"), "somebody stopped the rod (by servo/stop or servo/enable)"),
}


@pytest.mark.parametrize("way", CONTROL_ENDS)
def test_a_control_by_hand_that_ends_leaves_drive_and_coil_off(way: str, bench: Any) -> None:
    end, reason = CONTROL_ENDS[way]
    setpoints = bench.client.node.create_publisher(Setpoint, "setpoint", ORDINARY)
    assert bench.client.spin(lambda: setpoints.get_subscription_count() >= 3, 10)
    number = int(bench.service("control", SetBool, data=True).message.rsplit(" ", 1)[1])

    def drive() -> None:
        message = bench.setpoint_of_now(position=bench.servo[-1].position, coil_current=0.5, lease=number)
        with bench.clock.busy():  # so that it is not old when it comes
            setpoints.publish(message)
            bench.client.spin(lambda: False, 0.05)

    def driven() -> bool:
        drive()
        return any(output.coil_command > 0 for output in bench.output[outputs:])

    assert bench.client.spin(lambda: not bench.servo[-1].status & DRIVE_OFF, 10)
    outputs = len(bench.output)
    assert bench.client.spin(driven, 10), "the control does not begin"
    assert bench.modes[-1].mode == BenchState.CONTROL
    last = bench.clock.now()
    end(bench)
    assert bench.client.spin(lambda: bench.modes[-1].mode == BenchState.IDLE, 60)
    assert bench.modes[-1].message == reason
    if way == "silence":
        assert seconds(bench.modes[-1].header.stamp) - last == pytest.approx(10.0, abs=0.3)
    assert bench.client.spin(lambda: bench.servo[-1].status & DRIVE_OFF, 10), "the drive stays on"
    assert not bench.servo[-1].enabled
    outputs = len(bench.output)
    for _ in range(5):
        drive()
    assert bench.output[-1].coil_command == 0
    assert len(bench.output) == outputs, "the coil follows"
    assert bench.servo[-1].status & DRIVE_OFF
    bench.client.node.destroy_publisher(setpoints)


# Two of them


def test_a_second_supervisor_ends_and_disturbs_nothing(bench: Any, tmp_path: Path) -> None:
    supervisor = bench.processes.running["supervisor"]
    bench.processes.log("supervisor").rename(tmp_path / "first.log")
    ended = bench.run_at_speed(LONG.replace("30.0", "12.0"), tmp_path / "bag")
    second = bench.processes.start("supervisor")
    bench.processes.running["supervisor"] = supervisor
    assert bench.client.spin(lambda: second.poll() is not None, 60), "it goes on"
    assert second.returncode == 2
    assert "/bench/supervisor (process " in bench.processes.log("supervisor").read_text()
    assert "supervises this bench already" in bench.processes.log("supervisor").read_text()
    result = result_of(bench, ended)
    assert result.success, result.message
    assert supervisor.poll() is None


def bench_tool(folder: Path, *options: str, **environment: str) -> "subprocess.Popen[str]":
    variables = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"} | environment
    command = ["ros2", "run", "mrd_bench_driver", "bench", "--simulated", "--output", folder, *options]
    return subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_an_occupied_namespace_is_refused(bench: Any, tmp_path: Path) -> None:
    assert bench.modes
    tool = bench_tool(tmp_path / "out", ROS_DOMAIN_ID=os.environ["ROS_DOMAIN_ID"])
    _, errors = tool.communicate(timeout=60)
    assert tool.returncode == 2
    assert errors.startswith(f"error: namespace /bench of ROS domain {os.environ['ROS_DOMAIN_ID']} is occupied by another")
    assert not (tmp_path / "out").exists()


def test_of_two_benches_that_start_together_one_is_refused_and_the_other_meets_no_third(bench: Any, tmp_path: Path) -> None:
    """ROS takes seconds to find a node, so that each could take the namespace for free. The bench in another one notices
    nothing of the run that is recorded.
    """
    (tmp_path / "short.yaml").write_text(SHORT)
    modes = len(bench.modes)
    options = [str(tmp_path / "short.yaml"), "--namespace", "together"]
    tools = [bench_tool(tmp_path / name, *options, ROS_DOMAIN_ID=os.environ["ROS_DOMAIN_ID"]) for name in ("a", "b")]
    said = [communicate_beside(bench, tool) for tool in tools]
    assert sorted(tool.returncode for tool in tools) == [0, 2], said
    (recorded,) = ((output, errors) for tool, (output, errors) in zip(tools, said, strict=True) if tool.returncode == 0)
    assert any("is occupied by another bench (which starts or runs on this machine)" in errors for _, errors in said)
    assert recorded[0].endswith(" 0 lost\n")
    assert not without_progress(recorded[1]), recorded[1]
    assert len(bench.modes) == modes


def communicate_beside(bench: Any, tool: "subprocess.Popen[str]") -> tuple[str, str]:
    """Return what a tool prints until it ends, while the time of a bench goes on."""
    while tool.poll() is None:
        bench.client.spin(lambda: False, 0.2)
    return tool.communicate(timeout=60)


def test_benches_of_two_domains_do_not_meet(bench: Any, tmp_path: Path) -> None:
    """The second one records a run; the first one notices nothing."""
    (tmp_path / "short.yaml").write_text(SHORT)
    modes = len(bench.modes)
    output, errors = communicate_beside(bench, bench_tool(tmp_path / "out", str(tmp_path / "short.yaml")))
    assert not without_progress(errors), errors
    assert output.endswith(" 0 lost\n")
    assert len(bench.modes) == modes


def test_a_log_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    tool = bench_tool(tmp_path / "file/out")
    _, errors = tool.communicate(timeout=60)
    assert tool.returncode == 2
    assert errors.startswith(f"error: {tmp_path}/file/out/log: the logs cannot be written there (Not a directory); ")
