"""Units and scales of channels, as files that describe themselves tell them: in attributes, or beside the channels."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrd_runs.importing.table import Column
from mrd_runs.importing.units import looks_like_unit

_SCALING = re.compile(r"scal|gain|offset|slope|factor|intercept|calib|multipl|sensitiv|coeff|polynom", re.IGNORECASE)
_UNIT = re.compile(
    r"(phys\w*[\s_]?|ni_)?(unit|units|einheit|unit_?string|unit_?description|uom|unite|unidad|unita)", re.IGNORECASE
)
_NAMES = re.compile(r"name|column|channel|label|field|head|item|signal|variable", re.IGNORECASE)


def text_of(value: object) -> str:
    """Return an attribute as text; "" where it is none."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, bytes):
        return value.decode(errors="replace").strip("\0 ")
    return value.strip() if isinstance(value, str) else ""


def unit_attribute(attributes: Mapping[str, Any]) -> str:
    """Return the unit that attributes name; "" without one."""
    units = (text_of(value) for name, value in attributes.items() if _UNIT.fullmatch(name))
    remarks = (text_of(value) for name, value in attributes.items() if name.lower() in ("description", "comment"))
    return re.sub(r"\s+since\s.*", "", next(filter(None, units), "") or next(filter(looks_like_unit, remarks), ""))


def texts_of(value: object) -> list[str]:
    """Return the texts of a list or array of nothing else; empty for anything else."""
    items = list(np.ravel(np.asarray(value, object))) if isinstance(value, np.ndarray | list | tuple) else []
    texts = [text_of(item) for item in items]
    return texts if all(texts) else []


def listed_names(texts: Mapping[str, list[str]], count: int) -> tuple[list[str], list[str]]:
    """Return names and units of the columns of a matrix, where lists beside it tell them; "" where they do not.

    Parameters
    ----------
    texts : mapping of str to list of str
        Lists by what they are called.
    count : int
        Number of columns.
    """
    names, units = [""] * count, [""] * count
    for key, found in texts.items():
        if count < 2 or len(found) != count:
            continue
        if _UNIT.fullmatch(key):
            units = found
        elif _NAMES.search(key) and len(set(found)) == count:
            names = found
    return names, units


def with_facts_beside(columns: Sequence[Column], facts: Iterable[tuple[str, str]]) -> tuple[tuple[Column, ...], list[str]]:
    """Return columns with what single texts and numbers beside them say, such as ``force_unit`` and ``force_scale``.

    Parameters
    ----------
    columns : sequence of Column
    facts : iterable of (str, str)
        Names and values of what stands beside the columns.

    Returns
    -------
    columns : tuple of Column
        Without those that are a unit of others.
    remarks : list of str
        On scales that may be meant for any of them.
    """
    described = {column.name: column for column in columns}
    remarks = []
    for name, value in facts:
        problem = scaling_problem({name: value})
        is_of = [(column, rest) for column in columns if (rest := _rest_of(name, column.name)) and not column.text]
        for column, rest in is_of:
            if _UNIT.fullmatch(rest) and not column.unit and value:
                described[column.name] = replace(described[column.name], unit=value)
                described.pop(name, None)
            elif problem and _SCALING.search(rest):
                described[column.name] = replace(described[column.name], problem=problem)
        if problem and not is_of:
            remarks.append(f"{name} = {value} is not applied; where it is meant for a channel, say so with --units")
    return tuple(described.values()), remarks


def _rest_of(name: str, channel: str) -> str:
    """Return what a name has before or after that of a channel, as ``unit`` of ``force_unit``; "" where it has another."""
    own, of = (re.split(r"[./]", text)[-1].lower() for text in (name, channel))
    rest = own.removeprefix(of) if own.startswith(of) else own.removesuffix(of) if own.endswith(of) else ""
    return rest.strip("_- ")


def scaling_problem(attributes: Mapping[str, Any], known: tuple[str, ...] = ()) -> str:
    """Return what attributes say of a scale that nobody applies; "" where they say nothing, or that it is neutral.

    Parameters
    ----------
    attributes : mapping
        Of a channel.
    known : tuple of str
        Names of attributes that are applied, or mean something else.
    """
    for name, value in attributes.items():
        if name in known or not _SCALING.search(name) or name.lower().startswith(("ni_", "matlab_")):
            continue
        try:
            numbers = np.atleast_1d(np.asarray(value, np.float64))
        except (TypeError, ValueError):
            continue
        is_sum = re.search(r"offset|intercept", name, re.IGNORECASE)
        if numbers.size and not np.all(numbers == (0.0 if is_sum else 1.0)):
            shown = ", ".join(f"{number:g}" for number in numbers[:4])
            return f"has the attribute {name} = {shown}, which is not applied because nothing tells how"
    return ""
