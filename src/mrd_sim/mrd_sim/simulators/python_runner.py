"""A Python function as the process of a simulator runs it."""

import importlib.util
import inspect
import sys
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError

Array = NDArray[np.float64]

FUNCTION = "force"
"""Name of the function in the file."""

ARGUMENTS = ("time", "position", "velocity", "current", "parameters")
"""Its arguments, in any order; it need not have all of them."""

PARAMETERS = "PARAMETERS"
"""Name of the mapping in the file with the parameters: a value, or (value, lower, upper), by name."""


class PythonRunner:
    """A file with a function ``force(time, position, velocity, current, parameters)``.

    Raises
    ------
    InputError
        When the file cannot be run, or has no such function.
    """

    def __init__(self, file: Path, _options: Mapping[str, Any]) -> None:
        specification = importlib.util.spec_from_file_location("simulator", file)
        if specification is None or specification.loader is None:
            raise InputError("is not a Python file, expected a name that ends in .py")
        module = importlib.util.module_from_spec(specification)
        # Dataclasses and pickling look a module up by its name.
        sys.modules[specification.name] = module
        sys.path.insert(0, str(file.parent))
        try:
            specification.loader.exec_module(module)
        except BaseException as error:
            raise InputError(f"cannot be run ({describe(error, file)})") from None
        self._file = file
        function = getattr(module, FUNCTION, None)
        if not callable(function):
            raise InputError(f"has no function {FUNCTION}({', '.join(ARGUMENTS)})")
        self._function = function
        declared = inspect.signature(function).parameters.values()
        needed = [p for p in declared if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
        arguments = [p.name for p in needed if p.name in (*ARGUMENTS, "acceleration")]
        if unknown := [p.name for p in needed if p.name not in arguments and p.default is p.empty]:
            raise InputError(
                f"the function {FUNCTION} has the argument {unknown[0]}, expected some of "
                f"{', '.join((*ARGUMENTS, 'acceleration'))}"
            )
        self._arguments = arguments
        self._parameters = _checked_parameters(getattr(module, PARAMETERS, {}))

    @property
    def facts(self) -> dict[str, Any]:
        """What is to be known of the function."""
        return {"name": self._file.name, "inputs": self._arguments, "parameters": self._parameters}

    def force(self, signals: Array, values: Mapping[str, float]) -> Array:
        """Return what the function answers to signals (5, n) with parameters by name."""
        parameters = {name: fact["value"] for name, fact in self._parameters.items()} | dict(values)
        known = dict(zip(("time", "position", "velocity", "acceleration", "current"), signals.copy(), strict=True))
        known["parameters"] = parameters
        try:
            answer = self._function(**{name: known[name] for name in self._arguments})
        except BaseException as error:
            raise InputError(f"the function {FUNCTION} failed ({describe(error, self._file)})") from None
        try:
            return np.asarray(answer, np.float64)
        except (TypeError, ValueError):
            raise InputError(
                f"the function {FUNCTION} answered with {type(answer).__name__}, expected an array of numbers"
            ) from None


def describe(error: BaseException, file: Path) -> str:
    """Return what an error in a file says, in one line with the line of the file."""
    lines = []
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(file):
            lines.append(trace.tb_lineno)
        trace = trace.tb_next
    if isinstance(error, SyntaxError) and error.lineno:
        lines.append(error.lineno)
    text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return f"line {lines[-1]}: {text}" if lines else text


def _checked_parameters(declared: object) -> dict[str, dict[str, Any]]:
    if not isinstance(declared, Mapping):
        raise InputError(
            f"{PARAMETERS} is {type(declared).__name__}, expected {{NAME: VALUE}} or {{NAME: (VALUE, LOW, HIGH)}}"
        )
    checked = {}
    for name, entry in declared.items():
        numbers = list(entry) if isinstance(entry, tuple | list) else [entry]
        if len(numbers) not in (1, 3) or not all(isinstance(n, Real) and not isinstance(n, bool) for n in numbers):
            raise InputError(f"{PARAMETERS}: {name} is {entry!r}, expected a number or (VALUE, LOW, HIGH)")
        value, lower, upper = numbers if len(numbers) == 3 else (numbers[0], None, None)
        bounds = [None if bound is None else float(bound) for bound in (lower, upper)]
        checked[str(name)] = {"value": float(value), "lower": bounds[0], "upper": bounds[1], "unit": ""}
    return checked
