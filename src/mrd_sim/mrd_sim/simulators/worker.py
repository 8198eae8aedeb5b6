"""The process of a simulator: it loads one, then answers until nobody asks any more."""

import json
import os
import sys
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.workers import end_with
from mrd_sim.simulators.messages import read_message, write_message

if TYPE_CHECKING:
    from mrd_sim.simulators.fmu_runner import FmuRunner
    from mrd_sim.simulators.python_runner import PythonRunner


def main() -> None:
    """Entry point of ``python -m mrd_sim.simulators.worker KIND FILE OPTIONS``."""
    kind, file, options = sys.argv[1:4]
    # What the simulator prints must not get among the answers.
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    questions = os.fdopen(os.dup(0), "rb")
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    end_with(os.getppid())
    serve(kind, Path(file), json.loads(options), questions, output)


def load(kind: str, file: Path, options: dict[str, object]) -> "FmuRunner | PythonRunner":
    """Load a simulator. What only FMUs need takes a second to import, and each function of the user's would wait for it."""
    if kind == "fmu":
        from mrd_sim.simulators.fmu_runner import FmuRunner

        return FmuRunner(file, options)
    from mrd_sim.simulators.python_runner import PythonRunner

    return PythonRunner(file, options)


def serve(kind: str, file: Path, options: dict[str, object], questions: IO[bytes], answers: IO[bytes]) -> None:
    """Load a simulator, say what it is, and answer questions until their stream ends."""
    nothing = np.empty(0)
    try:
        runner = load(kind, file, options)
    except InputError as error:
        write_message(answers, {"error": str(error)}, nothing)
        return
    write_message(answers, runner.facts, nothing)
    known: dict[int, NDArray[np.float64]] = {}
    while (question := read_message(questions)) is not None:
        header, rows = question
        if rows.size:
            known[header["signals"]] = rows
            known = {number: kept for number, kept in known.items() if number > header["forget"]}
        try:
            force = runner.force(known[header["signals"]], header["values"])
        except InputError as error:
            write_message(answers, {"error": str(error)}, nothing)
        else:
            write_message(answers, {}, force)


if __name__ == "__main__":
    main()
