"""Columns among named arrays of any shape, as MATLAB and HDF5 files hold them."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

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
    """Values in nested structures, with the unit and the name of the times that stand beside them; "" without."""

    values: Any
    unit: str = ""
    time: str = ""


def leaves_of(content: object, name: str = "") -> Iterator[tuple[str, Leaf]]:
    """Yield the leaves of nested mappings and lists with their dotted names.

    A structure that holds the values of one signal beside its label or unit, as those of Simulink and of time series do, is
    called by the label or by its own name. Structures of one sample each become columns.
    """
    if isinstance(content, Mapping):
        signal = next((key for key in _VALUES if isinstance(content.get(key), np.ndarray)), None)
        unit = _unit_beside(content) if signal else ""
        label = next((content[key] for key in _LABELS if isinstance(content.get(key), str) and content[key]), "")
        times = next((key for key in _TIMES if signal and np.size(content.get(key, 0)) == len(content[signal])), "")
        for key, value in content.items():
            if key == signal and (unit or label or times or key == "values"):
                parent, _, own = name.rpartition(".")
                shown = label or own
                yield (
                    (f"{parent}.{shown}" if parent else shown or key),
                    Leaf(value, unit, f"{name}.{times}" if times and name else times),
                )
            elif not (signal and key in (*_LABELS, *_UNITS, *_DESCRIPTIONS)):
                yield from leaves_of(value, f"{name}.{key}" if name else str(key))
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
    numbers = [key for key in keys if all(isinstance(item[key], int | float | np.number) for item in content)]
    return {key: np.array([item[key] for item in content], np.float64) for key in numbers}
