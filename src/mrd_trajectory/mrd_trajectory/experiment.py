"""Experiments: the waveforms of rod and coil, in a YAML file."""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from mrd_base import InputError, from_mapping, quantity, read_yaml, to_mapping
from mrd_base.config import named_path, parse_yaml, yaml_key
from mrd_trajectory.transition import KINDS
from mrd_trajectory.until import FEWEST_PASSES, Until
from mrd_trajectory.waveforms import CHANNEL_UNITS, Constant, Waveform, waveform_name, waveform_type

# Default column of a trace for each channel.
_TRACE_COLUMNS = {"rod": "position_m", "coil": "current_A"}


@dataclass(frozen=True)
class Experiment:
    """Waveforms of rod and coil; `mrd_trajectory.plan.plan` makes a motion of them that keeps the limits."""

    name: str = quantity(unit="", doc="letters, digits, - and _; names the recording")
    duration: float = quantity(unit="s", doc="of one pass of the waveforms, without transitions", lower=0.01, upper=3600)
    rate: float = quantity(unit="Hz", doc="samples per second", lower=25, upper=2000)
    rod: Waveform = quantity(Constant(), "", "position of the rod, 0 at mid-stroke, > 0 extends")
    coil: Waveform = quantity(Constant(), "", "current of the coil")
    repeats: int = quantity(1, "", "number of passes of the waveforms", lower=1, upper=100_000)
    transition: str = quantity("quintic", "", f"kind of transition between levels: {', '.join(KINDS)}")
    description: str = quantity("", "", "purpose of the experiment")
    until: Until | None = quantity(None, "", "condition on which it ends before the last pass")

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", self.name):
            raise InputError(f"name: found {self.name!r}, expected 1 to 64 letters, digits, - and _")
        if self.transition not in KINDS:
            raise InputError(f"transition: found {self.transition!r}, expected one of {', '.join(KINDS)}")
        if self.until is not None and self.repeats < FEWEST_PASSES:
            raise InputError(
                f"repeats: found {self.repeats}, expected at least {FEWEST_PASSES} beside until: {FEWEST_PASSES - 1} passes "
                "to compare, and the one that runs when they have been compared"
            )


def read_experiment(path: str | Path) -> Experiment:
    """Read an experiment from a YAML file.

    Raises
    ------
    InputError
        With one line: file, field, what was found and what was expected.
    """
    return _build_experiment(read_yaml(path), str(path), Path(path).resolve().parent)


def parse_experiment(text: str, where: str, folder: Path | None = None) -> Experiment:
    """Read an experiment from YAML text.

    Parameters
    ----------
    text : str
    where : str
        Prefix of error messages.
    folder : Path, optional
        Folder of relative files; without it they are refused.
    """
    return _build_experiment(parse_yaml(text, where), where, folder)


def experiment_text(goal: str) -> str:
    """Return the text of the experiment that a goal or a request names.

    Parameters
    ----------
    goal : str
        YAML text, which is returned, or the path of a YAML file: one line without a key.

    Raises
    ------
    InputError
        As `read_experiment`, for a path.
    """
    line = goal.strip()
    if not line or "\n" in line or ":" in line or line.startswith("{"):
        return goal
    # The sender and this process may work in different folders, so that a message shows the whole path. Nor can whoever
    # gets the text look up files relative to the experiment's file, so that it becomes complete here.
    return format_experiment(read_experiment(named_path(line)))


def format_experiment(experiment: Experiment) -> str:
    """Return the YAML text of an experiment; `parse_experiment` reads it back."""
    mapping: dict[str, Any] = {}
    for field in dataclasses.fields(experiment):
        value = getattr(experiment, field.name)
        if isinstance(value, Waveform):
            mapping[field.name] = {"waveform": waveform_name(value), **to_mapping(value, units=CHANNEL_UNITS[field.name])}
        elif isinstance(value, Until):
            mapping[field.name] = to_mapping(value)
        elif value != field.default:
            mapping[yaml_key(field)[0]] = value
    return yaml.safe_dump(mapping, sort_keys=False, allow_unicode=True, width=120)


def _build_experiment(mapping: dict[str, Any], where: str, folder: Path | None) -> Experiment:
    if "test" in mapping:
        raise InputError(f"{where}: is a damper test, which may have several experiments; expected one; run it by `bench`")
    waveforms = {
        channel: _build_waveform(mapping[channel], channel, f"{where}: {channel}", folder)
        for channel in CHANNEL_UNITS
        if channel in mapping
    }
    return from_mapping(Experiment, {**mapping, **waveforms}, where)


def _build_waveform(mapping: Any, channel: str, where: str, folder: Path | None) -> Waveform:
    if not isinstance(mapping, Mapping) or "waveform" not in mapping:
        raise InputError(f"{where}: expected a mapping with the key waveform and the waveform's parameters")
    try:
        cls = waveform_type(mapping["waveform"])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    parameters = {key: value for key, value in mapping.items() if key != "waveform"}
    waveform = from_mapping(cls, parameters, where, units=CHANNEL_UNITS[channel])
    try:
        return waveform.resolved(folder, _TRACE_COLUMNS[channel])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
