"""A command as a simulator: it reads a table of signals, and writes the force."""

import io
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.workers import ending_with_parent
from mrd_sim.simulators.process import TIME_LIMIT, end_group, limit_option
from mrd_sim.simulators.simulator import Signals, Simulator, SimulatorParameter, checked_force

Array = NDArray[np.float64]

COMMAND = "command:"
"""What a command begins with on a command line, so that it is no name of a file."""

HEADER = "time_s,position_m,velocity_mps,acceleration_mps2,current_A"
"""Columns of the table that the command reads from its standard input, as CSV."""


class CommandSimulator(Simulator):
    """A command that reads CSV with the columns `HEADER` from its standard input, and writes one force in N a line.

    A line that is no number, such as a header, may come first. Parameters follow the command as ``NAME=VALUE``.

    Parameters
    ----------
    command : str
        The command with its arguments, as in a shell.
    limit : float
        s that one answer may take.
    """

    def __init__(self, command: str, limit: float = TIME_LIMIT) -> None:
        try:
            self._arguments: Sequence[str] = shlex.split(command)
        except ValueError as error:
            raise InputError(f"simulator command {command!r}: cannot be read ({error})") from None
        if not self._arguments:
            raise InputError("simulator command: is empty, expected a command with its arguments")
        self.name, self.source = command, shlex.quote(f"{COMMAND}{command}") + limit_option(limit)
        self.parameters: Mapping[str, SimulatorParameter] = {}
        self._limit = limit

    def force(self, signals: Signals, values: Mapping[str, float] | None = None) -> Array:
        """Return the force (n,) in N; see `Simulator.force`."""
        text = io.StringIO()
        np.savetxt(text, signals.rows().T, delimiter=",", header=HEADER, comments="", fmt="%.17g")
        if shutil.which(self._arguments[0]) is None:
            raise InputError(f"simulator {self.name}: cannot be run (no such program)")
        settings = [f"{name}={value!r}" for name, value in (values or {}).items()]
        try:
            process = subprocess.Popen(
                ending_with_parent([*self._arguments, *settings]),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            raise InputError(f"simulator {self.name}: cannot be run ({error.strerror})") from None
        try:
            output, said = process.communicate(text.getvalue().encode(), timeout=self._limit)
        except subprocess.TimeoutExpired:
            raise InputError(
                f"simulator {self.name}: did not answer within {self._limit:g} s, and was ended; allow more with "
                "--simulator-limit, or record its force and give the recordings"
            ) from None
        finally:
            end_group(process)
        if process.returncode:
            words = [line.strip() for line in said.decode(errors="replace").splitlines() if line.strip()]
            last = f": {words[-1]}" if words else ""
            raise InputError(f"simulator {self.name}: ended with status {process.returncode}{last}")
        return checked_force(_numbers(output.decode("utf-8-sig", errors="replace"), self.name), len(signals), self.name)


def _numbers(text: str, name: str) -> Array:
    """Return the numbers of a column; a first line that is none is a header."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    numbers = []
    for index, line in enumerate(lines):
        try:
            numbers.append(float(line))
        except ValueError:
            if index == 0:
                continue
            raise InputError(
                f"simulator {name}: line {index + 1} of its answer is {line[:60]!r}, expected a number"
            ) from None
    return np.array(numbers)
