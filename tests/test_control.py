"""A hybrid test through the real graph on the simulated bench: recorded, reviewed, and stopped by what must stop it."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger
from whole_bench import SharedBench

from mrd_base.nodes.bench_node import RECORDED, seconds
from mrd_control.comparison import compare_with_twin, write_comparison
from mrd_control.experiment import format_control_experiment, read_control_experiment
from mrd_control.recording import loop_of_cycles, read_hybrid_run
from mrd_control.ride import DataSheet, ride_metrics
from mrd_interfaces.action import RunExperiment
from mrd_interfaces.msg import ControlCycle
from mrd_interfaces.srv import LoadExperiment
from mrd_runs import read_run

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = read_control_experiment(ROOT / "config/control/hybrid_test.yaml")


@pytest.fixture(scope="module")
def shared_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedBench]:
    with closing(SharedBench(tmp_path_factory.mktemp("bench"), control_cycle=SHIPPED.cycle)) as shared:
        yield shared


@pytest.mark.timeout(300)
def test_a_hybrid_test_is_recorded_and_agrees_with_its_offline_twin(bench: Any, tmp_path: Path) -> None:
    result = bench.client.run_control(format_control_experiment(SHIPPED), tmp_path / "bag", 1)
    assert result.success, result.message
    assert result.lost == 0
    assert read_run(tmp_path / "bag").info["experiment_name"] == SHIPPED.name

    comparison = compare_with_twin(read_hybrid_run(tmp_path / "bag"))
    assert len(comparison.run.bench.time) == SHIPPED.samples
    assert comparison.motion <= 0.02
    assert abs(comparison.tracking.delay) <= 1e-3
    assert comparison.tracking.nrms <= 0.03
    timing = comparison.run.timing
    assert timing.rate == pytest.approx(1 / SHIPPED.cycle, rel=1e-3)
    assert timing.missed == 0
    assert timing.latency.max() < 1e-3  # the bench stands still while a cycle is computed
    assert write_comparison(comparison, tmp_path / "page").stat().st_size > 100_000

    # A replay sends the same cycles, which are evaluated alike.
    count = SHIPPED.samples // round(SHIPPED.cycle * SHIPPED.rate)
    # On a busy machine this process may rest for longer than the usual queue lasts.
    all_kept = QoSProfile(depth=count, reliability=ReliabilityPolicy.RELIABLE)
    replayed = bench.subscribe("/again/control_cycle", ControlCycle, all_kept)
    options = ["-r", "__ns:=/again", "-p", f"bag:={tmp_path / 'bag'}", "-p", "topics:=[control_cycle]"]
    command = [
        "ros2",
        "run",
        "mrd_runs",
        "replay",
        "--ros-args",
        *options,
        "-p",
        "speed:=4.0",
        "-p",
        "wait_for_subscriber:=true",
    ]
    replay = subprocess.Popen(command)
    assert bench.client.spin(lambda: len(replayed) >= count and replay.poll() is not None, 120)
    assert replay.returncode == 0
    again = loop_of_cycles(SHIPPED, replayed).part(SHIPPED.counted)
    assert ride_metrics(SHIPPED.system.linear(), again, DataSheet(), 0.0) == comparison.bench_ride

    # What cannot run is refused before anything moves, with its number.
    stiff = replace(SHIPPED.system, passive_damping=0.0, lever_ratio=1.0)
    unstable = replace(SHIPPED, system=stiff, delay=0.08, lag=0.0, predictor="none", name="unstable")
    result = bench.client.run_control(format_control_experiment(unstable), tmp_path / "unstable", 1)
    assert not result.success
    assert "the hybrid loop is unstable: at 0.4 A it is stable up to" in result.message
    assert not (tmp_path / "unstable").exists()


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("fault", "named"),
    [
        ("freeze_daq", ("stale force", "stale samples")),
        ("drop_blocks", ("samples were lost",)),
        ("kill", ("controller", "setpoint")),
    ],
)
def test_what_breaks_the_loop_ends_it_and_is_named(bench: Any, tmp_path: Path, fault: str, named: tuple[str, ...]) -> None:
    cycles = bench.subscribe("control_cycle", ControlCycle, RECORDED)
    client = ActionClient(bench.client.node, RunExperiment, "run_control")
    assert bench.client.spin(client.server_is_ready, 10)
    goal = RunExperiment.Goal(experiment=format_control_experiment(SHIPPED), bag=str(tmp_path / "bag"))
    accepted = client.send_goal_async(goal)
    assert bench.client.spin(accepted.done, 30)
    ended = accepted.result().get_result_async()
    # Until the rod moves, some seconds after the start of the sweep.
    assert bench.client.spin(lambda: len(cycles) > 500 or ended.done(), 120)
    assert not ended.done(), ended.result().result.message
    if fault == "kill":
        bench.processes.kill("controller")
    else:
        bench.set_fault(fault)
    assert bench.client.spin(ended.done, 120, watch=False)
    result = ended.result().result
    assert not result.success
    assert any(name in result.message for name in named), result.message
    # The coil is without current, and the rod stands.
    truth = bench.truth
    assert bench.client.spin(lambda: abs(truth[-1].velocity[0]) < 2e-3 and truth[-1].effort[1] < 0.01, 60, watch=False)


@pytest.mark.timeout(300)
def test_a_loop_that_is_later_than_declared_is_stopped_and_named(bench: Any, tmp_path: Path) -> None:
    """The check before the start believes the declared delay; the motor has become slower since it was measured."""
    light = replace(SHIPPED.system, unsprung_mass=80.0, passive_damping=0.0)
    calm = replace(SHIPPED.excitation, amplitude=0.004, start=1.2, end=1.3)
    test = replace(SHIPPED, system=light, excitation=calm, law="constant_current", gains={"current": 0.4})
    text = format_control_experiment(replace(test, duration=5.0))
    result = bench.client.run_control(text, tmp_path / "as declared", 1)
    assert result.success, result.message

    bench.set_fault("slow_motor")
    bench.truth.clear()
    cycles = bench.subscribe("control_cycle", ControlCycle, RECORDED)
    result = bench.client.run_control(text, tmp_path / "later", 1)
    assert not result.success
    # A slow motor may also show in its following error, before the damper has given as much.
    assert any(name in result.message for name in ("energy balance", "following error", "position error")), result.message
    # It is stopped within a second, and the rod stays at rest without current.
    assert 0 < len(cycles) * SHIPPED.cycle < 1.0
    assert bench.time_to_rest(seconds(cycles[-1].header.stamp)) < 0.2
    assert bench.truth[-1].effort[1] < 0.01


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_tools_run_a_hybrid_test_and_review_it(tmp_path: Path) -> None:
    """The tools run and review a hybrid test as `make demo-control` does."""
    output = tmp_path / "out"
    shipped = ROOT / "config/control/hybrid_test.yaml"
    ran = tool("hybrid_test", shipped, "--simulated", "--output", output)
    assert ran.returncode == 0, ran.stderr
    assert "The rod followed the emulated motion with a delay of" in ran.stdout
    found = json.loads((output / "hybrid_test.json").read_text())
    assert abs(found["tracking"]["delay"]) <= 1e-3
    assert found["twin"]["motion_nrms"] <= 0.02
    again = tool("hybrid_test", shipped, "--simulated", "--output", output)
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    assert "exists already; choose another --output" in again.stderr

    reviewed = tool("review", output / "bag", "--output", tmp_path / "review")
    assert reviewed.returncode == 0, reviewed.stderr
    assert json.loads((tmp_path / "review" / "hybrid_test.json").read_text())["ride"] == found["ride"]
    assert "Next, what explains the difference: ros2 run mrd_diagnosis diagnose" in reviewed.stdout


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_delay_of_the_simulated_servo_is_measured(whole_bench: Any, tmp_path: Path) -> None:
    """The dead time, of serial line and servo, is what the shipped test declares; the lag is that of the motor."""
    experiment = (ROOT / "config/experiments/characterise/01_multisine.yaml").read_text()
    with whole_bench(tmp_path) as bench:
        result = bench.client.run_experiment(experiment, tmp_path / "bag", 1)
    assert result.success, result.message
    printed = tool("delay", tmp_path / "bag")
    assert printed.returncode == 0, printed.stderr
    found = yaml.safe_load(printed.stdout)
    assert found["delay_ms"] == pytest.approx(1e3 * SHIPPED.delay, abs=1.0)
    assert found["lag_ms"] == pytest.approx(1e3 * SHIPPED.lag, abs=0.7)


def tool(name: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    command = ["ros2", "run", "mrd_control", name, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=400)


LONG = """
name: long
duration_s: 6.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 8.0, frequency_hz: 1.0}
coil: {waveform: constant, level_mA: 100.0}
"""


@pytest.mark.timeout(300)
def test_a_hybrid_test_of_somebody_else_does_not_end_a_run(bench: Any, tmp_path: Path) -> None:
    """Its end would look like that of the run, which would be short and called complete."""

    test = format_control_experiment(replace(SHIPPED, duration=5.0, rate=500.0))
    assert bench.service("load_control", LoadExperiment, experiment=test).success
    ended = bench.run_at_speed(LONG, tmp_path / "bag")
    begun = bench.clock.now()
    attempts: tuple[tuple[str, Any, dict[str, str]], ...] = (
        ("start_control", Trigger, {}),
        ("load_control", LoadExperiment, {"experiment": test}),
        ("load_experiment", LoadExperiment, {"experiment": LONG}),
    )
    for name, kind, fields in attempts:
        answer = bench.service(name, kind, **fields)
        assert not answer.success, name
        assert "the bench is in mode identification; call stop of /bench/supervisor" in answer.message
    assert "the bench is busy: run_experiment" in bench.client.run_control(test, tmp_path / "again", 0).message
    assert bench.client.spin(ended.done, 90)
    result = ended.result().result
    assert result.success, result.message
    assert bench.clock.now() - begun > 4.0
    assert len(read_run(tmp_path / "bag")) == result.samples > 3000
