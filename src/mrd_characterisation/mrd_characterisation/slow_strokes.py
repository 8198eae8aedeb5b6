"""Gas force, gas stiffness and seal drag from slow strokes at the smallest current, where the fluid resists least."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mrd_characterisation.average import RUNS_FOR_INTERVAL, Average, intercept
from mrd_characterisation.characterisation import SAME_SPEED, Direction, GasCurve, Value
from mrd_characterisation.force_speed import DIRECTIONS
from mrd_characterisation.strokes import FEWEST_SAMPLES, Stroke, grouped

Array = NDArray[np.float64]

SLOW = 0.2
"""Peak speed of a slow stroke over the speed of the fast strokes. By then a viscous force has fallen to a fifth."""

CENTRAL_SPEED, CENTRAL_WAY = 0.8, 0.8
"""Where the force of a slow stroke is read, away from the reversals: least share of its peak speed, and middle share of its
way."""

MOST_SPEEDS = 3
"""Slow speeds, from the slowest on, through which the seal drag is extrapolated to standstill."""

LONG = 0.5
"""Strokes shorter than this share of the longest one tell nothing of the stiffness over the stroke."""

CURVE_POINTS = 41


@dataclass(frozen=True, eq=False)
class SlowStroke:
    """A slow stroke: a polynomial of its force in N over the position in m, between two positions."""

    force: Polynomial
    direction: Direction
    speed: float
    low: float
    high: float
    run: str


@dataclass(frozen=True, eq=False)
class _SlowRun:
    """The strokes of one speed and run that pass mid-stroke, in both directions."""

    rebound: list[SlowStroke]
    compression: list[SlowStroke]

    @property
    def strokes(self) -> list[SlowStroke]:
        return [*self.rebound, *self.compression]

    @property
    def cycles(self) -> int:
        return min(len(self.rebound), len(self.compression))

    @property
    def speed(self) -> float:
        return float(np.mean([stroke.speed for stroke in self.strokes]))

    def gas_force(self, position: Array) -> Array:
        """Return the force in N with which the gas pushes the rod out at positions in m."""
        means = [np.mean([stroke.force(position) for stroke in of], axis=0) for of in (self.rebound, self.compression)]
        return np.asarray(-0.5 * (means[0] + means[1]))


def long_strokes(strokes: Sequence[Stroke]) -> list[Stroke]:
    """Return the strokes that are at least `LONG` of the longest."""
    longest = max((stroke.length for stroke in strokes), default=0.0)
    return [stroke for stroke in strokes if stroke.length >= LONG * longest]


def _slow_stroke(stroke: Stroke) -> SlowStroke | None:
    """Return the force over the middle of a stroke; None where it has too few samples there."""
    middle = 0.5 * (stroke.position[0] + stroke.position[-1])
    central = np.abs(stroke.velocity) >= CENTRAL_SPEED * stroke.peak_speed
    central &= np.abs(stroke.position - middle) <= 0.5 * CENTRAL_WAY * stroke.length
    if np.count_nonzero(central) < FEWEST_SAMPLES:
        return None
    position = stroke.position[central]
    force = Polynomial.fit(position, stroke.force[central], 3)
    low, high = float(position.min()), float(position.max())
    return SlowStroke(force, stroke.direction, stroke.peak_speed, low, high, stroke.run.run.name)


def gas_values(strokes: Sequence[Stroke], readable: Sequence[Stroke], fast: float) -> tuple[list[Value], GasCurve | None]:
    """Return gas force, gas stiffness and seal drag, and the gas force over the stroke, as far as strokes show them.

    Parameters
    ----------
    strokes : sequence of Stroke
        Those at the smallest current, at least one. The long ones show gas force and stiffness, see `long_strokes`.
    readable : sequence of Stroke
        Those of them that show the force at a speed. They show the seal drag, as the long ones do.
    fast : float
        m/s, speed of the fast strokes of all recordings.
    """
    current, long = strokes[0].current, long_strokes(strokes)
    slow = {stroke: read for stroke in strokes if stroke.peak_speed <= SLOW * fast and (read := _slow_stroke(stroke))}
    of_long = [read for stroke, read in slow.items() if stroke in long]
    of_drag = [read for stroke, read in slow.items() if stroke in long or stroke in readable]
    middle = _mid_stroke(of_long or of_drag)
    slowest_ones = _slow_groups(of_drag, middle)[:MOST_SPEEDS]
    if not slowest_ones:
        return [], None
    drag = _seal_drag(slowest_ones, middle, current)
    of_gas = _slow_groups(of_long, middle)
    if not of_gas:
        return [drag], None
    slowest = of_gas[0]
    passing = [stroke for run in slowest for stroke in run.strokes]
    position = np.linspace(max(one.low for one in passing), min(one.high for one in passing), CURVE_POINTS)
    speed = float(np.mean([run.speed for run in slowest]))
    condition: dict[str, Any] = {"current": current, "speed": speed, "position": middle}
    words = f"strokes of {1e3 * speed:.3g} mm/s at {current:.3g} A"
    gas = Value(
        "gas_force",
        *_of_directions(slowest, lambda stroke: -float(stroke.force(middle)), 1.0),
        f"Mean of the forces of both directions at mid-stroke (x = {1e3 * middle:.3g} mm) in the slowest long {words}, by "
        "cubic polynomials of the unfiltered force over the smoothed position; positive where it pushes the rod out.",
        **condition,
    )
    stiffness = Value(
        "gas_stiffness",
        *_of_directions(slowest, lambda stroke: float(stroke.force.deriv()(middle)), 1.0),
        f"Slope over the position of the mean of both directions, at mid-stroke, in the slowest long {words}; positive "
        "where the force that pushes the rod out grows as the rod goes in.",
        **condition,
    )
    curve = np.mean([run.gas_force(position) for run in slowest], axis=0)
    names = [stroke.run for group in (slowest, *slowest_ones) for run in group for stroke in run.strokes]
    return [gas, stiffness, drag], GasCurve(position, curve, tuple(dict.fromkeys(names)))


def _mid_stroke(strokes: Sequence[SlowStroke]) -> float:
    """Return the origin of the position in m, or the middle of the longest stroke where none passes the origin."""
    if not strokes or any(stroke.low <= 0.0 <= stroke.high for stroke in strokes):
        return 0.0
    longest = max(strokes, key=lambda stroke: stroke.high - stroke.low)
    return 0.5 * (longest.low + longest.high)


def _slow_groups(strokes: Sequence[SlowStroke], middle: float) -> list[list[_SlowRun]]:
    """Return the runs with strokes of both directions that pass mid-stroke, grouped by speed, the slowest first."""
    passing = [stroke for stroke in strokes if stroke.low <= middle <= stroke.high]
    groups = []
    for group in grouped(passing, lambda stroke: stroke.speed, lambda speed: SAME_SPEED * speed):
        runs = []
        for name in dict.fromkeys(stroke.run for stroke in group):
            of_run = [stroke for stroke in group if stroke.run == name]
            both = [[stroke for stroke in of_run if stroke.direction == way] for way in DIRECTIONS]
            if all(both):
                runs.append(_SlowRun(*both))
        if runs:
            groups.append(runs)
    return groups


def _seal_drag(groups: Sequence[Sequence[_SlowRun]], middle: float, current: float) -> Value:
    """Return the seal drag at standstill where there are two slow speeds or more, else that at the slow speed."""
    runs = [run for group in groups for run in group]
    found = [float(np.mean([run.speed for run in group])) for group in groups]
    drag = _of_directions(runs, lambda stroke: float(stroke.force(middle)), -1.0, line=len(found) > 1)
    definition = "Half the difference of the forces of both directions at mid-stroke"
    if len(found) < 2:
        definition += (
            f" in strokes of {1e3 * found[0]:.3g} mm/s at {current:.3g} A; a viscous and a yield force are part of it."
        )
        return Value("seal_drag", *drag, definition, current=current, speed=found[0], position=middle)
    listed = " and ".join(f"{1e3 * speed:.3g}" for speed in found)
    definition += (
        f", extrapolated by a line to standstill from strokes of {listed} mm/s at {current:.3g} A; what a yield force adds "
        "at standstill is part of it."
    )
    return Value("seal_drag", *drag, definition, current=current, speed=0.0, position=middle)


def _of_directions(
    runs: Sequence[_SlowRun], number: Callable[[SlowStroke], float], sign: float, *, line: bool = False
) -> Average:
    """Return half the number of rebound strokes plus (sign 1) or less (sign -1) that of compression strokes.

    With a line it is that at standstill, by a line over the speed. The interval follows from the residuals of the strokes,
    or from those of the runs where these leave as many degrees of freedom as `average` asks for.
    """
    cycles, names = sum(run.cycles for run in runs), len({stroke.run for run in runs for stroke in run.strokes})
    columns = np.array([[1.0, run.speed][: 1 + line] for run in runs])
    if len(runs) - columns.shape[1] >= RUNS_FOR_INTERVAL - 1:
        means = [[np.mean([number(one) for one in of]) for of in (run.rebound, run.compression)] for run in runs]
        value, half, scatter = intercept(columns, [0.5 * (rebound + sign * compression) for rebound, compression in means])
        return Average(value, value - half, value + half, scatter, cycles, names)
    strokes = [stroke for run in runs for stroke in run.strokes]
    of_run = np.repeat(np.eye(len(runs)), [len(run.strokes) for run in runs], axis=0)
    rebound = np.array([[stroke.direction == "rebound"] for stroke in strokes])
    # What has the other sign is another number in each run, as the zero of the load cell.
    columns = np.hstack([np.where(rebound, 1.0, sign) * (of_run @ columns), np.where(rebound, 1.0, -sign) * of_run])
    value, half, scatter = intercept(columns, list(map(number, strokes)))
    return Average(value, value - half, value + half, scatter / math.sqrt(2.0), cycles, names)
