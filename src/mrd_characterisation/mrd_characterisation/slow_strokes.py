"""Gas force, gas stiffness and seal drag from slow strokes at the smallest current, where the fluid resists least."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mrd_characterisation.average import average
from mrd_characterisation.characterisation import SAME_SPEED, GasCurve, Value
from mrd_characterisation.strokes import Stroke, grouped

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
class SlowPair:
    """A rebound and a compression stroke of the same slow speed: polynomials of their force in N over the position in m."""

    rebound: Polynomial
    compression: Polynomial
    speed: float
    low: float
    high: float
    run: str

    def gas_force(self, position: Array) -> Array:
        """Return the force in N with which the gas pushes the rod out at positions in m."""
        return np.asarray(-0.5 * (self.rebound(position) + self.compression(position)))

    def drag(self, position: float) -> float:
        """Return half the difference of both directions in N."""
        return float(0.5 * (self.rebound(position) - self.compression(position)))


def slow_pairs(strokes: Sequence[Stroke], fast: float) -> list[SlowPair]:
    """Return pairs of slow strokes one after the other.

    Parameters
    ----------
    strokes : sequence of Stroke
        Those at the smallest current.
    fast : float
        m/s, speed of the fast strokes of all recordings.
    """
    slow, pairs = [stroke for stroke in long_strokes(strokes) if stroke.peak_speed <= SLOW * fast], []
    for first, second in pairwise(slow):
        alike = abs(first.peak_speed - second.peak_speed) <= SAME_SPEED * first.peak_speed
        if first.run is second.run and first.direction != second.direction and alike:
            rebound, compression = (first, second) if first.direction == "rebound" else (second, first)
            pairs.append(_pair(rebound, compression))
    return pairs


def at_mid_stroke(pairs: Sequence[SlowPair]) -> tuple[list[SlowPair], float]:
    """Return the pairs that pass mid-stroke, and its position in m.

    Mid-stroke is the origin of the position; where no pair passes that, it is the middle of the longest pair.
    """
    longest = max(pairs, key=lambda pair: pair.high - pair.low)
    middle = 0.0 if any(pair.low <= 0.0 <= pair.high for pair in pairs) else 0.5 * (longest.low + longest.high)
    return [pair for pair in pairs if pair.low <= middle <= pair.high], middle


def long_strokes(strokes: Sequence[Stroke]) -> list[Stroke]:
    """Return the strokes that are at least `LONG` of the longest."""
    longest = max((stroke.length for stroke in strokes), default=0.0)
    return [stroke for stroke in strokes if stroke.length >= LONG * longest]


def _pair(rebound: Stroke, compression: Stroke) -> SlowPair:
    polynomials, ends = [], []
    for stroke in (rebound, compression):
        middle = 0.5 * (stroke.position[0] + stroke.position[-1])
        central = np.abs(stroke.velocity) >= CENTRAL_SPEED * stroke.peak_speed
        central &= np.abs(stroke.position - middle) <= 0.5 * CENTRAL_WAY * stroke.length
        position = stroke.position[central]
        polynomials.append(Polynomial.fit(position, stroke.force[central], 3))
        ends.append((position.min(), position.max()))
    low, high = max(low for low, _ in ends), min(high for _, high in ends)
    speed = 0.5 * (rebound.peak_speed + compression.peak_speed)
    return SlowPair(polynomials[0], polynomials[1], speed, float(low), float(high), rebound.run.run.name)


def gas_values(pairs: Sequence[SlowPair], current: float) -> tuple[list[Value], GasCurve | None]:
    """Return gas force, gas stiffness and seal drag, and the gas force over the stroke.

    Parameters
    ----------
    pairs : sequence of SlowPair
        See `slow_pairs`.
    current : float
        A, the smallest current, at which the strokes are.
    """
    used, middle = at_mid_stroke(pairs) if pairs else ([], 0.0)
    if not used:
        return [], None
    groups = grouped(used, lambda pair: pair.speed, lambda speed: SAME_SPEED * speed)
    slowest = groups[0]
    position = np.linspace(max(pair.low for pair in slowest), min(pair.high for pair in slowest), CURVE_POINTS)
    speed = float(np.mean([pair.speed for pair in slowest]))
    names = [pair.run for pair in slowest]
    forces = [float(pair.gas_force(np.array(middle))) for pair in slowest]
    stiffnesses = [_stiffness(pair, middle) for pair in slowest]
    condition: dict[str, Any] = {"current": current, "speed": speed, "position": middle}
    strokes = f"strokes of {1e3 * speed:.3g} mm/s at {current:.3g} A"
    gas = Value(
        "gas_force",
        *average(forces, names),
        f"Mean of the forces of both directions at mid-stroke (x = {1e3 * middle:.3g} mm) in the slowest {strokes}, by "
        "cubic polynomials of the unfiltered force over the smoothed position; positive where it pushes the rod out.",
        **condition,
    )
    stiffness = Value(
        "gas_stiffness",
        *average(stiffnesses, names),
        f"Slope over the position of the mean of both directions, at mid-stroke, in the slowest {strokes}; positive where "
        "the force that pushes the rod out grows as the rod goes in.",
        **condition,
    )
    curve = np.mean([pair.gas_force(position) for pair in slowest], axis=0)
    return [gas, stiffness, _seal_drag(groups, middle, current)], GasCurve(position, curve)


def _stiffness(pair: SlowPair, middle: float) -> float:
    return float(0.5 * (pair.rebound.deriv()(middle) + pair.compression.deriv()(middle)))


def _seal_drag(groups: Sequence[Sequence[SlowPair]], middle: float, current: float) -> Value:
    """Return the seal drag at standstill where there are two slow speeds or more, else that at the slow speed."""
    pairs = [pair for group in groups[:MOST_SPEEDS] for pair in group]
    drags, names = [pair.drag(middle) for pair in pairs], [pair.run for pair in pairs]
    speeds = np.array([pair.speed for pair in pairs])
    found = [float(np.mean([pair.speed for pair in group])) for group in groups[:MOST_SPEEDS]]
    definition = "Half the difference of the forces of both directions at mid-stroke"
    if len(found) < 2:
        definition += (
            f" in strokes of {1e3 * found[0]:.3g} mm/s at {current:.3g} A; a viscous and a yield force are part of it."
        )
        return Value("seal_drag", *average(drags, names), definition, current=current, speed=found[0], position=middle)
    line = Polynomial.fit(speeds, drags, 1).convert()
    at_rest = np.asarray(drags) - line.coef[1] * speeds if len(line.coef) > 1 else np.asarray(drags)
    mean = average(at_rest.tolist(), names)
    # The line itself is uncertain at standstill, which is beyond the speeds recorded.
    lever = float(np.sqrt(1.0 + speeds.mean() ** 2 / speeds.var()))
    half = (mean.upper - mean.value) * lever
    listed = " and ".join(f"{1e3 * speed:.3g}" for speed in found)
    definition += (
        f", extrapolated by a line to standstill from strokes of {listed} mm/s at {current:.3g} A; what a yield force adds "
        "at standstill is part of it."
    )
    mean = mean._replace(lower=mean.value - half, upper=mean.value + half)
    return Value("seal_drag", *mean, definition, current=current, speed=0.0, position=middle)
