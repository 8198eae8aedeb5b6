"""Configuration: YAML files in the units that people write, frozen dataclasses in SI units.

A field that is declared by `quantity` knows its YAML unit, its bounds and its meaning. The YAML key is the name of the field
with the unit (``stroke_mm``); the attribute is in SI units (``stroke``, in m). Unknown keys, wrong types and values out of
bounds are refused by an `InputError` of one line. `mrd_base.nodes.bench_node` makes ROS parameters of the same declarations.
"""

import dataclasses
import difflib
import math
import os
import re
import sys
import types
import typing
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from mrd_base.errors import InputError
from mrd_base.text_file import read_text_file

T = TypeVar("T")

# Factor from each unit of a YAML key to SI.
_TO_SI: dict[str, float] = {
    "": 1.0,
    "percent": 1e-2,
    "m": 1.0,
    "mm": 1e-3,
    "mm/s": 1e-3,
    "m/s2": 1.0,
    "m/s3": 1.0,
    "m/s": 1.0,
    "s": 1.0,
    "ms": 1e-3,
    "Hz": 1.0,
    "N": 1.0,
    "W": 1.0,
    "J": 1.0,
    "N/A": 1.0,
    "N/m": 1.0,
    "N s/m": 1.0,
    "N s/m/A": 1.0,
    "A": 1.0,
    "mA": 1e-3,
    "mA/s": 1e-3,
    "V": 1.0,
    "kg": 1.0,
    "degC": 1.0,  # stays in degC: a factor cannot make kelvins of it
    "J/K": 1.0,
    "K/V": 1.0,
    "K": 1.0,
    "mV/K": 1e-3,
    "ohm": 1.0,
    "mH": 1e-3,
    "A/V": 1.0,
    "mV/V": 1e-3,
    "mV/A": 1e-3,
    "mV/g": 1e-3 / 9.80665,
}


def quantity(
    default: Any = dataclasses.MISSING, unit: str = "", doc: str = "", *, lower: float = -math.inf, upper: float = math.inf
) -> Any:
    """Declare a dataclass field with its meaning, its YAML unit and its bounds.

    Parameters
    ----------
    default : optional
        Default in SI units; a field without one is required.
    unit : str
        Unit of the YAML key, such as ``"mm/s"``. A symbolic unit, such as ``"level"``, is replaced by the ``units`` argument
        of `from_mapping`.
    doc : str
        Meaning of the field, shown in error messages and as description of the ROS parameter.
    lower, upper : float
        Inclusive bounds in SI units.
    """
    return dataclasses.field(default=default, metadata={"unit": unit, "doc": doc, "lower": lower, "upper": upper})


def yaml_key(field: dataclasses.Field[Any], units: Mapping[str, str] | None = None) -> tuple[str, float]:
    """Return the YAML key of a field and the factor from its unit to SI."""
    unit = field.metadata.get("unit", "")
    unit = (units or {}).get(unit, unit)
    suffix = "_" + unit.replace("Hz", "hz").replace("/", "_per_").replace(" ", "_") if unit else ""
    return field.name + suffix, _TO_SI[unit]


# Bounds of what a stranger may ask for: characters of a text, which the parser reads in three seconds; keys of a mapping.
_LONGEST_TEXT = 2**20
_MOST_KEYS = 10_000


class _Loader(yaml.SafeLoader):
    """Safe loader that reads the floats of YAML 1.2 (PyYAML takes ``1e3`` for text) and refuses duplicate keys."""

    # Duplicates are looked for here because merge keys (<<) have not been expanded yet.
    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        first: dict[tuple[str, str], yaml.Mark] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            known = first.setdefault((key.tag, key.value), key.start_mark)
            if known is not key.start_mark:
                problem = f"the key {key.value} appears twice, first in line {known.line + 1}; remove one"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
        return node

    # Merged mappings that are merged again double with every level.
    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        super().flatten_mapping(node)
        if len(node.value) > _MOST_KEYS:
            problem = f"more than {_MOST_KEYS} keys are merged"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"), list("-+.0123456789")
)


def named_path(text: str) -> Path:
    """Return the absolute path that a request names; a leading ``~`` or ``~name`` is a home folder.

    Raises
    ------
    InputError
        If no file or folder can have this name.
    """
    if "\0" in text:
        raise InputError(f"{text}: holds a null character, expected the path of a file or folder")
    return Path(os.path.expanduser(text)).absolute()  # Path.expanduser fails for a user who does not exist


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises
    ------
    InputError
        When the file does not exist, is not YAML, or does not hold a mapping.
    """
    return parse_yaml(read_text_file(Path(path), "a YAML file", 4 * _LONGEST_TEXT), str(path))


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """Parse YAML text that holds a mapping; ``where`` names the text in error messages."""
    if len(text) > _LONGEST_TEXT:
        raise InputError(f"{where}: has {len(text)} characters, expected at most {_LONGEST_TEXT}")
    try:
        content = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: for example an impossible date
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        raise InputError(f"{where}:{line} is not YAML ({problem})") from None
    if content is None:
        raise InputError(f"{where}: is empty, expected a mapping of names to values")
    if not isinstance(content, dict):
        raise InputError(f"{where}: holds {type(content).__name__}, expected a mapping of names to values")
    return content


def node_patterns(node: str) -> tuple[str, ...]:
    """Return the keys of a ROS parameter file that apply to a node; later keys take precedence."""
    return "/**", f"/**/{node}", f"/{node}", node


def read_node_parameters(path: str | Path, node: str) -> dict[str, Any]:
    """Read the parameters of one node from a ROS parameter file, as a nested mapping.

    Entries under ``/**`` apply to every node. Entries under ``/**/NODE``, ``/NODE`` or ``NODE`` take precedence
    (`node_patterns`).

    Raises
    ------
    InputError
        As `read_yaml`; also when the file is not a ROS parameter file.
    """
    merged: dict[str, Any] = {}
    content = read_yaml(path)
    if not any(isinstance(entry, dict) and "ros__parameters" in entry for entry in content.values()):
        keys = ", ".join(map(str, list(content)[:3])) + (", ..." if len(content) > 3 else "")
        raise InputError(f"{path}: found {keys}, expected a parameter file (`/**: ros__parameters:` with names and values)")
    for pattern in node_patterns(node):
        if pattern not in content:
            continue
        entry = content[pattern]
        if not isinstance(entry, dict) or not isinstance(entry.get("ros__parameters"), dict):
            raise InputError(f"{path}: {pattern} holds no ros__parameters mapping")
        merged = _merge(merged, entry["ros__parameters"])
    return merged


def check_sections(path: str | Path, nodes: Collection[str], *, others: bool = True) -> None:
    """Check the names of the nodes in a ROS parameter file.

    Parameters
    ----------
    nodes : collection of str
        Names of the nodes that exist.
    others : bool
        Whether the file may also have sections of nodes of other packages, whose names resemble none of these.

    Raises
    ------
    InputError
        As `read_yaml`; also for a section of which no node takes its parameters.
    """
    for section in read_yaml(path):
        name = str(section).rpartition("/")[2]
        similar = difflib.get_close_matches(name, nodes, 1)
        if name not in {"*", "**", *nodes} and (similar or not others):
            hint = f"; did you mean {similar[0]}?" if similar else ""
            raise InputError(f"{path}: section {section}: no node has this name{hint} (nodes: {', '.join(sorted(nodes))})")


def _merge(base: dict[str, Any], override: dict[str, Any]) -> dict[str, Any]:
    """Merge nested mappings key by key, as ROS merges parameter files."""
    merged = dict(base)
    for key, value in override.items():
        nested = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merge(base[key], value) if nested else value
    return merged


def unknown_key(key: object, known: Collection[str]) -> str:
    """Return the text about an unknown key: the key, the closest known key, and all known keys."""
    return f"{key}{closest_key(key, known)} (known: {', '.join(known)})"


def closest_key(key: object, known: Collection[str]) -> str:
    """Return the question whether the closest known key was meant; empty where none is close."""
    matches = difflib.get_close_matches(str(key), known, 1)
    return f"; did you mean {matches[0]}?" if matches else ""


def from_mapping(cls: type[T], mapping: Any, where: str, *, units: Mapping[str, str] | None = None) -> T:
    """Build a frozen dataclass from a YAML mapping.

    Parameters
    ----------
    cls : dataclass type
        Its fields are declared by `quantity`; nested dataclasses are nested mappings.
    mapping : mapping
        Content of the YAML file.
    where : str
        Prefix of error messages, such as ``"demo.yaml: rod"``.
    units : mapping, optional
        Units of the symbolic units, such as ``{"level": "mm"}``.

    Raises
    ------
    InputError
        For an unknown or missing key, a wrong type, a value out of bounds.
    """
    if not isinstance(mapping, Mapping):
        raise InputError(f"{where}: found {_describe(mapping)}, expected a mapping of names to values")
    hints = typing.get_type_hints(cls)
    known = {yaml_key(field, units)[0]: field for field in dataclasses.fields(cls) if field.init}  # type: ignore[arg-type]
    for key in mapping:
        if key not in known:
            raise InputError(f"{where}: unknown key {unknown_key(key, known)}")
    values: dict[str, Any] = {}
    for key, field in known.items():
        if key in mapping:
            values[field.name] = _convert(hints[field.name], mapping[key], f"{where}: {key}", field, units)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise InputError(f"{where}: {key} is missing{_meaning(field)}")
    try:
        return cls(**values)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def to_mapping(instance: Any, *, units: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return the YAML mapping of a dataclass; `from_mapping` reads it back."""
    mapping: dict[str, Any] = {}
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        if value is None:
            continue
        key, factor = yaml_key(field, units)
        if dataclasses.is_dataclass(value):
            mapping[key] = to_mapping(value, units=units)
        elif isinstance(value, tuple):
            mapping[key] = [_from_si(item, factor) for item in value]
        else:
            mapping[key] = _from_si(value, factor)
    return mapping


def _from_si(value: Any, factor: float) -> Any:
    return _scaled(value, 1 / factor) if isinstance(value, float) else value


def _scaled(value: float, factor: float) -> float:
    # Rounding to 15 digits makes 8.399 mm the same float as 0.008399 m, and back.
    return value if factor == 1 else float(f"{value * factor:.15g}")


def _meaning(field: dataclasses.Field[Any]) -> str:
    doc = field.metadata.get("doc")
    return f" ({doc})" if doc else ""


def _describe(value: Any) -> str:
    return f"{type(value).__name__} {value!r}" if value is not None else "nothing"


def _convert(hint: Any, value: Any, where: str, field: dataclasses.Field[Any], units: Mapping[str, str] | None) -> Any:
    origin = typing.get_origin(hint)
    if origin in (types.UnionType, typing.Union):  # an optional field
        if value is None:
            return None
        (hint,) = [option for option in typing.get_args(hint) if option is not type(None)]
        origin = typing.get_origin(hint)
    if dataclasses.is_dataclass(hint):
        return from_mapping(typing.cast(type, hint), value, where, units=units)
    if origin is tuple:
        if not isinstance(value, list | tuple) or not value:
            raise InputError(f"{where}: found {_describe(value)}, expected a list of at least one value{_meaning(field)}")
        item_type = typing.get_args(hint)[0]
        return tuple(_convert(item_type, entry, f"{where}[{i}]", field, units) for i, entry in enumerate(value))
    if hint is float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
            raise InputError(f"{where}: found {_describe(value)}, expected a finite number{_meaning(field)}")
        _, factor = yaml_key(field, units)
        return _bounded(_scaled(float(value), factor), where, field, factor)
    if hint is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"{where}: found {_describe(value)}, expected a whole number{_meaning(field)}")
        return _bounded(value, where, field, 1)
    if not isinstance(value, hint):
        raise InputError(f"{where}: found {_describe(value)}, expected {hint.__name__}{_meaning(field)}")
    return value


def _bounded(value: Any, where: str, field: dataclasses.Field[Any], factor: float) -> Any:
    lower, upper = field.metadata.get("lower", -math.inf), field.metadata.get("upper", math.inf)
    if not lower <= value <= upper:
        shown = value if isinstance(value, int) else f"{value / factor:.9g}"
        raise InputError(f"{where}: found {shown}, expected {lower / factor:g} to {upper / factor:g}{_meaning(field)}")
    return value
