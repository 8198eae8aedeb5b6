"""Base of the waveforms: frozen dataclasses that return their shape over time, in levels."""

import abc
import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrd_base import quantity
from mrd_trajectory.limits import LARGEST_CURRENT

Array = NDArray[np.float64]

# YAML units of the symbolic units of waveforms, for each channel.
CHANNEL_UNITS: Mapping[str, Mapping[str, str]] = {
    "rod": {"level": "mm", "level/s": "mm/s"},
    "coil": {"level": "mA", "level/s": "mA/s"},
}


@dataclass(frozen=True)
class Smooth:
    """A smooth level with its first and second time derivatives.

    Attributes
    ----------
    motion : callable
        Returns level, level/s and level/s² (n,) at times (n,) in s.
    highest_frequency : float
        Highest frequency in Hz, which sets how densely the shape is tabulated.
    """

    motion: Callable[[Array], tuple[Array, Array, Array]]
    highest_frequency: float


@dataclass(frozen=True)
class Corners:
    """Straight lines between vertices; the path of a rod has rounded corners."""

    times: Array
    levels: Array


@dataclass(frozen=True)
class Holds:
    """Constant levels, each from its time on; a rod moves between them as fast as the limits allow."""

    times: Array
    levels: Array


@dataclass(frozen=True)
class Samples:
    """Recorded points; a rod follows the spline through them, a coil follows straight lines between them."""

    times: Array
    levels: Array


Shape = Smooth | Corners | Holds | Samples


class Waveform(abc.ABC):
    """Base of the waveforms: frozen dataclasses of `mrd_base.quantity` fields.

    The unit ``"level"`` is mm for the rod and mA for the coil (``"level/s"`` accordingly); attributes are in SI units.
    Levels are proportional to all fields of that unit, or to the field ``scale`` where there is one. The remedies in error
    messages rely on this.
    """

    @abc.abstractmethod
    def shape(self, duration: float) -> Shape:
        """Return the shape from time 0 to at least ``duration`` s; it depends on the fields only."""

    def resolved(self, folder: Path | None, column: str) -> Self:
        """Return the waveform with its file in ``folder``, and with ``column`` where it names no column of the file."""
        return self


def level_field(doc: str, default: Any = dataclasses.MISSING, *, lower: float = -LARGEST_CURRENT) -> Any:
    """Declare a field in levels, bounded in m or A so that no arithmetic overflows; `plan` checks the limits."""
    return quantity(default, "level", doc, lower=lower, upper=LARGEST_CURRENT)


def slope_field(doc: str) -> Any:
    """Declare a field in levels per second."""
    return quantity(unit="level/s", doc=doc, lower=1e-7, upper=1e3)


def repeat_pattern(vertices: ArrayLike, levels: ArrayLike, period: float, duration: float) -> tuple[Array, Array]:
    """Return times and levels of a pattern that repeats every ``period`` s until ``duration`` is covered."""
    count = int(np.ceil(duration / period - 1e-9)) + 1
    times = np.arange(count)[:, None] * period + np.asarray(vertices, dtype=float)
    return times.ravel(), np.tile(np.asarray(levels, dtype=float), count)


def fields_in(waveform: Waveform, unit: str) -> list["dataclasses.Field[object]"]:
    """Return the fields of a waveform with a unit; a field ``scale`` counts as a level."""
    fields = dataclasses.fields(waveform)  # type: ignore[arg-type]
    return [field for field in fields if field.metadata.get("unit") == unit or (unit == "level" and field.name == "scale")]
