"""Control experiments: an emulated system, what excites it, a law, a damper and an actuator, in a YAML file."""

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mrd_base import InputError, from_mapping, quantity, read_yaml, to_mapping
from mrd_base.config import parse_yaml, unknown_key, yaml_key
from mrd_control.catalogue import build_entry, require_number
from mrd_control.controller import Actuator
from mrd_control.excitations import EXCITATIONS, Excitation, build_excitation
from mrd_control.excitations.excitation import resolve_file
from mrd_control.laws import Law, find_law
from mrd_control.prediction import MODEL, PREDICTORS, find_predictor
from mrd_control.ride import DataSheet
from mrd_control.systems import SYSTEMS, System
from mrd_identification.export import load_damper
from mrd_sim.damper import Damper
from mrd_trajectory.limits import LARGEST_CURRENT

Array = NDArray[np.float64]

ENDING = 1.5
"""s at the end of a run, over which the motion of the base fades, so that the rod comes to rest."""
BEGINNING = 2.0
"""s at its beginning that do not count in the metrics."""
_DAMPER_KEYS = ("fit", "model", "laws", "parameters", "effects")


@dataclass(frozen=True, eq=False)
class ControlExperiment:
    """A hybrid test: the emulated system is computed, the damper is on the bench."""

    name: str = quantity(unit="", doc="letters, digits, - and _; names the recording")
    duration: float = quantity(unit="s", doc="of the run; the excitation fades at its end", lower=5, upper=3600)
    system: System = quantity(doc="emulated system with its parameters")
    excitation: Excitation = quantity(doc="motion of its base with its parameters")
    law: str = quantity(doc="control law of the coil current")
    damper: Damper = quantity(doc="model of the damper, {fit: FILE} or {model: ID, parameters: {...}}")
    gains: dict = quantity(dataclasses.MISSING, doc="parameters of the law, {NAME: VALUE} in SI; {} for its defaults")  # type: ignore[type-arg]
    rate: float = quantity(1000.0, "Hz", "samples per second; each is a cycle of the law", lower=50, upper=2000)
    cycle: float = quantity(0.004, "ms", "longest time from one setpoint to the next", lower=0.001, upper=0.02)
    most_current: float = quantity(1.0, "A", "largest coil current that the law may command", lower=0, upper=LARGEST_CURRENT)
    supply_lag: float = quantity(0.003, "ms", "of the coil supply, in the offline twin", lower=0, upper=0.2)
    delay: float = quantity(0.0, "ms", "by which a setpoint has to come before the servo can follow it", lower=0, upper=0.1)
    lag: float = quantity(0.0, "ms", "of the rod behind what the servo follows", lower=0, upper=0.1)
    predictor: str = quantity(MODEL, doc=f"compensation of both: {', '.join([MODEL, *PREDICTORS])}")
    stroke: float = quantity(DataSheet.stroke, "mm", "of the damper, from end to end", lower=1e-4, upper=2)
    coil_resistance: float = quantity(DataSheet.coil_resistance, "ohm", "of the damper's coil", lower=0, upper=1e4)
    description: str = quantity("", doc="purpose of the experiment")

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", self.name):
            raise InputError(f"name: found {self.name!r}, expected 1 to 64 letters, digits, - and _")
        if self.cycle * self.rate < 1.0 - 1e-6:
            raise InputError(
                f"cycle_ms is {1e3 * self.cycle:g}, expected at least {1e3 / self.rate:g}, one sample at rate_hz "
                f"{self.rate:g}"
            )
        find_law(self.law).values(self.gains)
        if self.predictor != MODEL:
            find_predictor(self.predictor)

    @property
    def actuator(self) -> Actuator:
        """What brings the emulated motion to the damper."""
        return Actuator(self.delay, self.lag, self.predictor)

    @property
    def data_sheet(self) -> DataSheet:
        """Data of the damper that the metrics need."""
        return DataSheet(self.stroke, self.coil_resistance)

    @property
    def block(self) -> float:
        """Time in s from one setpoint to the next: the samples that fit into a cycle."""
        return max(1, math.floor(self.cycle * self.rate + 1e-6)) / self.rate

    @property
    def loop_actuator(self) -> Actuator:
        """The actuator as the stability of the loop sees it: a setpoint has to last for a block of samples.

        So what it was made of is older than one sample by half of the rest of a block, on the average. The emulated system
        predicts its motion over this time as well; the other predictors do not.
        """
        held = 0.5 * (self.block - 1.0 / self.rate)
        ahead = None if self.predictor == MODEL else self.actuator.total_delay
        return Actuator(self.delay + held, self.lag, self.predictor, ahead)

    @property
    def modelled_actuator(self) -> Actuator:
        """The same for the controller and the offline twin: where the system predicts itself, the rod is in time."""
        return Actuator(0.0) if self.predictor == MODEL else self.actuator

    @property
    def control_law(self) -> Law:
        """The law."""
        return find_law(self.law)

    @property
    def samples(self) -> int:
        """Cycles of the law in a run."""
        return round(self.duration * self.rate) + 1

    @cached_property
    def base(self) -> Array:
        """Position in m and velocity in m/s of the base (samples, 2); it fades over the last `ENDING` s.

        Raises
        ------
        InputError
            When the excitation is shorter than the run, or its file cannot be used.
        """
        motion = self.excitation.base(self.samples, self.rate)
        left = np.clip((self.duration - np.arange(self.samples) / self.rate) / ENDING, 0.0, 1.0)
        fade, slope = left**3 * (10.0 - 15.0 * left + 6.0 * left**2), -30.0 * left**2 * (1.0 - left) ** 2 / ENDING
        return np.stack([fade * motion[:, 0], fade * motion[:, 1] + slope * motion[:, 0]], axis=1)

    @property
    def counted(self) -> slice:
        """Samples that count in the metrics: without the beginning and the end of a run."""
        return slice(round(BEGINNING * self.rate), round((self.duration - ENDING) * self.rate))


def read_control_experiment(path: str | Path) -> ControlExperiment:
    """Read a control experiment from a YAML file.

    Raises
    ------
    InputError
        With one line: file, field, what was found and what was expected.
    """
    return _build(read_yaml(path), str(path), Path(path).resolve().parent)


def parse_control_experiment(text: str, where: str) -> ControlExperiment:
    """Read a control experiment from YAML text; ``where`` is the prefix of error messages.

    The file of an excitation needs its full path then. Raises as the above.
    """
    return _build(parse_yaml(text, where), where, None)


def format_control_experiment(experiment: ControlExperiment) -> str:
    """Return the YAML text of an experiment, complete without other files; `parse_control_experiment` reads it back."""
    mapping: dict[str, Any] = {}
    for field in dataclasses.fields(experiment):
        value = getattr(experiment, field.name)
        key, factor = yaml_key(field)
        mapping[key] = float(f"{value / factor:.15g}") if isinstance(value, float) else value
    mapping |= {
        "system": _entry("system", SYSTEMS, experiment.system),
        "excitation": _entry("excitation", EXCITATIONS, experiment.excitation.complete()),
        "damper": damper_entry(experiment.damper),
    }
    return yaml.safe_dump(mapping, sort_keys=False, allow_unicode=True, width=120)


def damper_entry(damper: Damper) -> dict[str, Any]:
    """Return model, laws, parameters and effects of a damper: its entry in the file, and the arguments of a new one."""
    values = dict(zip(damper.model.names, map(float, damper.theta), strict=True))
    effects = {
        effect.id: {parameter.name: values.pop(f"{effect.id}.{parameter.name}") for parameter in effect.parameters}
        for effect in damper.model.effects
    }
    return {"model": damper.model.id, "laws": damper.model.laws, "parameters": values, "effects": effects}


def _entry(kind: str, catalogue: Mapping[str, type[Any]], entry: Any) -> dict[str, Any]:
    return {kind: next(name for name, cls in catalogue.items() if cls is type(entry)), **to_mapping(entry)}


def _build(mapping: dict[str, Any], where: str, folder: Path | None) -> ControlExperiment:
    built: dict[str, Any] = {}
    if "system" in mapping:
        built["system"] = build_entry(SYSTEMS, "system", mapping["system"], f"{where}: system")
    if "excitation" in mapping:
        built["excitation"] = build_excitation(mapping["excitation"], f"{where}: excitation", folder)
    if "damper" in mapping:
        built["damper"] = _damper(mapping["damper"], f"{where}: damper", folder)
    return from_mapping(ControlExperiment, {"gains": {}, **mapping, **built}, where)


def _damper(mapping: Any, where: str, folder: Path | None) -> Damper:
    if not isinstance(mapping, Mapping) or ("fit" in mapping) == ("model" in mapping):
        raise InputError(f"{where}: expected {{fit: FILE}}, or {{model: ID, parameters: {{NAME: VALUE}}}}")
    for key in mapping:
        if key not in _DAMPER_KEYS or ("fit" in mapping and key != "fit"):
            raise InputError(f"{where}: unknown key {unknown_key(key, ('fit',) if 'fit' in mapping else _DAMPER_KEYS[1:])}")
    if "fit" in mapping:
        return load_damper(resolve_file(str(mapping["fit"]), folder or Path()))
    laws = mapping.get("laws") or {}
    if not isinstance(laws, str) and not (isinstance(laws, Mapping) and all(isinstance(law, str) for law in laws.values())):
        raise InputError(f"{where}: laws is {laws!r:.60}, expected a current law, or {{COEFFICIENT: LAW}}")
    effects = _mapping(mapping, "effects", where)
    try:
        return Damper(
            str(mapping["model"]),
            _numbers(mapping, "parameters", where),
            laws,
            {str(effect): _numbers(effects, effect, f"{where}: effects") for effect in effects},
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _mapping(mapping: Mapping[Any, Any], key: Any, where: str) -> Mapping[Any, Any]:
    """Return the mapping of names that a key holds; {} where it holds nothing."""
    entry = mapping.get(key)
    if entry is not None and not isinstance(entry, Mapping):
        raise InputError(f"{where}: {key} is {entry!r:.60}, expected {{NAME: VALUE}}")
    return entry or {}


def _numbers(mapping: Mapping[Any, Any], key: Any, where: str) -> dict[str, float]:
    return {str(name): require_number(value, f"{key}: {name}") for name, value in _mapping(mapping, key, where).items()}
