"""The form of an experiment, made from the catalogue of waveforms, and its preview against the limits."""

import dataclasses
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mrd_base import InputError
from mrd_base.config import yaml_key
from mrd_trajectory.damper_tests import DamperTest
from mrd_trajectory.damper_tests.warm_up import WarmUp
from mrd_trajectory.experiment import Experiment, format_experiment, parse_experiment
from mrd_trajectory.plan import Peak, plan
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.steps import experiments_of, is_damper_test, read_step
from mrd_trajectory.waveforms import CHANNEL_UNITS, waveform_type

MOST_POINTS = 1000
"""Points of each curve of a preview."""


@dataclass(frozen=True)
class FormField:
    """A field of the form.

    Attributes
    ----------
    key, doc : str
        The key in the experiment's file, and its meaning.
    default : str
        As text; "" if it is required.
    is_list : bool
        Whether it takes several values, with commas between.
    """

    key: str
    doc: str
    default: str
    is_list: bool = False


@dataclass(frozen=True)
class Preview:
    """An experiment that keeps the limits.

    Attributes
    ----------
    experiment : Experiment
    text : str
        Its file.
    duration : float
        In s, with the ways from and to rest.
    peaks : tuple of Peak
        Largest values and their limits.
    curves : mapping of str to list of float
        ``time_s``, ``position_mm``, ``velocity_mm_per_s``, ``current_mA``.
    tests_damper : bool
        Whether it belongs to a damper test that measures something; one that warms the damper up does not.
    """

    experiment: Experiment
    text: str
    duration: float
    peaks: tuple[Peak, ...]
    curves: Mapping[str, list[float]]
    tests_damper: bool = False


def waveform_fields(channel: str, waveform: str) -> list[FormField]:
    """Return the fields of a waveform of the channel ``rod`` or ``coil``."""
    return fields_of(waveform_type(waveform), CHANNEL_UNITS[channel])


def fields_of(cls: type[Any], units: Mapping[str, str] | None = None) -> list[FormField]:
    """Return the fields of a dataclass that is declared by `mrd_base.quantity`; ``units`` as in `mrd_base.from_mapping`."""
    fields, hints = [], typing.get_type_hints(cls)
    for declared in dataclasses.fields(cls):
        key, factor = yaml_key(declared, units)
        default = "" if declared.default is dataclasses.MISSING else _text(declared.default, factor)
        is_list = typing.get_origin(hints[declared.name]) is tuple
        fields.append(FormField(key, declared.metadata["doc"], default, is_list))
    return fields


def _text(value: Any, factor: float) -> str:
    if value is None:
        return ""
    if isinstance(value, tuple):
        return ", ".join(_text(item, factor) for item in value)
    return f"{value / factor:.12g}" if isinstance(value, float) else _word(value)


def _word(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def form_of(experiment: Experiment) -> dict[str, Any]:
    """Return the entries of the form for an experiment: texts, and a mapping of texts for rod and coil."""
    mapping = yaml.safe_load(format_experiment(experiment))
    return {key: entries_of(value) if isinstance(value, dict) else str(value) for key, value in mapping.items()}


def entries_of(mapping: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of the form for the values of a mapping."""
    return {
        key: ", ".join(map(str, value)) if isinstance(value, list) else "" if value is None else _word(value)
        for key, value in mapping.items()
    }


def form_text(form: Mapping[str, Any]) -> str:
    """Return the file of the experiment that a form describes."""
    fields = [field for channel in CHANNEL_UNITS for field in waveform_fields(channel, form[channel]["waveform"])]
    return yaml.safe_dump(values_of(form, fields), sort_keys=False, allow_unicode=True)


def values_of(form: Mapping[str, Any], fields: Iterable[FormField]) -> dict[str, Any]:
    """Return the content of the file that a form describes; what is left empty keeps its default.

    A text becomes what it would be in the file: a number where it is one, a list where it has commas or where one of the
    fields takes a list.
    """
    mapping: dict[str, Any] = {}
    lists = {field.key for field in fields if field.is_list}
    for key, value in form.items():
        if isinstance(value, Mapping):
            mapping[key] = {name: _value(text, name in lists) for name, text in value.items() if str(text).strip()}
        elif str(value).strip():
            mapping[key] = str(value) if key in ("name", "description", "transition") else _value(value)
    return mapping


def _value(text: Any, is_list: bool = False) -> Any:
    words = [word.strip() for word in str(text).split(",")]
    values = [_number(word) for word in words if word]
    return values if is_list or len(words) > 1 else values[0]


def _number(word: str) -> Any:
    if word in ("true", "false"):
        return word == "true"
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


def preview(text: str, settings: GeneratorSettings) -> Preview:
    """Plan an experiment and check it against the limits; nothing moves.

    Raises
    ------
    InputError
        With one line: the field or the limit, and a remedy.
    """
    experiment = parse_experiment(text, "experiment")
    planned = plan(experiment, settings.limits, settings.force_envelope)
    time = np.linspace(0, planned.duration, min(MOST_POINTS, int(planned.duration * 1000) + 2))
    setpoints = planned.at(time)
    columns = {
        "time_s": time,
        "position_mm": 1e3 * setpoints.position,
        "velocity_mm_per_s": 1e3 * setpoints.velocity,
        "current_mA": 1e3 * setpoints.current,
    }
    curves = {name: np.round(column, 4).tolist() for name, column in columns.items()}
    return Preview(experiment, format_experiment(experiment), planned.duration, planned.peaks, curves)


def find_experiments(folder: Path) -> dict[str, Path]:
    """Return the experiment files in a folder and its folders, by the name under which the page lists them."""
    return {file.relative_to(folder).with_suffix("").as_posix(): file for file in sorted(folder.rglob("*.yaml"))}


def find_sets(experiments: Mapping[str, Path]) -> dict[str, list[Path]]:
    """Return the sets among the files that `find_experiments` found.

    First come the folders, with their files in their order, then the damper tests, which have several experiments.
    """
    sets: dict[str, list[Path]] = {}
    for name, file in experiments.items():
        if folder := name.rpartition("/")[0]:
            sets.setdefault(folder, []).append(file)
    return sets | {name: [file] for name, file in experiments.items() if is_damper_test(file)}


def preview_set(files: Sequence[Path], settings: GeneratorSettings) -> list[Preview]:
    """Plan all experiments of a set and check them against the limits.

    Raises
    ------
    InputError
        For the first file that `preview` refuses, and for a damper test that may end its set, which the queue does not.
    """
    found = []
    for file in files:
        step = read_step(file)
        if isinstance(step, DamperTest) and step.decides:
            raise InputError(
                f"{file.name}: stop_when ends a set that the tool bench runs; run it there, or leave stop_when out"
            )
        try:
            tests_damper = isinstance(step, DamperTest) and not isinstance(step, WarmUp)
            previews = [preview(format_experiment(one), settings) for one in experiments_of(step, settings)]
            found += [dataclasses.replace(one, tests_damper=tests_damper) for one in previews]
        except InputError as error:
            raise InputError(f"{file.name}: {error}") from None
    return found
