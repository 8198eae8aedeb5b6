"""The processes of the bench: start them together, watch them, and end them however the program ends."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from mrd_base import InputError, read_node_parameters
from mrd_base.workers import ending_with_parent

# Nodes that command a motion end first. Then end those that release rod and coil, while motor and recorder still run.
_STOP_ORDER = (("supervisor", "generator", "controller"), ("servo", "daq"), ("recorder", "plant"))

# Those for whom the time of a simulated bench begins: the nodes, and the client that lets them run experiments.
PARTICIPANTS = "servo,daq,recorder,generator,supervisor,bench"

# Lines of the log of a process that its error message shows.
_LOG_LINES = 15


def clock_of(port: Path) -> Path:
    """Return the socket of the bench time of the simulated plant with a serial port."""
    return port.with_name(port.name + ".clock")


class ProcessDiedError(Exception):
    """A process of the bench ended by itself. The message holds the last lines of its log."""

    def __init__(self, name: str, message: str) -> None:
        super().__init__(message)
        self.name = name


@dataclass(frozen=True)
class ProcessSpec:
    """A process to start: an executable of a package, its parameter files, and parameters that override them.

    The bench goes on without a ``guest``.
    """

    package: str
    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    guest: bool = False


def find_executable(package: str, executable: str) -> Path:
    """Return the path of an executable, found by the ament index as ``ros2 run`` does."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and Path(prefix, "share/ament_index/resource_index/packages", package).exists():
            program = Path(prefix, "lib", package, executable)
            if os.access(program, os.X_OK):
                return program
            raise InputError(f"package {package} has no executable {executable}; build it with `make build`")
    raise InputError(f"package {package} is not built or not entered; run `make build`, then `. ./env.sh`")


def bench_processes(
    bench: Path,
    plant: Path | None,
    port: Path,
    *,
    pace: float | None = None,
    seed: int = 0,
    control_cycle: float | None = None,
    page: bool = False,
    diagnoser: bool = False,
) -> list[ProcessSpec]:
    """Return the processes of a bench.

    Parameters
    ----------
    bench : Path
        Parameter file of all nodes.
    plant : Path or None
        Parameter file of the simulated plant; None for the real bench.
    port : Path
        Path at which the simulated plant creates the serial port of the motor.
    pace : float, optional
        Largest number of bench seconds in a wall second of a simulated bench, by default as many as the machine computes.
    seed : int
        Seed of the plant's noise.
    control_cycle : float, optional
        Time in s between two setpoints of a hybrid test: the length of a block of samples. With it, the bench has a
        controller.
    page : bool
        Whether the operator's page is served.
    diagnoser : bool
        Whether the bench has a diagnoser, for a diagnosis that records what it needs.
    """
    # On a simulated bench, all nodes wait for each other.
    common: dict[str, Any] = {} if plant is None else {"clock": str(clock_of(port))}
    servo, daq, supervisor = dict(common), dict(common), dict(common)
    block = {} if control_cycle is None else {"block_ms": 1e3 * control_cycle}
    daq |= block
    controllers = [] if control_cycle is None else [ProcessSpec("mrd_control", "controller", common, (bench,))]
    specs = []
    if plant is not None:
        participants = ",".join([PARTICIPANTS, *(spec.executable for spec in controllers)])
        simulation = {"port_link": str(port), "seed": seed, "participants": participants, **block}
        if pace is not None:
            simulation["pace"] = float(pace)
        specs.append(ProcessSpec("mrd_sim", "plant", {**common, **simulation}, (bench, plant)))
        servo["port"], daq["backend"] = str(port), "simulated"
        # Nothing moves while the supervisor waits for a process. ROS tells a dead one from a slow one within 20 s.
        supervisor |= {"answer_timeout_s": 30.0, "discovery_timeout_s": 60.0}
    elif read_node_parameters(bench, "daq").get("backend", "simulated") == "simulated":
        raise InputError(f"{bench}: daq has backend simulated; add --simulated, or set backend: ni_usb_6216")
    return [
        *specs,
        ProcessSpec("mrd_bench_driver", "servo", servo, (bench,)),
        ProcessSpec("mrd_bench_driver", "daq", daq, (bench,)),
        ProcessSpec("mrd_runs", "recorder", common, (bench,)),
        ProcessSpec("mrd_trajectory", "generator", common, (bench,)),
        *controllers,
        ProcessSpec("mrd_bench_driver", "supervisor", supervisor, (bench,)),
        # Without the diagnoser there is no diagnosis on the bench; the page does without it.
        *([ProcessSpec("mrd_diagnosis", "diagnoser", files=(bench,), guest=not diagnoser)] if diagnoser or page else []),
        *([_page(bench, plant)] if page else []),
    ]


def _page(bench: Path, plant: Path | None) -> ProcessSpec:
    """Return the process of the operator's page, which takes no part in the time of a simulated bench."""
    parameters = {"bench": str(bench.resolve())} | ({"plant": str(plant.resolve())} if plant else {})
    return ProcessSpec("mrd_dashboard", "page", parameters, (bench,), guest=True)


class BenchProcesses:
    """Runs processes of the bench as long as the context lasts.

    Parameters
    ----------
    specs : sequence of ProcessSpec
        Processes in the order of their start. Each is named after its executable.
    logs : Path
        Folder for the output of each process (NAME.log) and for the parameters that override its files (NAME.yaml).
    namespace : str
        ROS namespace of all nodes.
    grace : float
        Wall time in s between SIGTERM and SIGKILL.
    environment : mapping, optional
        Environment variables in addition to those of this process.

    Notes
    -----
    Each process runs in a session of its own, so that Ctrl-C reaches only this process. Each receives SIGTERM if this
    process is killed.
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        logs: Path,
        *,
        namespace: str = "/bench",
        grace: float = 5.0,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.specs = {spec.executable: spec for spec in specs}
        self.namespace = namespace
        self._logs = logs
        self._grace = grace
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", **(environment or {})}
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "BenchProcesses":
        try:
            for name, spec in self.specs.items():
                find_executable(spec.package, name)  # nothing is started if one is missing
            for name in self.specs:
                self.start(name)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _traceback: TracebackType | None
    ) -> None:
        self.close()

    def start(self, name: str) -> "subprocess.Popen[bytes]":
        """Start a process, or restart one that was stopped; raise `InputError` if its log cannot be written."""
        try:
            return self._start(name)
        except OSError as error:
            raise InputError(
                f"{self._logs}: the logs cannot be written there ({error.strerror or error}); choose another --output "
                "or make room"
            ) from error

    def _start(self, name: str) -> "subprocess.Popen[bytes]":
        spec = self.specs[name]
        program = find_executable(spec.package, name)
        self._logs.mkdir(parents=True, exist_ok=True)
        arguments = ["--ros-args", "-r", f"__ns:={self.namespace}"]
        for file in spec.files:
            arguments += ["--params-file", str(file)]
        if spec.parameters:
            # These go into another file, because the node's sections in the first files would override -p.
            overrides = self._logs / f"{name}.yaml"
            overrides.write_text(yaml.safe_dump({f"/**/{name}": {"ros__parameters": dict(spec.parameters)}}))
            arguments += ["--params-file", str(overrides)]
        with self.log(name).open("ab") as log:
            process = subprocess.Popen(
                # If this process is killed, the bench must not go on by itself.
                ending_with_parent([str(program), *arguments]),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=self._environment,
            )
        self.running[name] = process
        return process

    def log(self, name: str) -> Path:
        """Return the file with the output of a process."""
        return self._logs / f"{name}.log"

    def check(self) -> None:
        """Raise `ProcessDiedError` if a process has ended, with its reason where it refused its configuration."""
        for name, process in self.running.items():
            status = process.poll()
            # One that refuses its configuration is named in every case.
            if status is None or (self.specs[name].guest and status != 2):
                continue
            lines = self.log(name).read_text(errors="replace").splitlines()[-_LOG_LINES:]
            if status == 2 and lines:
                reason = lines[-1].removeprefix("error: ")
                raise ProcessDiedError(name, f"{name}: {reason} (the logs of all nodes are in {self._logs})")
            output = "".join(f"\n  {line}" for line in lines) or " nothing"
            raise ProcessDiedError(name, f"{name} ended with status {status}; its log {self.log(name)} ends with{output}")

    def stop(self, *names: str) -> None:
        """End processes together: SIGTERM, then SIGKILL to those that still run after the grace period."""
        processes = [self.running.pop(name) for name in names if name in self.running]
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
        deadline = time.monotonic() + self._grace
        for process in processes:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def kill(self, name: str) -> None:
        """End a process at once, as a crash does."""
        process = self.running.pop(name)
        process.send_signal(signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        """End all processes in the order that leaves the machine safe."""
        known = {name for stage in _STOP_ORDER for name in stage}
        for stage in (tuple(name for name in self.running if name not in known), *_STOP_ORDER):
            self.stop(*stage)
