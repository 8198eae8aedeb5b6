"""The bench as processes, with small scripts in the place of nodes."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from mrd_base import InputError
from mrd_bench_driver.processes import BenchProcesses, ProcessDiedError, ProcessSpec, bench_processes, find_executable

pytestmark = pytest.mark.realtime

BENCH = Path(__file__).parents[3] / "config" / "bench.yaml"

# Tells its arguments and what ended it, as the others may not have ended yet.
SCRIPT = """#!/bin/sh
trap 'echo {name} >> {ends}; exit 0' TERM
echo "$@"
while :; do sleep 0.02; done
"""


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "prefix"
    (folder / "share/ament_index/resource_index/packages").mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(folder))
    return folder


def add(prefix: Path, name: str, script: str = SCRIPT) -> ProcessSpec:
    (prefix / "share/ament_index/resource_index/packages/fakes").touch()
    program = prefix / "lib/fakes" / name
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(script.replace("{name}", name).replace("{ends}", str(prefix / "ends")))
    program.chmod(0o755)
    return ProcessSpec("fakes", name, {"port": "/tmp/a b", "rate": 2.0}, (BENCH,))


def started(processes: BenchProcesses, times: int = 1) -> None:
    deadline = time.monotonic() + 5
    while not all(processes.log(name).read_text().count("\n") == times for name in processes.running):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_processes_end_in_the_order_that_leaves_the_machine_safe(prefix: Path, tmp_path: Path) -> None:
    names = ["plant", "servo", "recorder", "generator", "helper"]
    with BenchProcesses([add(prefix, name) for name in names], tmp_path / "log") as processes:
        started(processes)
        processes.check()
        pids = [process.pid for process in processes.running.values()]
    ends = (prefix / "ends").read_text().split()
    assert ends[:3] == ["helper", "generator", "servo"]
    assert set(ends[3:]) == {"plant", "recorder"}
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_parameters_reach_a_node_after_those_of_the_files(prefix: Path, tmp_path: Path) -> None:
    with BenchProcesses([add(prefix, "servo")], tmp_path / "log", namespace="/two") as processes:
        started(processes)
        said = processes.log("servo").read_text()
    own = tmp_path / "log" / "servo.yaml"
    assert said == f"--ros-args -r __ns:=/two --params-file {BENCH} --params-file {own}\n"
    assert yaml.safe_load(own.read_text()) == {"/**/servo": {"ros__parameters": {"port": "/tmp/a b", "rate": 2.0}}}


def test_one_that_ignores_sigterm_is_killed_after_the_grace(prefix: Path, tmp_path: Path) -> None:
    stubborn = add(prefix, "servo", "#!/bin/sh\ntrap '' TERM\necho up\nwhile :; do sleep 0.02; done\n")
    with BenchProcesses([stubborn], tmp_path / "log", grace=0.2) as processes:
        started(processes)
        process = processes.running["servo"]
    assert process.returncode == -signal.SIGKILL


def test_one_that_dies_is_told_with_its_last_lines(prefix: Path, tmp_path: Path) -> None:
    dying = add(prefix, "daq", "#!/bin/sh\nfor i in $(seq 30); do echo line $i; done\nexit 7\n")
    with BenchProcesses([dying], tmp_path / "log") as processes:
        processes.running["daq"].wait(5)
        with pytest.raises(ProcessDiedError, match=r"(?s)^daq ended with status 7.*line 16\n.*line 30$"):
            processes.check()


def test_one_that_refuses_its_configuration_is_told_with_its_reason(prefix: Path, tmp_path: Path) -> None:
    refusing = add(prefix, "daq", "#!/bin/sh\necho 'error: node daq: unknown parameter rte_hz'\nexit 2\n")
    with BenchProcesses([refusing], tmp_path / "log") as processes:
        processes.running["daq"].wait(5)
        with pytest.raises(
            ProcessDiedError, match=r"^daq: node daq: unknown parameter rte_hz \(the logs of all nodes are in .*\)$"
        ):
            processes.check()


def test_a_part_can_be_killed_and_started_anew(prefix: Path, tmp_path: Path) -> None:
    with BenchProcesses([add(prefix, "recorder")], tmp_path / "log") as processes:
        started(processes)
        processes.kill("recorder")
        processes.check()
        processes.start("recorder")
        processes.check()
        assert set(processes.running) == {"recorder"}
        started(processes, times=2)
    assert (prefix / "ends").read_text() == "recorder\n"


def test_nothing_is_started_when_a_part_is_missing(prefix: Path, tmp_path: Path) -> None:
    specs = [add(prefix, "plant"), ProcessSpec("fakes", "servo")]
    with pytest.raises(InputError, match="package fakes has no executable servo"), BenchProcesses(specs, tmp_path / "log"):
        pass
    assert not (tmp_path / "log").exists()
    with pytest.raises(InputError, match="package nothing is not built"):
        find_executable("nothing", "servo")


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="needs util-linux")
def test_the_processes_end_when_their_starter_is_killed(prefix: Path, tmp_path: Path) -> None:
    add(prefix, "servo")
    script = (
        "import sys, time; from pathlib import Path; from mrd_bench_driver.processes import BenchProcesses, ProcessSpec\n"
        f"with BenchProcesses([ProcessSpec('fakes', 'servo')], Path({str(tmp_path / 'log')!r})): time.sleep(30)"
    )
    starter = subprocess.Popen([sys.executable, "-c", script])
    log, ends = tmp_path / "log" / "servo.log", prefix / "ends"
    deadline = time.monotonic() + 20
    while not (log.exists() and log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    starter.kill()
    starter.wait()
    while not (ends.exists() and ends.read_text() == "servo\n"):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_simulated_bench_has_a_plant_and_one_serial_port(tmp_path: Path) -> None:
    specs = {p.executable: p for p in bench_processes(BENCH, tmp_path / "plant.yaml", tmp_path / "motor", pace=4, seed=3)}
    assert list(specs) == ["plant", "servo", "daq", "recorder", "generator", "supervisor"]
    port = str(tmp_path / "motor")
    names = "servo,daq,recorder,generator,supervisor,bench"
    clock = {"clock": f"{port}.clock"}
    assert specs["plant"].parameters == {**clock, "port_link": port, "seed": 3, "participants": names, "pace": 4.0}
    assert specs["servo"].parameters == {**clock, "port": port}
    assert specs["recorder"].parameters == clock
    assert specs["daq"].parameters["backend"] == "simulated"
    assert specs["plant"].files == (BENCH, tmp_path / "plant.yaml")


def test_a_real_bench_needs_a_real_converter(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="daq has backend simulated; add --simulated"):
        bench_processes(BENCH, None, tmp_path / "motor")
    real = tmp_path / "bench.yaml"
    real.write_text("/**/daq: {ros__parameters: {backend: ni_usb_6216}}")
    specs = {part.executable: part for part in bench_processes(real, None, tmp_path / "motor")}
    assert "plant" not in specs
    assert all(not spec.parameters for spec in specs.values()), "a real bench has the time of the machine"
