"""Configuration: YAML in the units people write, frozen dataclasses in SI.

A field made with `quantity` knows its YAML unit, its bounds and its meaning. The YAML key is the field's name with the
unit (``stroke_mm``), the attribute is SI (``stroke``, in m). Unknown keys, wrong types and values out of bounds are refused
with one line. The same declarations become ROS parameters (`mrd_base.nodes`) and tables in the documentation.
"""

import dataclasses
import difflib
import math
import re
import sys
import types
import typing
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from mrd_base.clock import FASTEST, SLOWEST
from mrd_base.errors import InputError

T = TypeVar("T")

_SI: dict[str, tuple[str, float]] = {
    # YAML unit: (suffix of the key, factor to SI)
    "": ("", 1.0),
    "m": ("_m", 1.0),
    "mm": ("_mm", 1e-3),
    "mm/s": ("_mm_per_s", 1e-3),
    "m/s2": ("_m_per_s2", 1.0),
    "m/s3": ("_m_per_s3", 1.0),
    "s": ("_s", 1.0),
    "ms": ("_ms", 1e-3),
    "Hz": ("_hz", 1.0),
    "N": ("_N", 1.0),
    "N/A": ("_N_per_A", 1.0),
    "N s/m": ("_N_s_per_m", 1.0),
    "N s/m/A": ("_N_s_per_m_per_A", 1.0),
    "A": ("_A", 1.0),
    "mA": ("_mA", 1e-3),
    "mA/s": ("_mA_per_s", 1e-3),
    "V": ("_V", 1.0),
    "kg": ("_kg", 1.0),
    "degC": ("_degC", 1.0),
    "ohm": ("_ohm", 1.0),
    "mH": ("_mH", 1e-3),
    "A/V": ("_A_per_V", 1.0),
    "mV/V": ("_mV_per_V", 1e-3),
    "mV/A": ("_mV_per_A", 1e-3),
    "mV/g": ("_mV_per_g", 1e-3 / 9.80665),
}


def quantity(
    default: Any = dataclasses.MISSING, unit: str = "", doc: str = "", *, lower: float = -math.inf, upper: float = math.inf
) -> Any:
    """Declare a dataclass field: its default in SI, the unit of its YAML key, its meaning, its bounds in SI.

    ``unit`` is a key of the table above, or a word (``"level"``) that the reader of the YAML resolves through ``units`` of
    `from_mapping`. Bounds are inclusive.
    """
    return dataclasses.field(default=default, metadata={"unit": unit, "doc": doc, "lower": lower, "upper": upper})


def bench_time_scale() -> Any:
    """Declare the field ``time_scale`` that every node has."""
    return quantity(1.0, doc="bench seconds per wall second", lower=SLOWEST, upper=FASTEST)


def key_of(field: dataclasses.Field[Any], units: Mapping[str, str] | None = None) -> tuple[str, float]:
    """YAML key of a field and the factor from its unit to SI."""
    unit = field.metadata.get("unit", "")
    suffix, factor = _SI[(units or {}).get(unit, unit)]
    return field.name + suffix, factor


class _Loader(yaml.SafeLoader):
    """Safe YAML with the floats of YAML 1.2 (``1e3``, which PyYAML takes for text), and no key twice in a mapping."""

    # Where mappings are composed, not where they are built: there, merge keys have put more into them already.
    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        first: dict[tuple[str, str], yaml.Mark] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            known = first.setdefault((key.tag, key.value), key.start_mark)
            if known is not key.start_mark:
                problem = f"the key {key.value} is there twice, first in line {known.line + 1}; remove one"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
        return node


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"), list("-+.0123456789")
)


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises
    ------
    InputError
        When there is no such file, it is no YAML, or it holds no mapping.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """Parse YAML text that holds a mapping; ``where`` names it in errors."""
    try:
        content = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: e.g. a date that does not exist
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
    """Keys under which a ROS parameter file speaks to a node; what a later one says goes before."""
    return "/**", f"/**/{node}", f"/{node}", node


def read_node_parameters(path: str | Path, node: str) -> dict[str, Any]:
    """Read what a ROS parameter file says to one node, as nested mapping.

    Entries under ``/**`` count for every node, those under ``/**/NODE`` (or ``NODE``, ``/NODE``) go before them
    (`node_patterns`).

    Raises
    ------
    InputError
        As `read_yaml`; also when the file is no ROS parameter file.
    """
    merged: dict[str, Any] = {}
    content = read_yaml(path)
    if not any(isinstance(entry, dict) and "ros__parameters" in entry for entry in content.values()):
        found = ", ".join(map(str, list(content)[:3])) + (", ..." if len(content) > 3 else "")
        raise InputError(f"{path}: found {found}, expected a parameter file (`/**: ros__parameters:` with names and values)")
    for pattern in node_patterns(node):
        if pattern not in content:
            continue
        entry = content[pattern]
        if not isinstance(entry, dict) or not isinstance(entry.get("ros__parameters"), dict):
            raise InputError(f"{path}: {pattern} holds no ros__parameters mapping")
        merged = _merge(merged, entry["ros__parameters"])
    return merged


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Key by key, as ROS does: a section of ``above`` leaves the other keys of that section as they are."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(below.get(key), dict)
        merged[key] = _merge(below[key], value) if both else value
    return merged


def unknown_key(key: object, known: Collection[str]) -> str:
    """What to say of a key that is not known: the nearest one, and all."""
    near = difflib.get_close_matches(str(key), known, 1)
    hint = f"; did you mean {near[0]}?" if near else ""
    return f"{key}{hint} (known: {', '.join(known)})"


def from_mapping(cls: type[T], mapping: Any, where: str, *, units: Mapping[str, str] | None = None) -> T:
    """Build a frozen dataclass from a YAML mapping.

    Parameters
    ----------
    cls : dataclass type
        Fields declared with `quantity`; nested dataclasses are nested mappings.
    mapping : mapping
        What the YAML holds.
    where : str
        Prefix of error messages, e.g. ``"demo.yaml: rod"``.
    units : mapping, optional
        What a symbolic unit means here, e.g. ``{"level": "mm"}``.

    Raises
    ------
    InputError
        For an unknown or missing key, a wrong type, a value out of bounds.
    """
    if not isinstance(mapping, Mapping):
        raise InputError(f"{where}: found {_show(mapping)}, expected a mapping of names to values")
    hints = typing.get_type_hints(cls)
    known = {key_of(field, units)[0]: field for field in dataclasses.fields(cls) if field.init}  # type: ignore[arg-type]
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
    """YAML mapping of a dataclass; `from_mapping` reads it back."""
    mapping: dict[str, Any] = {}
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        if value is None:
            continue
        key, factor = key_of(field, units)
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
    # 15 digits undo the rounding of the product: 8.399 mm are 0.008399 m, as if written so, and back.
    return value if factor == 1 else float(f"{value * factor:.15g}")


def _meaning(field: dataclasses.Field[Any]) -> str:
    doc = field.metadata.get("doc")
    return f" ({doc})" if doc else ""


def _show(value: Any) -> str:
    return f"{type(value).__name__} {value!r}" if value is not None else "nothing"


def _convert(hint: Any, value: Any, where: str, field: dataclasses.Field[Any], units: Mapping[str, str] | None) -> Any:
    origin = typing.get_origin(hint)
    if origin in (types.UnionType, typing.Union):  # Optional[...]
        if value is None:
            return None
        (hint,) = [arm for arm in typing.get_args(hint) if arm is not type(None)]
        origin = typing.get_origin(hint)
    if dataclasses.is_dataclass(hint):
        return from_mapping(typing.cast(type, hint), value, where, units=units)
    if origin is tuple:
        if not isinstance(value, list | tuple) or not value:
            raise InputError(f"{where}: found {_show(value)}, expected a list of at least one{_meaning(field)}")
        item = typing.get_args(hint)[0]
        return tuple(_convert(item, entry, f"{where}[{i}]", field, units) for i, entry in enumerate(value))
    if hint is float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
            raise InputError(f"{where}: found {_show(value)}, expected a finite number{_meaning(field)}")
        _, factor = key_of(field, units)
        return _bounded(_scaled(float(value), factor), where, field, factor)
    if hint is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"{where}: found {_show(value)}, expected a whole number{_meaning(field)}")
        return _bounded(value, where, field, 1)
    if not isinstance(value, hint):
        raise InputError(f"{where}: found {_show(value)}, expected {hint.__name__}{_meaning(field)}")
    return value


def _bounded(value: Any, where: str, field: dataclasses.Field[Any], factor: float) -> Any:
    lower, upper = field.metadata.get("lower", -math.inf), field.metadata.get("upper", math.inf)
    if not lower <= value <= upper:
        found = value if isinstance(value, int) else f"{value / factor:.9g}"
        raise InputError(f"{where}: found {found}, expected {lower / factor:g} to {upper / factor:g}{_meaning(field)}")
    return value
