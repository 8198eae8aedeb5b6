"""What a waveform is: a frozen dataclass that says its shape over time, in levels."""

import abc
import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrd_base import quantity

Array = NDArray[np.float64]

# What a level is in the YAML of either channel.
UNITS: Mapping[str, Mapping[str, str]] = {
    "rod": {"level": "mm", "level/s": "mm/s"},
    "coil": {"level": "mA", "level/s": "mA/s"},
}


@dataclass(frozen=True)
class Smooth:
    """A level with its first and second time derivative.

    Attributes
    ----------
    motion : callable
        Times (n,) in s to three arrays (n,): level, level/s, level/s².
    highest_frequency : float
        Hz, of the fastest part; sets how finely the shape is tabulated.
    """

    motion: Callable[[Array], tuple[Array, Array, Array]]
    highest_frequency: float


@dataclass(frozen=True)
class Corners:
    """Straight lines between vertices; a rod rounds the corners."""

    times: Array
    levels: Array


@dataclass(frozen=True)
class Holds:
    """Each level holds from its time on; a rod moves from one to the next as fast as the limits allow."""

    times: Array
    levels: Array


@dataclass(frozen=True)
class Samples:
    """Recorded points; a rod follows the spline through them, a coil the straight lines between them."""

    times: Array
    levels: Array


Shape = Smooth | Corners | Holds | Samples


class Waveform(abc.ABC):
    """Base of the waveforms: frozen dataclasses of `mrd_base.quantity` fields.

    The unit ``"level"`` is mm for the rod and mA for the coil (``"level/s"`` likewise), SI inside. Levels scale
    linearly with all fields of that unit, or with the field named ``scale`` where there is one: the remedies in error
    messages rely on it.
    """

    @abc.abstractmethod
    def shape(self, duration: float) -> Shape:
        """Shape over the times 0 to at least ``duration`` s; the same for the same fields."""

    def placed(self, folder: Path | None, column: str) -> Self:
        """Resolve what the fields refer to: files lie in ``folder``, the channel is ``column`` in a CSV."""
        return self


def level_field(doc: str, default: Any = dataclasses.MISSING, *, lower: float = -10.0) -> Any:
    """Declare a field in levels: within 10 m or 10 A, so that no arithmetic overflows; the bench's limits come later."""
    return quantity(default, "level", doc, lower=lower, upper=10.0)


def slope_field(doc: str) -> Any:
    """Declare a field in levels per second."""
    return quantity(unit="level/s", doc=doc, lower=1e-7, upper=1e3)


def repeated(vertices: ArrayLike, levels: ArrayLike, period: float, duration: float) -> tuple[Array, Array]:
    """Times and levels of a pattern that repeats every ``period`` until ``duration`` is covered."""
    count = int(np.ceil(duration / period - 1e-9)) + 1
    times = np.arange(count)[:, None] * period + np.asarray(vertices, dtype=float)
    return times.ravel(), np.tile(np.asarray(levels, dtype=float), count)


def fields_in(waveform: Waveform, unit: str) -> list["dataclasses.Field[object]"]:
    """Fields of a waveform that have a unit; the levels of a waveform with a ``scale`` are that field."""
    fields = dataclasses.fields(waveform)  # type: ignore[arg-type]
    return [field for field in fields if field.metadata.get("unit") == unit or (unit == "level" and field.name == "scale")]
