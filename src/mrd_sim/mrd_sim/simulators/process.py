"""A simulator in a process of its own: what it does wrong ends there, and it never runs longer than it may."""

import json
import os
import queue
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim.simulators.messages import read_message, write_message
from mrd_sim.simulators.simulator import Signals, Simulator, SimulatorParameter, checked_force

Array = NDArray[np.float64]

TIME_LIMIT = 60.0
"""s that one answer of a simulator may take, unless another limit is given."""

START_LIMIT = 60.0
"""s that a simulator may take to load, beside the time limit of an answer."""

MOST_SERIES = 64
"""Series of signals that the process keeps, so that they are sent once."""


def limit_option(limit: float) -> str:
    """Return a time limit as on a command line; empty for the usual one."""
    return "" if limit == TIME_LIMIT else f" --simulator-limit {limit:g}"


class ProcessSimulator(Simulator):
    """A simulator that a process of its own runs (`mrd_sim.simulators.worker`).

    Parameters
    ----------
    kind : {"fmu", "python"}
    file : Path
    options : mapping
        For the process, as JSON.
    limit : float
        s that one answer may take.

    Attributes
    ----------
    facts : mapping
        What the process says of the simulator once it is loaded.

    Raises
    ------
    InputError
        When the simulator cannot be loaded.
    """

    def __init__(self, kind: str, file: Path, options: Mapping[str, Any], limit: float = TIME_LIMIT) -> None:
        self.name, self.source, self.file = file.name, shlex.quote(str(file)), file
        self.limit = limit
        self._kind, self._options = kind, dict(options)
        facts = self._start()
        self.parameters = {
            name: SimulatorParameter(
                name,
                float(fact["value"]),
                -np.inf if fact["lower"] is None else float(fact["lower"]),
                np.inf if fact["upper"] is None else float(fact["upper"]),
                fact["unit"],
            )
            for name, fact in facts["parameters"].items()
        }
        self.facts: Mapping[str, Any] = facts
        if "mapping" in facts:
            units = {quantity: f" in {unit}" if unit else "" for quantity, unit in facts["units"].items()}
            named = ", ".join(
                f"{quantity} is {variable}{units[quantity]}" for quantity, variable in facts["mapping"].items()
            )
            keep = "keep their start values" if len(facts["kept"]) > 1 else "keeps its start value"
            kept = f"; {', '.join(facts['kept'])} {keep}" if facts["kept"] else ""
            self.notes = (f"In {self.name}, {named}{kept}.",)
        if "current" not in facts["inputs"]:
            cure = "name the variable with --inputs current=VARIABLE" if kind == "fmu" else "let its function take current"
            self.limitations = (
                f"the simulator {self.name} takes no current: its force is that at one current. If it has one, {cure}",
            )
        chosen = [f"{quantity}={variable}" for quantity, variable in dict(options.get("inputs") or {}).items()]
        self.source += f" --inputs {shlex.quote(','.join(chosen))}" if chosen else ""
        if options.get("output"):
            self.source += f" --output-variable {shlex.quote(str(options['output']))}"
        self.source += limit_option(limit)

    def _start(self) -> dict[str, Any]:
        """Start the process, and return what it says of the simulator."""
        folder = tempfile.mkdtemp(prefix="mrd_simulator_")
        told = json.dumps({**self._options, "folder": folder})
        self._process = subprocess.Popen(
            # Without -P, a file of the user's in this folder could stand for a module of the library.
            [sys.executable, "-P", "-m", "mrd_sim.simulators.worker", self._kind, str(self.file.resolve()), told],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        self._answers: queue.Queue[tuple[dict[str, Any], Array] | None] = queue.Queue()
        self._said: list[str] = []
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._input: IO[bytes] = self._process.stdin
        self._lock = threading.Lock()
        self._known: dict[int, tuple[weakref.ref[Signals], int]] = {}
        self._sent = 0
        threading.Thread(target=_read_answers, args=(self._process.stdout, self._answers), daemon=True).start()
        self._listener = threading.Thread(target=_read_lines, args=(self._process.stderr, self._said), daemon=True)
        self._listener.start()
        self._end = weakref.finalize(self, _end, self._process, folder)
        try:
            facts, _ = self._answer(START_LIMIT + self.limit, "load")
        except InputError:
            self.close()
            raise
        return facts

    def reopen(self) -> None:
        """Start the process once more, where it has ended."""
        if self._process.poll() is not None:
            self.close()
            self._start()

    def force(self, signals: Signals, values: Mapping[str, float] | None = None) -> Array:
        """Return the force (n,) in N; see `Simulator.force`."""
        with self._lock:
            if self._process.poll() is not None:
                raise InputError(f"simulator {self.name}: has ended; load it again")
            header: dict[str, Any] = {"values": dict(values or {})}
            known = self._known.get(id(signals))
            if known is not None and known[0]() is signals:
                header["signals"], rows = known[1], np.empty(0)
            else:
                self._sent += 1
                header["signals"], rows = self._sent, signals.rows()
                header["forget"] = self._sent - MOST_SERIES
                self._known = {
                    key: entry
                    for key, entry in self._known.items()
                    if entry[1] > header["forget"] and entry[0]() is not None
                }
                self._known[id(signals)] = weakref.ref(signals), self._sent
            with suppress(OSError):  # where it has ended, its last words say why
                write_message(self._input, header, rows)
            _, force = self._answer(self.limit, "answer")
        return checked_force(force, len(signals), self.name)

    def close(self) -> None:
        """End the process."""
        self._end()

    def _answer(self, limit: float, what: str) -> tuple[dict[str, Any], Array]:
        try:
            answer = self._next_answer(limit)
        except queue.Empty:
            self.close()
            raise InputError(
                f"simulator {self.name}: did not {what} within {limit:g} s, and was ended; allow more with "
                "--simulator-limit, or record its force and give the recordings"
            ) from None
        if answer is None:
            self._process.wait()
            self._listener.join(1.0)
            raise InputError(f"simulator {self.name}: ended by itself ({self._last_words()})")
        header, content = answer
        if "error" in header:
            raise InputError(f"simulator {self.name}: {header['error']}")
        return header, content

    def _next_answer(self, limit: float) -> tuple[dict[str, Any], Array] | None:
        """Wait for an answer; None where the process has ended, even if a child of it keeps its streams open."""
        until = time.monotonic() + limit
        while True:
            try:
                return self._answers.get(timeout=max(0.0, min(0.5, until - time.monotonic())))
            except queue.Empty:
                if self._process.poll() is not None and self._answers.empty():
                    return None
                if time.monotonic() >= until:
                    raise

    def _last_words(self) -> str:
        code = self._process.returncode
        by = f"signal {-code}" if code < 0 else f"status {code}"
        return f"{by}: {self._said[-1]}" if self._said else by


def _read_answers(stream: IO[bytes], answers: "queue.Queue[tuple[dict[str, Any], Array] | None]") -> None:
    """Pass the messages of a process on, then that it has ended."""
    with stream:
        try:
            while (message := read_message(stream)) is not None:
                answers.put(message)
        except (OSError, ValueError):
            pass  # the process ended in the middle of a message
    answers.put(None)


def _read_lines(stream: IO[bytes], lines: list[str]) -> None:
    """Keep the last lines that a process says."""
    with stream:
        for line in stream:
            if text := line.decode(errors="replace").strip():
                lines.append(text)
                del lines[:-20]


def end_group(process: "subprocess.Popen[Any]") -> None:
    """End a process that began a session of its own, and all children in it."""
    with suppress(OSError, AttributeError):  # Windows knows no groups
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def _end(process: "subprocess.Popen[bytes]", folder: str) -> None:
    """End a process with its children, whatever they are doing, and remove its folder."""
    end_group(process)
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()
    shutil.rmtree(folder, ignore_errors=True)
