"""The result of a characterisation: numbers with their intervals and definitions, curves, and what was not recorded."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.notebook import html_table, text_table
from mrd_runs import Run

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from mrd_characterisation.limits import Limit

Array = NDArray[np.float64]

Direction = Literal["rebound", "compression"]

SAME_SPEED = 0.05
"""Relative difference up to which two speeds count as the same; strokes are grouped by it."""

SAME_CURRENT = 0.02
"""Difference over the largest current up to which two currents count as the same."""


@dataclass(frozen=True)
class Value:
    """One number of a damper, with the conditions under which it holds; a condition that does not apply is None.

    Attributes
    ----------
    quantity : str
        What it is, one of `QUANTITIES`.
    value : float
        In SI units and the signs of the bench: rebound speeds and forces are positive, those of compression negative.
    lower, upper : float
        95 % interval of the value; nan where a single cycle or step gives none.
    scatter : float
        Standard deviation over cycles (or steps) and runs; nan for a single one.
    cycles, runs : int
        Number of cycles, or of strokes of a direction, or of current steps; and of the runs that they are from.
    definition : str
        What was computed of which samples, in words.
    current : float or None
        A; that after the step for a response time.
    current_before : float or None
        A, before the step.
    direction : str or None
        "rebound" (extension) or "compression".
    speed : float or None
        m/s, positive in both directions.
    stroke : float or None
        m, length of the strokes.
    position : float or None
        m.
    """

    quantity: str
    value: float
    lower: float
    upper: float
    scatter: float
    cycles: int
    runs: int
    definition: str
    current: float | None = None
    current_before: float | None = None
    direction: Direction | None = None
    speed: float | None = None
    stroke: float | None = None
    position: float | None = None

    @property
    def unit(self) -> str:
        """SI unit of the value; empty for a pure number."""
        return QUANTITIES[self.quantity].unit


@dataclass(frozen=True)
class Quantity:
    """A kind of value: its title, its SI unit, and whether it has the sign of the force of a direction."""

    title: str
    unit: str
    force: bool = False


QUANTITIES = {
    "peak_force": Quantity("peak force", "N", force=True),
    "mean_force": Quantity("mean force", "N", force=True),
    "force_at_speed": Quantity("force at speed", "N", force=True),
    "energy_per_cycle": Quantity("energy per cycle", "J"),
    "equivalent_damping": Quantity("equivalent viscous damping", "N s/m"),
    "hysteresis_width": Quantity("hysteresis width", "N"),
    "asymmetry": Quantity("asymmetry", ""),
    "dynamic_range": Quantity("dynamic range", ""),
    "response_time_63": Quantity("response time of the force, 63.2 %", "s"),
    "response_time_95": Quantity("response time of the force, 95 %", "s"),
    "current_time_63": Quantity("rise time of the current, 63.2 %", "s"),
    "current_time_95": Quantity("rise time of the current, 95 %", "s"),
    "gas_force": Quantity("gas force", "N"),
    "gas_stiffness": Quantity("gas stiffness", "N/m"),
    "seal_drag": Quantity("seal drag", "N"),
    "stroke_used": Quantity("stroke used", "m"),
    "temperature_least": Quantity("lowest temperature", "K"),
    "temperature_largest": Quantity("highest temperature", "K"),
}
"""Kinds of values by name, in the order in which they are listed."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Force over speed (CVP) of one current and direction, at the fastest strokes.

    Attributes
    ----------
    current : float
        A.
    direction : str
    speed : ndarray (n,)
        m/s, positive, increasing.
    accelerating, decelerating : ndarray (n,)
        Force in N on both branches, in the signs of the bench; nan where a branch has no samples.
    """

    current: float
    direction: Direction
    speed: Array
    accelerating: Array
    decelerating: Array

    @property
    def mean(self) -> Array:
        """Mean force in N of both branches (n,)."""
        return 0.5 * (self.accelerating + self.decelerating)


@dataclass(frozen=True, eq=False)
class Loop:
    """One recorded cycle, representative of those of its current, speed and stroke.

    Attributes
    ----------
    current, speed, stroke : float
        A, m/s, m.
    run : str
        Name of the run.
    position, velocity, force : ndarray (n,)
        Smoothed motion in m and m/s, measured force in N; the first sample again closes the loop.
    """

    current: float
    speed: float
    stroke: float
    run: str
    position: Array
    velocity: Array
    force: Array


@dataclass(frozen=True, eq=False)
class GasCurve:
    """Gas force over the stroke.

    Attributes
    ----------
    position : ndarray (n,)
        m.
    force : ndarray (n,)
        N with which the gas pushes the rod out.
    runs : tuple of str
        Names of the runs with slow strokes, from which gas force and seal drag are.
    """

    position: Array
    force: Array
    runs: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Response:
    """Mean response of force and current to equal current steps at constant speed.

    Attributes
    ----------
    current_before, current, speed : float
        A before and after the step, m/s.
    direction : str
    time : ndarray (n,)
        s from the step of the measured current.
    force, coil : ndarray (n,)
        Shares of the changes of force and measured current: 0 before the step, 1 at the end.
    """

    current_before: float
    current: float
    speed: float
    direction: Direction
    time: Array
    force: Array
    coil: Array


@dataclass(frozen=True, eq=False, repr=False)
class Characterisation:
    """What recordings tell of a damper.

    Attributes
    ----------
    name : str
        Name or serial number of the damper.
    runs : tuple of Run
    values : tuple of Value
        Ordered by quantity, current, direction and speed.
    curves : tuple of Curve
    loops : tuple of Loop
    responses : tuple of Response
    gas_curve : GasCurve or None
    limitations : tuple of str
        What the recordings do not show, and what to record for it, as sentences.
    """

    name: str
    runs: tuple[Run, ...]
    values: tuple[Value, ...]
    curves: tuple[Curve, ...] = ()
    loops: tuple[Loop, ...] = ()
    responses: tuple[Response, ...] = ()
    gas_curve: GasCurve | None = None
    limitations: tuple[str, ...] = ()

    @property
    def currents(self) -> tuple[float, ...]:
        """Steady currents in A at which the damper was characterised, increasing."""
        return tuple(sorted({v.current for v in self.values if v.current is not None and v.current_before is None}))

    @property
    def sentence(self) -> str:
        """The extent of the characterisation in one sentence."""
        speeds = [value.speed for value in self.values if value.quantity == "force_at_speed" and value.speed]
        currents = ", ".join(f"{current:.3g}" for current in self.currents)
        reach = f", forces at {1e3 * min(speeds):.3g} to {1e3 * max(speeds):.3g} mm/s" if speeds else ""
        count = f"{len(self.runs)} run" + ("s" if len(self.runs) > 1 else "")
        at = f" at {currents} A" if currents else ""
        return f"{self.name}: {len(self.values)} values from {count}{at}{reach}."

    def select(
        self,
        quantity: str,
        *,
        current: float | None = None,
        direction: Direction | None = None,
        speed: float | None = None,
        stroke: float | None = None,
        current_before: float | None = None,
    ) -> list[Value]:
        """Return the values of a quantity that hold under the conditions given, by the tolerances of grouping.

        Raises
        ------
        InputError
            For a quantity that does not exist.
        """
        if quantity not in QUANTITIES:
            raise InputError(f"quantity {quantity!r} is not known, expected one of {', '.join(QUANTITIES)}")
        largest = max((abs(v.current) for v in self.values if v.current is not None), default=0.0)

        def holds(value: Value) -> bool:
            return (
                value.quantity == quantity
                and direction in (None, value.direction)
                and _near(current, value.current, SAME_CURRENT * largest)
                and _near(current_before, value.current_before, SAME_CURRENT * largest)
                and _near(speed, value.speed, SAME_SPEED * (speed or 0.0))
                and _near(stroke, value.stroke, SAME_SPEED * (stroke or 0.0))
            )

        return [value for value in self.values if holds(value)]

    def alike(self, other: "Value | Limit") -> list[Value]:
        """Return the values of the quantity, and under the conditions, of another value or of a limit."""
        return self.select(
            other.quantity,
            current=other.current,
            direction=other.direction,
            speed=other.speed,
            stroke=other.stroke,
            current_before=other.current_before,
        )

    def __repr__(self) -> str:
        return f"<Characterisation of {self.name}: {len(self.values)} values>"

    def _repr_html_(self) -> str:
        notes = "".join(f"<li>{escape(text)}</li>" for text in self.limitations)
        return f"<p>{escape(self.sentence)}</p>{html_table(self._rows())}<ul>{notes}</ul>"

    def summary(self) -> str:
        """Return the values with their intervals, and what the recordings do not show, as text."""
        return "\n".join([self.sentence, *text_table(self._rows()), *(f"note: {text}" for text in self.limitations)])

    def plot(self) -> "go.Figure":
        """Return the figure of peak force over peak speed and of force over speed, which a notebook shows."""
        # Plotly is slow to import, and only few characterisations are drawn.
        from mrd_characterisation.figures import force_over_speed

        return force_over_speed([self])

    def _rows(self) -> Sequence[Sequence[str]]:
        from mrd_characterisation.listing import HEAD, value_row

        return [HEAD, *(value_row(value) for value in self.values)]


def by_size(currents: Iterable[float]) -> list[float]:
    """Return distinct currents from the smallest to the largest size: the sense in which a coil is driven counts last."""
    return sorted(set(currents), key=lambda current: (abs(current), current))


def _near(wanted: float | None, found: float | None, tolerance: float) -> bool:
    return wanted is None or (found is not None and abs(found - wanted) <= tolerance)
