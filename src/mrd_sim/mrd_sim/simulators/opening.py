"""Opening a simulator that is named on a command line or in a notebook."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from mrd_base import InputError
from mrd_runs.read import read_runs
from mrd_sim.simulators.command import COMMAND, CommandSimulator
from mrd_sim.simulators.process import TIME_LIMIT, ProcessSimulator
from mrd_sim.simulators.recorded import RecordedSimulator
from mrd_sim.simulators.simulator import Simulator

LONGEST_LIMIT = 86400.0
"""s that an answer may take at most."""

KINDS = {".fmu": "fmu", ".py": "python"}
"""Kind of simulator by the end of its name; every other file is a recording of one."""


def is_simulator(name: str) -> bool:
    """Return whether a name on a command line is that of an FMU, a Python file or a command, and of no recording."""
    return name.startswith(COMMAND) or Path(name).suffix.lower() in KINDS


def open_simulator(
    sources: str | Path | Sequence[str | Path],
    *,
    inputs: Mapping[str, str] | None = None,
    output: str = "",
    limit: float = TIME_LIMIT,
    skip: float = 0.0,
) -> Simulator:
    """Open a simulator of the user's own.

    Parameters
    ----------
    sources : path, or sequence of paths
        An FMU (``.fmu``), a Python file (``.py``) with a function `force`, a command after ``command:``, or recordings of a
        simulator, one for each run.
    inputs : mapping, optional
        For an FMU, the variable of each quantity (time, position, velocity, acceleration, current) whose name does not tell.
    output : str
        For an FMU, the variable of the force, where its name does not tell.
    limit : float
        s that one answer of the simulator may take.
    skip : float
        s that are left out at the start of recordings of a simulator, as they are of the runs.

    Raises
    ------
    InputError
        When it cannot be loaded.
    """
    named = [sources] if isinstance(sources, str | Path) else list(sources)
    if not named:
        raise InputError("no simulator, expected an FMU, a Python file, a command or recordings")
    if not 0.0 < limit <= LONGEST_LIMIT:
        raise InputError(f"--simulator-limit is {limit:g} s, expected more than 0 and at most {LONGEST_LIMIT:g}")
    first = str(named[0])
    kind = COMMAND if first.startswith(COMMAND) else KINDS.get(Path(first).suffix.lower(), "")
    if kind and len(named) > 1:
        raise InputError(f"--simulator: found {len(named)} ({first}, ...), expected one FMU, one Python file or one command")
    if kind != "fmu" and (inputs or output):
        raise InputError("--inputs and --output-variable name variables of an FMU, and the simulator is none")
    if kind == COMMAND:
        return CommandSimulator(first.removeprefix(COMMAND).strip(), limit)
    if kind:
        if not Path(first).is_file():
            raise InputError(f"{first}: no such file")
        return ProcessSimulator(kind, Path(first), {"inputs": dict(inputs or {}), "output": output}, limit)
    return RecordedSimulator(read_runs(named, skip))
