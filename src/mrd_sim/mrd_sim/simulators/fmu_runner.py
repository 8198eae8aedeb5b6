"""An FMU (Functional Mock-up Interface 2.0 and 3.0, co-simulation) as the process of a simulator runs it, by FMPy."""

import ctypes
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.extras import load_extra
from mrd_sim.simulators.fmu_steps import run_steps
from mrd_sim.simulators.fmu_variables import SIGNALS, find_variables

Array = NDArray[np.float64]


VERSIONS = ("2.0", "3.0")
"""Versions of the standard."""


LARGEST_INTERVAL = 2.5
"""Ratio to the usual interval of samples beyond which an interval is a gap."""


class FmuRunner:
    """An FMU, unpacked.

    Parameters
    ----------
    file : Path
    options : mapping
        ``folder`` into which it is unpacked, ``inputs`` (quantity to variable), ``output`` (variable of the force) and
        ``divisions`` (steps from sample to sample).

    Raises
    ------
    InputError
        For what is no FMU, one of another version, kind or platform, or with other variables.
    """

    def __init__(self, file: Path, options: Mapping[str, Any]) -> None:
        fmpy = load_extra("fmpy", "FMPy", "fmu", file)
        self._fmpy = fmpy
        try:
            with zipfile.ZipFile(file) as archive:
                version = ElementTree.fromstring(archive.read("modelDescription.xml")).get("fmiVersion", "none")
            if version in VERSIONS:
                self.description = fmpy.read_model_description(str(file), validate=False)
        except Exception as error:
            raise InputError(f"is not an FMU that can be read ({_one_line(error)})") from None
        if version not in VERSIONS:
            raise InputError(f"is of FMI {version}, expected {' or '.join(VERSIONS)}")
        if self.description.coSimulation is None:
            raise InputError("is for model exchange only, expected co-simulation; export it once more with its solver")
        there = [platform for platform in fmpy.supported_platforms(str(file)) if platform != "c-code"]
        if not {str(fmpy.platform), self._platform()} & set(there):
            raise InputError(
                f"has binaries for {', '.join(there) or 'no platform'}, expected {self._platform()}; export it on this "
                "kind of machine, or compile its sources (fmpy compile)"
            )
        self.variables = find_variables(self.description, options.get("inputs", {}), options.get("output", ""))
        self.divisions = int(options.get("divisions", 1))
        self._folder = Path(options["folder"])
        try:
            fmpy.extract(str(file), str(self._folder))
        except Exception as error:
            raise InputError(f"cannot be unpacked ({_one_line(error)})") from None
        self._said: list[str] = []
        self.feedthrough = self._follows_inputs()

    def _platform(self) -> str:
        """Return the name of this platform in the standard's version of the FMU."""
        if self.description.fmiVersion == "2.0":
            return str(self._fmpy.platform)
        return str(getattr(self._fmpy, "platform_tuple", self._fmpy.platform))

    @property
    def facts(self) -> dict[str, Any]:
        """What is to be known of the FMU."""
        description = self.description
        experiment = description.defaultExperiment
        return {
            "name": description.modelName,
            "standard": f"FMI {description.fmiVersion}",
            "tool": description.generationTool or "",
            "step": None if experiment is None or experiment.stepSize is None else float(experiment.stepSize),
            "feedthrough": self.feedthrough,
            "inputs": [quantity for quantity, _, _ in self.variables.inputs],
            "mapping": dict(self.variables.mapping),
            "units": dict(self.variables.units),
            "wiring": [(*wired, start) for wired, start in zip(self.variables.inputs, self.variables.starts, strict=True)],
            "output": (self.variables.output, self.variables.factor),
            "kept": list(self.variables.kept),
            "parameters": {
                name: {"value": value, "lower": lower, "upper": upper, "unit": unit}
                for name, (_, value, lower, upper, unit) in self.variables.parameters.items()
            },
        }

    def force(self, signals: Array, values: Mapping[str, float]) -> Array:
        """Return the force (n,) in N along signals (5, n) from rest, with parameters by name."""
        variables = self.variables
        time, step = _steps(signals[0])
        inputs = np.array([np.interp(time, signals[0], signals[SIGNALS.index(name)]) for name, _, _ in variables.inputs])
        factors = np.array([factor for _, _, factor in variables.inputs])
        fmu = self._begin(factors * inputs[:, 0], values)
        try:
            force = np.empty(len(time))
            functions = self._addresses(fmu)
            instance = ctypes.cast(fmu.component, ctypes.c_void_p).value
            references = np.array([reference for _, reference, _ in variables.inputs], np.uint32)
            output = np.array([variables.output], np.uint32)
            version = int(self.description.fmiVersion[0])
            asked = functions, instance, version, self.feedthrough, references, output
            failed = run_steps(*asked, step, inputs, factors, self.divisions, force)
            if failed >= 0:
                said = f": {self._said[-1]}" if self._said else ""
                raise InputError(f"the step to sample {failed} of {len(force)}, at {failed * step:.4g} s, failed{said}")
        finally:
            self._finish(fmu)
        return np.asarray(np.interp(signals[0], time, force)) * variables.factor

    def _begin(self, inputs: Array, values: Mapping[str, float]) -> Any:
        """Return a new instance that has been initialised with parameters and the first inputs."""
        self._said.clear()
        try:
            fmu = self._fmpy.instantiate_fmu(
                str(self._folder), self.description, "CoSimulation", logger=self._log(), require_functions=False
            )
            is_2 = self.description.fmiVersion == "2.0"
            set_values = fmu.setReal if is_2 else fmu.setFloat64
            references = [self.variables.parameters[name][0] for name in values]
            if references:
                set_values(references, list(values.values()))
            if is_2:
                fmu.setupExperiment(startTime=0.0)
                fmu.enterInitializationMode()
            else:
                fmu.enterInitializationMode(startTime=0.0)
            set_values([reference for _, reference, _ in self.variables.inputs], list(map(float, inputs)))
            fmu.exitInitializationMode()
        except Exception as error:
            said = f": {self._said[-1]}" if self._said else ""
            raise InputError(f"cannot be initialised ({_one_line(error)}{said})") from None
        return fmu

    def _log(self) -> Any:
        """Return a logger that keeps what the FMU says."""
        if self.description.fmiVersion == "2.0":

            def log_2(_environment: Any, _name: bytes, _status: int, _category: bytes, message: bytes) -> None:
                self._said.append(_one_line(message.decode(errors="replace")))

            return log_2

        def log_3(_environment: Any, _status: int, _category: bytes, message: bytes) -> None:
            self._said.append(_one_line(message.decode(errors="replace")))

        return log_3

    def _finish(self, fmu: Any) -> None:
        with suppress(Exception):
            fmu.terminate()
        with suppress(Exception):
            fmu.freeInstance()

    def _addresses(self, fmu: Any) -> NDArray[np.int64]:
        """Return the addresses of the functions that set, step and get."""
        names = {
            "2.0": ("fmi2SetReal", "fmi2DoStep", "fmi2GetReal"),
            "3.0": ("fmi3SetFloat64", "fmi3DoStep", "fmi3GetFloat64"),
        }
        functions = [getattr(fmu.dll, name) for name in names[self.description.fmiVersion]]
        return np.array([ctypes.cast(function, ctypes.c_void_p).value for function in functions], np.int64)

    def _follows_inputs(self) -> bool:
        """Whether the force follows inputs that are set at the same communication point, without a step."""
        count = len(self.variables.inputs)
        factors = np.array([factor for _, _, factor in self.variables.inputs])
        fmu = self._begin(np.zeros(count), {})
        try:
            is_2 = self.description.fmiVersion == "2.0"
            set_values, get_values = (fmu.setReal, fmu.getReal) if is_2 else (fmu.setFloat64, fmu.getFloat64)
            references, answers = [reference for _, reference, _ in self.variables.inputs], []
            for size in (0.0, 1.0):
                set_values(references, list(size * np.array([0.01]) * factors))
                answers.append(get_values([self.variables.output])[0])
            return bool(answers[0] != answers[1])
        except Exception as error:
            raise InputError(f"refuses inputs after its initialisation ({_one_line(error)})") from None
        finally:
            self._finish(fmu)


def _steps(time: Array) -> tuple[Array, float]:
    """Return the times (m,) to which an FMU is stepped along samples at ``time`` (n,), and the step, in s.

    A clock's jitter is no change of the step, and many FMUs take one step only. Through a gap between samples, an FMU is
    stepped as elsewhere.
    """
    intervals = np.diff(time)
    usual = float(np.median(intervals))
    if intervals.max() <= LARGEST_INTERVAL * usual:
        return time, float(time[-1] - time[0]) / len(intervals)
    count = round(float(time[-1] - time[0]) / usual)
    return np.linspace(time[0], time[-1], count + 1), float(time[-1] - time[0]) / count


def _one_line(text: object) -> str:
    return " ".join(str(text).split())[:300]
