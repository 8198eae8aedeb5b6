"""The whole bench as processes: the paper's experiment from serial line to fit, and every fault that must stop the rod."""

import contextlib
import dataclasses
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import ActionClient
from std_msgs.msg import Bool
from whole_bench import without_progress

from mrd_base.nodes.bench_node import LATCHED, RECORDED, seconds
from mrd_bench_driver.processes import ProcessSpec
from mrd_identification import read_fit
from mrd_interfaces.action import Identify, RunExperiment
from mrd_interfaces.msg import BenchSamples
from mrd_runs import read_run
from mrd_trajectory.experiment import format_experiment, read_experiment

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).resolve().parents[1]
BENCH, PLANT = ROOT / "config/bench.yaml", ROOT / "config/plant.yaml"

LONG = """
name: long
duration_s: 30.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 8.0, frequency_hz: 1.0}
coil: {waveform: constant, level_mA: 100.0}
"""
SHORT = LONG.replace("duration_s: 30.0", "duration_s: 1.0")


@pytest.mark.timeout(300)
def test_the_papers_experiment_from_serial_line_to_fit(new_bench: Any, tmp_path: Path) -> None:
    bench = new_bench
    blocks = bench.subscribe("samples", BenchSamples, RECORDED)
    # The paper's run takes 60 s; a fifth of it holds all that is checked here.
    paper = dataclasses.replace(read_experiment(ROOT / "config/experiments/paper.yaml"), duration=12.0)
    experiment = format_experiment(paper)
    result = bench.client.run_experiment(experiment, tmp_path / "bag", 3)
    assert result.success, result.message
    assert result.lost == 0

    # The bag holds the samples of the topic, bit by bit.
    run = read_run(tmp_path / "bag")
    assert len(run) == result.samples
    assert len(run) / 25 == pytest.approx(12.2, abs=1.0)
    assert run.rate == pytest.approx(25.0)
    assert run.info["experiment_name"] == "paper"
    assert run.info["seed"] == 3
    live = {
        name: np.concatenate([np.asarray(getattr(block, name)) for block in blocks])
        for name in ("position", "force", "coil_current", "acceleration")
    }
    (first,) = np.flatnonzero((live["position"] == run.position[0]) & (live["force"] == run.force[0]))
    recorded = slice(first, first + len(run))
    assert np.array_equal(live["position"][recorded], run.position)
    assert np.array_equal(live["force"][recorded], run.force)
    assert np.array_equal(live["coil_current"][recorded], run.current)
    assert np.array_equal(live["acceleration"][recorded], run.acceleration)

    # Stroke and current are those of the paper: 10 mm and 150 mA.
    assert 2 * np.sqrt(2) * np.std(run.position) == pytest.approx(0.01, rel=0.03)
    # While a command is late, the rod goes on at its last speed: 0.3 mm in 6 ms, at some of the reversals.
    assert np.abs(run.position).max() < 0.0055
    assert np.percentile(run.current, 95) == pytest.approx(0.15, abs=0.02)

    # The identifier fits a model to the replayed samples.
    bench.processes.stop("supervisor", "generator", "servo", "daq", "recorder", "plant")
    bench.processes.specs["identifier"] = ProcessSpec("mrd_identification", "identifier")
    bench.processes.start("identifier")
    action = ActionClient(bench.client.node, Identify, "identify")
    assert bench.client.spin(action.server_is_ready, 30)
    parameters = [f"bag:={tmp_path / 'bag'}", "speed:=0.0", "wait_for_subscriber:=true"]
    options = ["--ros-args", "-r", "__ns:=/bench", *(word for parameter in parameters for word in ("-p", parameter))]
    replay = subprocess.run(["ros2", "run", "mrd_runs", "replay", *options], capture_output=True, text=True, timeout=60)
    assert replay.returncode == 0, replay.stderr
    # The identifier still reads what the replay sent without pauses; nothing shows when it has read all.
    bench.client.spin(lambda: False, 3)
    goal = Identify.Goal(model="bouc_wen", seed=1, population=40, generations=20, least_squares=True, output=str(tmp_path))
    accepted = action.send_goal_async(goal)
    assert bench.client.spin(accepted.done, 10)
    ended = accepted.result().get_result_async()
    assert bench.client.spin(ended.done, 120)
    fit = ended.result().result
    assert fit.success, fit.message
    stored = read_fit(fit.fit)
    assert stored.content["runs"]["fit"][0]["samples"] == len(run)
    assert fit.nrmse < 0.1
    action.destroy()


def test_the_first_run_ever_waits_for_what_is_compiled(whole_bench: Any, tmp_path: Path) -> None:
    with whole_bench(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "numba")) as bench:
        assert any((tmp_path / "numba").rglob("*.nbi"))
        result = bench.client.run_experiment(SHORT, tmp_path / "bag", 0)
        assert result.success, result.message


def busy_loops(count: int) -> contextlib.ExitStack:
    """Return a context in which processes keep the machine busy."""
    stack = contextlib.ExitStack()
    for _ in range(count):
        process = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
        stack.callback(process.kill)
    return stack


@pytest.mark.timeout(120)
def test_a_recording_ends_with_half_a_second_of_rest(bench: Any, tmp_path: Path) -> None:
    result = bench.client.run_experiment(SHORT, tmp_path / "bag", 0)
    assert result.success, result.message
    run = read_run(tmp_path / "bag")
    at_rest = run.time > run.time[-1] - 0.5
    assert np.abs(run.current[at_rest]).max() < 0.05
    # The mean of 20 ms moves by less than 0.1 mm; the noise of single samples is larger.
    means = run.position[at_rest][-240:].reshape(-1, 10).mean(axis=1)
    assert np.ptp(means) < 1e-4


@pytest.mark.timeout(120)
def test_a_recorder_that_dies_while_it_waits_for_rest_is_named(bench: Any, tmp_path: Path) -> None:
    killed: list[str] = []

    def kill(status: DiagnosticStatus) -> None:
        if status.message == "stopping":
            bench.processes.kill("recorder")
            killed.append(status.message)

    bench.client.node.create_subscription(DiagnosticStatus, "recorder_state", kill, LATCHED)
    client = ActionClient(bench.client.node, RunExperiment, "run_experiment")
    assert bench.client.spin(client.server_is_ready, 10)
    accepted = client.send_goal_async(RunExperiment.Goal(experiment=SHORT, bag=str(tmp_path / "bag")))
    assert bench.client.spin(accepted.done, 10)
    ended = accepted.result().get_result_async()
    assert bench.client.spin(ended.done, 60, watch=False)
    assert killed
    message = ended.result().result.message
    assert "recorder did not respond to stop_recording within 15 s" in message or "recorder is gone" in message
    client.destroy()


@pytest.mark.timeout(120)
def test_a_run_whose_recording_fails_ends_at_once(bench: Any, tmp_path: Path) -> None:
    """A limit of the size of its files is to the recorder what a full disk is."""
    recorder = bench.processes.running["recorder"].pid
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))
    begin = bench.clock.now()
    result = bench.client.run_experiment(LONG, tmp_path / "bag", 0)
    assert bench.clock.now() - begin < 25  # the experiment alone would take 30 s
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert not result.success
    assert result.message.startswith(f"{tmp_path}/bag: cannot be written (File too large; ")
    assert result.message.count("cannot be written") == 1
    assert result.samples > 100


@pytest.mark.slow  # it is about the time on the wall, which a busy machine does not keep
@pytest.mark.timeout(120)
def test_a_bench_that_need_not_wait_is_faster_than_time(bench: Any, tmp_path: Path) -> None:
    start, begin = bench.clock.now(), time.monotonic()
    result = bench.client.run_experiment(LONG.replace("30.0", "15.0"), tmp_path / "bag", 0)
    assert result.success, result.message
    assert (bench.clock.now() - start) / (time.monotonic() - begin) > 1.2


def record_set(folder: Path, durations: tuple[float, ...]) -> subprocess.Popen[str]:
    """Start the tool with a folder of experiments `1_run`, `2_run` ... of these durations in s."""
    (folder / "experiments").mkdir()
    for number, duration in enumerate(durations, 1):
        text = LONG.replace("name: long", f"name: {number}_run").replace("duration_s: 30.0", f"duration_s: {duration}")
        (folder / f"experiments/{number}.yaml").write_text(text)
    options = ["--bench", BENCH, "--simulated", "--output", folder / "set"]
    command = ["ros2", "run", "mrd_bench_driver", "bench", folder / "experiments", *options]
    # In a ROS domain of its own: the bench of the other tests is in the one of this process.
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


DURATIONS = (3.0, 1.0)


@pytest.fixture(scope="module")
def quiet_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set that the tool has recorded on the machine as it is: its folder, and beside it what the tool has said."""
    folder = tmp_path_factory.mktemp("quiet")
    output, errors = record_set(folder, DURATIONS).communicate(timeout=100)
    (folder / "output").write_text(output)
    (folder / "errors").write_text(errors)
    return folder


@pytest.mark.timeout(120)
def test_a_folder_of_experiments_is_recorded_by_one_command(quiet_set: Path) -> None:
    errors = (quiet_set / "errors").read_text()
    assert not without_progress(errors), errors
    first, *lines = (quiet_set / "output").read_text().splitlines()
    assert first.startswith("experiments: 2 experiments, ")
    runs = [read_run(quiet_set / f"set/{name}") for name in ("1_run", "2_run")]
    for run, line, duration in zip(runs, lines, DURATIONS, strict=True):
        name = run.info["experiment_name"]
        assert line.startswith(f"{quiet_set / 'set' / name}: {len(run)} samples, ")
        assert line.endswith(" 0 lost")
        assert duration < run.time[-1] - run.time[0] < duration + 1.5
        assert np.ptp(run.position) == pytest.approx(0.016, rel=0.1)


@pytest.mark.timeout(240)
def test_a_busy_machine_makes_the_bench_slower_and_never_wrong(quiet_set: Path, tmp_path: Path) -> None:
    """A set is recorded on the machine as it is, and again beside twice as many busy processes as it has cores."""
    with busy_loops(2 * (os.cpu_count() or 1)):
        output, errors = record_set(tmp_path, DURATIONS).communicate(timeout=120)
    assert not without_progress(errors), errors
    assert output.endswith(" 0 lost\n")
    # Not a bit differs, the noise of the sensors included; nor does when a recording begins and ends.
    for name in ("1_run", "2_run"):
        quiet, busy = read_run(quiet_set / f"set/{name}"), read_run(tmp_path / f"set/{name}")
        for quantity in ("time", "position", "force", "current", "acceleration"):
            assert np.array_equal(getattr(quiet, quantity), getattr(busy, quantity)), quantity


@pytest.mark.timeout(120)
def test_an_interrupted_set_keeps_what_it_recorded(tmp_path: Path) -> None:
    tool = record_set(tmp_path, (1.0, 60.0, 1.0))
    deadline = time.monotonic() + 80
    # So many bytes hold more than half a second of samples.
    while sum(file.stat().st_size for file in tmp_path.glob("set/2_run/*.mcap")) < 60_000:
        assert tool.poll() is None, tool.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.1)
    tool.send_signal(signal.SIGINT)
    _, errors = tool.communicate(timeout=60)
    assert tool.returncode == 130, errors
    folders = [tmp_path / "set/1_run", tmp_path / "set/2_run"]
    assert without_progress(errors) == [*(f"recorded until then: {folder}" for folder in folders), "interrupted"]
    whole, part = map(read_run, folders)
    assert 1.0 < whole.time[-1] - whole.time[0] < 2.5
    assert 0.5 < part.time[-1] - part.time[0] < 30.0
    assert not (tmp_path / "set/3_run").exists()


def pull_line(bench: Any) -> None:
    bench.set_fault("unplug")


def freeze_daq(bench: Any) -> None:
    bench.processes.running["daq"].send_signal(signal.SIGSTOP)


def freeze_converter(bench: Any) -> None:
    bench.set_fault("freeze_daq")


def kill_generator(bench: Any) -> None:
    bench.processes.kill("generator")


def kill_servo(bench: Any) -> None:
    bench.processes.kill("servo")


def press_emergency_stop(bench: Any) -> None:
    bench.button.publish(Bool(data=True))
    time.sleep(0.5)  # nobody announces a person's message


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    "accident", [pull_line, freeze_daq, freeze_converter, kill_generator, kill_servo, press_emergency_stop]
)
def test_the_rod_stops_within_200_ms(accident: Callable[[Any], None], bench: Any, tmp_path: Path) -> None:
    ended = bench.run_at_speed(LONG, tmp_path / "bag")
    with bench.clock.busy():
        begun = bench.clock.now()
        accident(bench)
    stopped = bench.time_to_rest(begun)
    bench.processes.running["daq"].send_signal(signal.SIGCONT)
    print(f"{accident.__name__}: the rod stood after {1e3 * stopped:.0f} ms")
    assert stopped < 0.2, f"{accident.__name__}: the rod went on for {1e3 * stopped:.0f} ms"
    left = {kill_generator: "generator has died", kill_servo: "servo has died", freeze_daq: "daq was stopped by a signal"}
    assert left.get(accident, "") in bench.log("plant")
    # The action says why it ended, and the bag holds what was recorded until then.
    assert bench.client.spin(ended.done, 60, watch=False)
    result = ended.result().result
    assert not result.success
    assert result.message
    assert len(read_run(tmp_path / "bag")) == result.samples > 100


@pytest.mark.timeout(120)
def test_a_killed_node_may_come_back(bench: Any, tmp_path: Path) -> None:
    assert bench.client.run_experiment(SHORT, tmp_path / "before", 0).success
    bench.processes.kill("servo")
    killed = bench.clock.now()
    bench.processes.start("servo")

    def is_back() -> bool:
        state = bench.servo[-1]
        return state.connected and seconds(state.header.stamp) > killed  # what the killed one sent last may come late

    assert bench.client.spin(is_back, 30)
    result = bench.client.run_experiment(SHORT, tmp_path / "after", 0)
    assert result.success, result.message


@pytest.mark.timeout(120)
def test_a_bad_line_never_moves_the_rod(bench: Any, tmp_path: Path) -> None:
    """The rod is homed, and the replies are garbled, split, late, missing or truncated."""
    result = bench.client.run_experiment(SHORT, tmp_path / "bag", 0)
    assert result.success, result.message
    truth = bench.truth
    truth.clear()
    assert bench.client.spin(lambda: len(truth) > 10, 5)
    rest = truth[-1].position[0]
    for fault in ("damage_command", "garbage", "split_reply", "late_reply", "drop_byte", "silence", "reset", "unplug"):
        bench.set_fault(fault)
        bench.client.spin(lambda: False, 0.8)
        bench.set_fault("")
        bench.servo.clear()
        assert bench.client.spin(lambda: bool(bench.servo) and bench.servo[-1].connected, 10), fault
    positions = np.array([state.position[0] for state in truth])
    # Without current in its windings, only the motor's brake resists the gas force of the damper.
    assert np.abs(positions - rest).max() < 2e-4
