"""A diagnosis on the bench, by its tool and the real nodes: a stop ends it, and it goes on where it ended."""

import json
import os
import pty
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import psutil
import pytest
from std_msgs.msg import Bool
from whole_bench import SharedBench, simulate_first_round

from mrd_interfaces.action import DiagnoseOnBench
from mrd_runs import read_run

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]

ROOT = Path(__file__).resolve().parents[1]
BENCH, PLANT = ROOT / "config/bench.yaml", ROOT / "config/plant.yaml"
SHORT = """
name: short
duration_s: 1.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 8.0, frequency_hz: 1.0}
"""
FIRST = ("large_random_current", "whole_stroke_current", "speed_ladder", "steps_at_two_speeds")

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start `bench --simulated --diagnose`; it is ended with the test."""
    started: list[subprocess.Popen[str]] = []

    def begin(*options: str, plant: Path = PLANT) -> subprocess.Popen[str]:
        command = ["ros2", "run", "mrd_bench_driver", "bench", "--simulated", "--plant", str(plant)]
        command += ["--output", str(tmp_path / "out"), "--diagnose", "bouc_wen", *options]
        environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment))
        return started[-1]

    yield begin
    for process in started:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=120)


@pytest.fixture
def lagging(tmp_path: Path) -> Path:
    """A plant whose force sensor lags."""
    path = tmp_path / "plant.yaml"
    text = PLANT.read_text()
    assert text.count('effects: ""') == 1
    path.write_text(text.replace('effects: ""', 'effects: "force_sensor_lag: {lag: 0.003}"'))
    return path


def wait_for(holds: Callable[[], object], process: subprocess.Popen[str], seconds: float = 300.0) -> None:
    """Wait until a condition holds, while the bench runs."""
    deadline = time.monotonic() + seconds
    while not holds():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.1)


def node_of(process: subprocess.Popen[str], name: str) -> psutil.Process:
    """Return the process of a node of the bench."""
    (found,) = [
        child
        for child in psutil.Process(process.pid).children(recursive=True)
        if any(word.endswith(f"/{name}") for word in child.cmdline()[:3])
    ]
    return found


def closed(bag: Path) -> bool:
    """Return whether a recording is complete."""
    return (bag / "metadata.yaml").exists()


def half_a_second_is_in(bag: Path) -> bool:
    """Return whether a recording has at least so many bytes as hold more than half a second of samples."""
    return sum(file.stat().st_size for file in bag.glob("*.mcap")) > 100_000


@pytest.mark.slow
def test_a_healthy_damper_has_no_gap_however_often_its_diagnosis_was_ended(start: Start, tmp_path: Path) -> None:
    """A closed terminal, the death of the tool, and Ctrl-C end it. Nothing is lost, and nothing is recorded again."""
    round_1 = tmp_path / "out" / "round_1"
    first, aside = round_1 / FIRST[0], [round_1 / "incomplete" / f"{FIRST[0]}_{number}" for number in (1, 2)]
    options: tuple[str, ...] = ()
    for kept, number in ((aside[:0], signal.SIGHUP), (aside[:1], signal.SIGKILL)):
        process = start(*options)
        wait_for(lambda kept=kept: all(map(Path.exists, kept)) and half_a_second_is_in(first), process)  # type: ignore[misc]
        nodes = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(number)
        process.wait(60)
        _, alive = psutil.wait_procs(nodes, 60)
        assert not alive
        assert read_run(first).duration > 0.5
        options = ("--resume",)

    process = start("--resume")
    wait_for(lambda: closed(first) and all(map(closed, aside)), process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert f"recorded until then: {first}" in errors
    assert f"go on by the same command with --resume --output {tmp_path / 'out'}" in errors
    assert all(read_run(path).duration < read_run(first).duration for path in aside)
    kept = (first / "metadata.yaml").stat().st_mtime_ns

    refused = start()
    _, errors = refused.communicate(timeout=120)
    assert refused.returncode == 2
    assert "holds a diagnosis already; go on with it by --resume" in errors

    process = start("--resume")
    output, errors = process.communicate(timeout=400)
    assert process.returncode == 0, errors
    assert "No gap beyond the noise" in output
    assert (first / "metadata.yaml").stat().st_mtime_ns == kept
    written = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert (written["verdict"], written["ending"]) == ("no_gap", "no_gap")
    assert [entry["recordings"] for entry in written["rounds"]] == [list(FIRST)]
    assert (tmp_path / "out" / "diagnosis.html").exists()
    assert (round_1 / "report" / "gap_report.html").exists()


@pytest.mark.slow
def test_a_person_is_led_through_a_measurement_by_hand(tmp_path: Path) -> None:
    """A delay of 0.4 ms is not told from a lag by any run; a recording in which nobody has acted is refused."""
    plant, out = tmp_path / "plant.yaml", tmp_path / "out"
    plant.write_text(PLANT.read_text().replace('effects: ""', 'effects: "channel_delay: {delay: 0.0004}"'))
    ours, theirs = pty.openpty()
    command = ["ros2", "run", "mrd_bench_driver", "bench", "--simulated", "--plant", str(plant), "--output", str(out)]
    log = tmp_path / "said.txt"
    with log.open("w") as said:
        process = subprocess.Popen(
            [*command, "--diagnose", "bouc_wen"], stdin=theirs, stdout=said, stderr=subprocess.PIPE, text=True
        )

    def asked(count: int) -> Callable[[], bool]:
        return lambda: log.read_text().count("Prepare that measurement.") == count

    try:
        wait_for(asked(1), process, 500)
        os.write(ours, b"\n")
        wait_for(lambda: "Enter goes on" in log.read_text(), process)
        os.write(ours, b"\n")
        wait_for(asked(2), process)
        assert f"recorded: {out / 'by_hand' / 'measurement_1'}" in log.read_text()
        assert "is not used: measurement_1: the rod rests" in log.read_text()
        os.write(ours, b"nowhere.csv\n")
        wait_for(asked(3), process)
        assert "nowhere.csv: no such file" in log.read_text()
        os.write(ours, b"q\n")
        _, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert f"--resume --output {out} --add RUN" in log.read_text()


def test_a_fault_is_named_and_a_killed_diagnoser_loses_no_recording(start: Start, lagging: Path, tmp_path: Path) -> None:
    last = tmp_path / "out" / "round_1" / FIRST[-1]
    process = start(plant=lagging)
    wait_for(lambda: closed(last), process)
    node_of(process, "diagnoser").kill()
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "diagnoser ended with status" in errors
    assert errors.count("recorded until then: ") == len(FIRST)

    process = start("--resume", plant=lagging)
    output, errors = process.communicate(timeout=400)
    assert process.returncode == 0, errors
    assert "The force sensor lags by 3." in output or "The force sensor lags by 2.9" in output
    assert "next command: ros2 run mrd_diagnosis apply" in output


@pytest.fixture(scope="module")
def shared_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedBench]:
    with closing(SharedBench(tmp_path_factory.mktemp("bench"), diagnoser=True)) as shared:
        yield shared


@pytest.mark.parametrize("phase", ["it records", "it computes"])
def test_an_emergency_stop_ends_it(bench: Any, tmp_path: Path, phase: str) -> None:
    """Pressed while the rod moves, the recording ends; pressed while the diagnosis computes, that ends."""
    pressed: list[str] = []
    if phase == "it computes":
        simulate_first_round(tmp_path / "out" / "round_1")

    def press(feedback: Any) -> None:
        if not pressed and (feedback.stage.endswith("running") if phase == "it records" else not feedback.moves):
            pressed.append(feedback.stage)
            bench.button.publish(Bool(data=True))

    goal = DiagnoseOnBench.Goal(model="bouc_wen", bench=str(BENCH), folder=str(tmp_path / "out"))
    result = bench.client.diagnose_on_bench(goal, press)
    assert pressed
    assert not result.success
    assert "emergency stop" in result.message
    if phase == "it records":
        assert [path.name for path in (tmp_path / "out" / "round_1").iterdir()] == ["incomplete"]
        assert len(read_run(tmp_path / "out" / "round_1" / "incomplete" / f"{FIRST[0]}_1")) > 0
    assert result.bench_failed
    refused = bench.client.run_set([SHORT], tmp_path / "later", 0)
    assert not refused.success
    assert not (tmp_path / "later").exists()
