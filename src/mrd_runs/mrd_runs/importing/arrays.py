"""Columns among named arrays of any shape, as MATLAB and HDF5 files hold them."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from mrd_runs.importing.attributes import scaling_problem, texts_of

_VALUES = ("values", "Values", "data", "Data", "value", "y")
_LABELS = ("label", "Label", "Name", "name", "signalName")
_UNITS = ("unit", "units", "Unit", "Units")
_TIMES = ("time", "Time", "t")
_DESCRIPTIONS = ("DataInfo", "dimensions", "plotStyle", "title", "blockName", "valueDimensions")
_MOST_COLUMNS = 64  # of a matrix; a larger one is an image or a parameter field
FEWEST_ROWS = 3


def columns_of(name: str, shape: tuple[int, ...]) -> Iterator[tuple[str, tuple[int | slice, ...]]]:
    """Yield name and index of each column of an array: all of a vector, or each short side of a matrix.

    Parameters
    ----------
    name : str
    shape : tuple of int
        A matrix has its samples along the longer side.
    """
    sides = [axis for axis, length in enumerate(shape) if length > 1]
    if len(sides) == 1 and shape[sides[0]] >= FEWEST_ROWS:
        yield name, tuple(slice(None) if axis == sides[0] else 0 for axis in range(len(shape)))
    elif len(sides) == 2 and min(shape[axis] for axis in sides) <= _MOST_COLUMNS:
        long, short = sorted(sides, key=lambda axis: -shape[axis])
        for number in range(shape[short]):
            index: dict[int, int | slice] = {long: slice(None), short: number}
            yield f"{name}({number + 1})", tuple(index.get(axis, 0) for axis in range(len(shape)))


class Leaf(NamedTuple):
    """Values in nested structures, with what stands beside them.

    Attributes
    ----------
    values : any
    unit, time : str
        Unit, and name of the times; "" without.
    lists : mapping of str to list of str
        Lists of texts, which may name the columns of a matrix and their units.
    problem : str
        What of it is not understood.
    """

    values: Any
    unit: str = ""
    time: str = ""
    lists: Mapping[str, list[str]] = MappingProxyType({})
    problem: str = ""


def leaves_of(content: object, name: str = "") -> Iterator[tuple[str, Leaf]]:
    """Yield the leaves of nested mappings and lists with their dotted names.

    A structure that holds the values of one signal beside its label or unit, as those of Simulink and of time series do, is
    called by the label or by its own name. Structures of one sample each become columns.
    """
    if isinstance(content, Mapping):
        signal = next((key for key in _VALUES if isinstance(content.get(key), np.ndarray)), None)
        unit = _unit_beside(content) if signal else ""
        label = next((content[key] for key in _LABELS if isinstance(content.get(key), str) and content[key]), "")
        size = np.size(content[signal]) if signal else 0
        times = next((key for key in _TIMES if size and np.size(content.get(key, 0)) == size), "")
        problem = (
            scaling_problem({key: value for key, value in content.items() if np.ndim(value) == 0}) if signal and name else ""
        )
        lists = {str(key): texts for key, value in content.items() if (texts := texts_of(value))}
        units = _units_of_fields(content, lists)
        for key, value in content.items():
            own = f"{name}.{key}" if name else str(key)
            if key == signal and (unit or label or times or key == "values"):
                parent, _, last = name.rpartition(".")
                shown = label or last
                yield (
                    (f"{parent}.{shown}" if parent else shown or key),
                    Leaf(value, unit, f"{name}.{times}" if times and name else times, lists, problem),
                )
            elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
                yield own, Leaf(value, units.get(key, ""), lists=lists, problem=problem if key == signal else "")
            elif not (signal and key in (*_LABELS, *_UNITS, *_DESCRIPTIONS)) and not (key in _UNITS and units):
                yield from leaves_of(value, own)
    elif isinstance(content, list | np.ndarray) and len(content) and all(isinstance(item, Mapping) for item in content):
        samples = _as_columns(content)
        if samples:
            yield from leaves_of(samples, name)
        else:
            for number, item in enumerate(content, 1):
                is_signal = any(key in item for key in _VALUES)
                yield from leaves_of(item, name if is_signal and _has_label(item) else f"{name}({number})")
    else:
        yield name, Leaf(content)


def _units_of_fields(content: Mapping[str, Any], lists: Mapping[str, list[str]]) -> dict[str, str]:
    """Return the units of fields of a structure, where a field of units has them by the names of these or in their order."""
    vectors = [str(key) for key, value in content.items() if isinstance(value, np.ndarray) and value.dtype.kind in "fiu"]
    for key in _UNITS:
        if isinstance(content.get(key), Mapping):
            return {name: str(unit) for name, unit in content[key].items() if name in vectors and isinstance(unit, str)}
        if len(lists.get(key, ())) == len(vectors) > 1:
            return dict(zip(vectors, lists[key], strict=True))
    return {}


def _has_label(item: Mapping[str, Any]) -> bool:
    return any(isinstance(item.get(key), str) and item[key] for key in _LABELS)


def _unit_beside(content: Mapping[str, Any]) -> str:
    places = (content, *(content[key] for key in _DESCRIPTIONS if isinstance(content.get(key), Mapping)))
    units = (place.get(key) for place in places for key in _UNITS)
    return next((unit for unit in units if isinstance(unit, str) and unit), "")


def _as_columns(content: Any) -> dict[str, Any]:
    """Return structures of one sample each as columns; empty where they are no such structures."""
    keys = list(content[0])
    if len(content) < FEWEST_ROWS or any(list(item) != keys for item in content):
        return {}
    if any(isinstance(value, np.ndarray | list | Mapping) and len(value) for value in content[0].values()):
        return {}  # signals, each with its values
    numbers = [key for key in keys if all(isinstance(item[key], int | float | np.number) for item in content)]
    return {key: np.array([item[key] for item in content], np.float64) for key in numbers}
