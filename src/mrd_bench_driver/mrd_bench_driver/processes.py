"""The bench as a set of processes: started together, watched, and ended on every way out."""

import contextlib
import os
import shutil
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

# Those that move something end first, then those that let go of rod and coil while motor and recorder still listen.
_STOP_ORDER = (("supervisor", "generator"), ("servo", "daq"), ("recorder", "plant"))

_LAST_LINES = 15


class ProcessDiedError(Exception):
    """A part of the bench ended by itself; what it said last."""


@dataclass(frozen=True)
class Part:
    """One process: an executable of a package, and parameters beyond the files."""

    package: str
    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()


def find_executable(package: str, executable: str) -> Path:
    """Where ``ros2 run`` would find it, by the ament index."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and Path(prefix, "share/ament_index/resource_index/packages", package).exists():
            program = Path(prefix, "lib", package, executable)
            if os.access(program, os.X_OK):
                return program
            raise InputError(f"package {package} has no executable {executable}; build it with `make build`")
    raise InputError(f"package {package} is not built or not entered; run `make build`, then `. ./env.sh`")


def bench_parts(
    bench: Path, plant: Path | None, port: Path, *, time_scale: float | None = None, seed: int = 0
) -> list[Part]:
    """The parts of a bench.

    Parameters
    ----------
    bench : Path
        The parameter file of all nodes.
    plant : Path or None
        The parameter file of the simulated plant; None for the real bench.
    port : Path
        Where the simulated plant shows the motor's serial port.
    time_scale : float, optional
        Bench seconds per wall second, in place of the file's.
    seed : int
        Of the plant's noise.
    """
    common: dict[str, Any] = {} if time_scale is None else {"time_scale": float(time_scale)}
    servo, daq = dict(common), dict(common)
    parts = []
    if plant is not None:
        parts.append(Part("mrd_sim", "plant", {**common, "port_link": str(port), "seed": seed}, (bench, plant)))
        servo["port"], daq["backend"] = str(port), "simulated"
    elif read_node_parameters(bench, "daq").get("backend", "simulated") == "simulated":
        raise InputError(f"{bench}: daq has backend simulated; add --simulated, or set backend: ni_usb_6216")
    return [
        *parts,
        Part("mrd_bench_driver", "servo", servo, (bench,)),
        Part("mrd_bench_driver", "daq", daq, (bench,)),
        Part("mrd_runs", "recorder", common, (bench,)),
        Part("mrd_trajectory", "generator", common, (bench,)),
        Part("mrd_bench_driver", "supervisor", common, (bench,)),
    ]


class BenchProcesses:
    """Runs parts of the bench as long as the context lasts.

    Parameters
    ----------
    parts : sequence of Part
        Named by their executables; started in this order.
    logs : Path
        Folder for what each of them prints (NAME.log) and for its own parameters (NAME.yaml).
    namespace : str
        ROS namespace of all nodes.
    grace : float
        Wall seconds between SIGTERM and SIGKILL.
    environment : mapping, optional
        Variables beyond those of this process.

    Notes
    -----
    Each part is in a session of its own, so that Ctrl-C reaches this process only, and is sent SIGTERM should this process
    be killed.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        logs: Path,
        *,
        namespace: str = "/bench",
        grace: float = 5.0,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.parts = {part.executable: part for part in parts}
        self.namespace = namespace
        self._logs = logs
        self._grace = grace
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", **(environment or {})}
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "BenchProcesses":
        try:
            programs = {name: find_executable(part.package, name) for name, part in self.parts.items()}
            self._logs.mkdir(parents=True, exist_ok=True)
            for name in programs:
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
        """Start one part, or start it anew after it was stopped."""
        part = self.parts[name]
        program = find_executable(part.package, name)
        # Whoever kills this process must not leave a bench that goes on by itself.
        guard = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
        arguments = ["--ros-args", "-r", f"__ns:={self.namespace}"]
        for file in part.files:
            arguments += ["--params-file", str(file)]
        if part.parameters:
            # A file of its own, as -p would lose against the node's section in the other files.
            own = self._logs / f"{name}.yaml"
            own.write_text(yaml.safe_dump({f"/**/{name}": {"ros__parameters": dict(part.parameters)}}))
            arguments += ["--params-file", str(own)]
        with self.log(name).open("ab") as log:
            process = subprocess.Popen(
                [*guard, str(program), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=self._environment,
            )
        self.running[name] = process
        return process

    def log(self, name: str) -> Path:
        """File with what a part printed."""
        return self._logs / f"{name}.log"

    def check(self) -> None:
        """Raise when a part has ended by itself: `InputError` when it refused its configuration, else `ProcessDiedError`."""
        for name, process in self.running.items():
            status = process.poll()
            if status is None:
                continue
            lines = self.log(name).read_text(errors="replace").splitlines()[-_LAST_LINES:]
            if status == 2 and lines:
                raise InputError(f"{name}: {lines[-1].removeprefix('error: ')}")
            said = "".join(f"\n  {line}" for line in lines) or " nothing"
            raise ProcessDiedError(f"{name} ended with status {status}; its log {self.log(name)} ends with{said}")

    def stop(self, *names: str) -> None:
        """End parts together: SIGTERM, and SIGKILL to those that are still there after the grace."""
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
        """End one part at once, as a crash would."""
        process = self.running.pop(name)
        process.send_signal(signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        """End all parts, in the order that leaves the machine safe."""
        known = {name for stage in _STOP_ORDER for name in stage}
        for stage in (tuple(name for name in self.running if name not in known), *_STOP_ORDER):
            self.stop(*stage)
