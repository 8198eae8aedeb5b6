"""Limits for the numbers of a characterisation: read from a file, or made of a golden damper and a tolerance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from mrd_base import InputError
from mrd_base.config import from_mapping, quantity, read_yaml, unknown_key
from mrd_characterisation.characterisation import QUANTITIES, Direction, Value

COMPARED = (
    "gas_force",
    "seal_drag",
    "response_time_63",
    "response_time_95",
    "dynamic_range",
    "energy_per_cycle",
    "peak_force",
    "force_at_speed",
)
"""What is compared with a golden damper, in the order in which it is listed: what is of the whole damper first.

The others follow from these, are small differences of which a tolerance in per cent says nothing (asymmetry, width of the
hysteresis, gas stiffness), or belong to the bench (stroke, temperature, current)."""

_OF_THE_DAMPER = ("gas_force", "seal_drag")  # hardly depend on how slow the slow strokes were

ZERO_CELSIUS = 273.15
"""K."""

# Units of the keys of a file of limits, by SI unit. Without an entry, they are the same.
_FILE_UNITS = {"s": "ms", "m": "mm", "K": "degC"}


@dataclass(frozen=True)
class Limit:
    """A band for one number, with the conditions under which it holds; a condition that is None holds for all.

    Attributes
    ----------
    quantity : str
        One of `QUANTITIES`.
    lower, upper : float
        In SI units; infinite where the band is open. A force of a direction counts as `resisting` the motion.
    current, current_before : float or None
        A; those after and before the step for a response time.
    direction : str or None
        "rebound" or "compression".
    speed, stroke : float or None
        m/s, positive in both directions; m.

    Raises
    ------
    InputError
        For a band without limit, and where the lower limit is not below the upper one.
    """

    quantity: str
    lower: float = -math.inf
    upper: float = math.inf
    current: float | None = None
    current_before: float | None = None
    direction: Direction | None = None
    speed: float | None = None
    stroke: float | None = None

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise InputError(
                f"{self.quantity}: lower {self.lower:.6g} is not below upper {self.upper:.6g}, expected lower < upper"
            )

    @property
    def unit(self) -> str:
        """SI unit of the limits; empty for a pure number."""
        return QUANTITIES[self.quantity].unit


def resisting(value: Value) -> Value:
    """Return a force of a direction as it resists the motion, positive in both directions; other values as they are.

    In the signs of the bench, a force that resists compression is negative.
    """
    if value.direction != "compression" or not QUANTITIES[value.quantity].force:
        return value
    return replace(value, value=-value.value, lower=-value.upper, upper=-value.lower)


def golden_limits(golden: Sequence[Value], tolerance: float) -> tuple[Limit, ...]:
    """Return a band around each value of a golden damper that is `COMPARED`.

    Parameters
    ----------
    golden : sequence of Value
        A value is left out where each run has a single cycle or step: another run like them would have no interval.
    tolerance : float
        By how much a damper may differ from the golden one, over the golden value; at least as much as this scatters over
        its cycles and runs. It counts from the ends of the golden value's interval, anywhere in which the golden damper may
        be.

    Raises
    ------
    InputError
        For a tolerance that is not positive, and where nothing of the golden damper can be compared.
    """
    if not 0.0 < tolerance < math.inf:
        raise InputError(f"--tolerance is {100 * tolerance:g}, expected a positive number of per cent")
    limits = []
    compared = [
        value
        for value in golden
        if value.quantity in COMPARED and value.cycles > value.runs and math.isfinite(value.upper - value.lower)
    ]
    for value in map(resisting, sorted(compared, key=lambda value: COMPARED.index(value.quantity))):
        margin = max(tolerance * abs(value.value), value.scatter)
        if margin > 0.0:
            names = () if value.quantity in _OF_THE_DAMPER else ("current", "current_before", "direction", "speed", "stroke")
            conditions = {name: getattr(value, name) for name in names}
            limits.append(Limit(value.quantity, value.lower - margin, value.upper + margin, **conditions))
    if not limits:
        raise InputError(f"the golden damper has no number to compare with, expected one of {', '.join(COMPARED)}")
    return tuple(limits)


@dataclass(frozen=True)
class _Entry:
    """A band as a file states it, by its ends or around a nominal value; the unit "value" is that of the quantity."""

    lower: float | None = quantity(None, "value", "lower limit")
    upper: float | None = quantity(None, "value", "upper limit")
    nominal: float | None = quantity(None, "value", "middle of the band")
    tolerance: float | None = quantity(None, "difference", "half the width of the band", lower=0.0)
    tolerance_percent: float | None = quantity(None, "", "half the width of the band, of the nominal value", lower=0.0)
    current: float | None = quantity(None, "mA", "coil current; that after a step for a response time")
    current_before: float | None = quantity(None, "mA", "coil current before a step")
    direction: str | None = quantity(None, "", "rebound or compression; both by default")
    speed: float | None = quantity(None, "mm/s", "positive in both directions", lower=0.0)
    stroke: float | None = quantity(None, "mm", "length of a stroke", lower=0.0)

    def __post_init__(self) -> None:
        if self.direction not in (None, "rebound", "compression"):
            raise InputError(f"direction is {self.direction}, expected rebound or compression")
        by_ends = self.lower is not None or self.upper is not None
        tolerances = [tolerance for tolerance in (self.tolerance, self.tolerance_percent) if tolerance is not None]
        if by_ends == (self.nominal is not None) or len(tolerances) != (not by_ends):
            raise InputError("expected lower, upper or both; or nominal with tolerance or tolerance_percent")

    def limit(self, name: str) -> Limit:
        """Return the limit for a quantity in SI units."""
        zero = ZERO_CELSIUS if QUANTITIES[name].unit == "K" else 0.0
        if self.nominal is None:
            lower = -math.inf if self.lower is None else self.lower + zero
            upper = math.inf if self.upper is None else self.upper + zero
        else:
            percent = self.tolerance_percent
            half = self.tolerance if percent is None else 0.01 * percent * abs(self.nominal)
            lower, upper = self.nominal + zero - cast(float, half), self.nominal + zero + cast(float, half)
        direction = cast("Direction | None", self.direction)
        return Limit(name, lower, upper, self.current, self.current_before, direction, self.speed, self.stroke)


def read_limits(path: str | Path) -> tuple[Limit, ...]:
    """Read a file of limits: a mapping from the names of quantities to lists of bands with their conditions.

    Parameters
    ----------
    path : path
        A YAML file as ``config/acceptance/rd_8040_1.yaml``. Each key names its unit.

    Raises
    ------
    InputError
        For an unknown quantity or key, a band without limits, a lower limit that is not below the upper one.
    """
    limits = []
    for name, entries in read_yaml(path).items():
        if name not in QUANTITIES:
            raise InputError(f"{path}: unknown key {unknown_key(name, QUANTITIES)}")
        if not isinstance(entries, list) or not entries:
            raise InputError(
                f"{path}: {name}: expected a list of bands, each a mapping such as {{lower: 1, upper: 2}} with units"
            )
        limits += [_read_limit(name, entry, f"{path}: {name}[{place}]") for place, entry in enumerate(entries)]
    return tuple(limits)


def _read_limit(name: str, entry: Any, where: str) -> Limit:
    unit = QUANTITIES[name].unit
    unit = _FILE_UNITS.get(unit, unit)
    read = from_mapping(_Entry, entry, where, units={"value": unit, "difference": "degC" if unit == "degC" else unit})
    try:
        return read.limit(name)
    except InputError as error:
        raise InputError(f"{where}: {str(error).removeprefix(f'{name}: ')}") from None
