"""Strokes and cycles of runs: what lies between the reversals of the rod, at which current and how fast."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mrd_characterisation.characterisation import SAME_CURRENT, Direction
from mrd_runs.signals.current import current_noise
from mrd_runs.signals.smoothed_run import SmoothedRun

Array = NDArray[np.float64]
T = TypeVar("T")

LEAST_TRAVEL = 0.005
"""Least travel between two reversals, over the span of the position of the run; less counts as rest."""

NOISES = 8.0
"""Least travel between two reversals, in standard deviations of the noise of the position."""

REACHES = 0.98
"""Quantile of the speed of a stroke that counts as its peak speed; the smoothing overshoots at the corners of triangles."""

PLATEAU, PLATEAU_SHARE = 0.03, 0.6
"""A stroke has a constant speed where this share of its samples lies within this relative distance of their median speed."""

CLOSED = 0.02
"""Distance from the end of a cycle to its begin, over its stroke, up to which it is closed; also the relative difference of
stroke and peak speed up to which it is like the cycle before or after it."""

SETTLED = 0.1
"""s before a stroke during which the current must be steady as well. Coils and fluids of dampers of all sizes follow within
less: the response times in the literature lie between 2 and 100 ms."""

MOVES = 0.02
"""Speed over the peak speed of a stroke, below which the rod rests at its ends."""

FEWEST_SAMPLES = 12
"""Samples of a stroke, below which its force is not read."""


@dataclass(frozen=True, eq=False)
class Stroke:
    """The motion of the rod from a reversal to the next one.

    Attributes
    ----------
    run : SmoothedRun
    samples : slice
        From the reversal to the next one, both included.
    peak_speed : float
        m/s, the `REACHES` quantile of the speed; of a stroke of constant speed the median.
    constant_speed : bool
    current : float
        Mean current in A; nan where the current is not steady.
    """

    run: SmoothedRun
    samples: slice
    peak_speed: float
    constant_speed: bool
    current: float

    @property
    def direction(self) -> Direction:
        """Direction of the motion."""
        return "rebound" if self.position[-1] > self.position[0] else "compression"

    @property
    def position(self) -> Array:
        """Smoothed position in m (n,)."""
        return self.run.motion.position[self.samples]

    @property
    def velocity(self) -> Array:
        """Smoothed velocity in m/s (n,)."""
        return self.run.motion.velocity[self.samples]

    @property
    def force(self) -> Array:
        """Measured force in N (n,), not filtered."""
        return self.run.run.force[self.samples]

    @property
    def time(self) -> Array:
        """Time in s (n,)."""
        return self.run.run.time[self.samples]

    @property
    def length(self) -> float:
        """Travel in m."""
        return float(abs(self.position[-1] - self.position[0]))

    @property
    def steady(self) -> bool:
        """Whether the current is steady."""
        return not math.isnan(self.current)


@dataclass(frozen=True, eq=False)
class Cycle:
    """Two strokes one after the other, which end where they began.

    Attributes
    ----------
    first, second : Stroke
    """

    first: Stroke
    second: Stroke

    @property
    def rebound(self) -> Stroke:
        """The stroke that extends the damper."""
        return self.first if self.first.direction == "rebound" else self.second

    @property
    def compression(self) -> Stroke:
        """The stroke that compresses the damper."""
        return self.second if self.first.direction == "rebound" else self.first

    @property
    def samples(self) -> slice:
        """Samples of both strokes."""
        return slice(self.first.samples.start, self.second.samples.stop)

    @property
    def run(self) -> SmoothedRun:
        """The run that it is from."""
        return self.first.run

    @property
    def peak_speed(self) -> float:
        """Mean peak speed of both strokes in m/s."""
        return 0.5 * (self.first.peak_speed + self.second.peak_speed)

    @property
    def length(self) -> float:
        """Mean length of both strokes in m."""
        return 0.5 * (self.first.length + self.second.length)

    @property
    def current(self) -> float:
        """Mean current in A of its first stroke."""
        return self.first.current


def strokes_of(smoothed: SmoothedRun, largest_current: float) -> list[Stroke]:
    """Return the strokes of a run; the parts before the first and after the last reversal are none.

    Parameters
    ----------
    smoothed : SmoothedRun
    largest_current : float
        A, of all runs of the damper; a steady current varies by less than `SAME_CURRENT` of it.
    """
    position, velocity = smoothed.motion.position, smoothed.motion.velocity
    least = max(LEAST_TRAVEL * float(np.ptp(position)), NOISES * smoothed.motion.position_noise)
    rate, strokes = smoothed.run.rate, []
    varies = max(SAME_CURRENT * largest_current, 2.0 * current_noise(smoothed.run.current))
    for begin, end in pairwise(_reversals(position, velocity, least)):
        if end - begin < FEWEST_SAMPLES:
            continue
        begin, end = _moving_part(np.abs(velocity[begin : end + 1]), begin)
        if end - begin < FEWEST_SAMPLES:
            continue
        samples = slice(begin, end + 1)
        speed = np.abs(velocity[samples])
        middle = float(np.median(speed))
        constant = float(np.mean(np.abs(speed - middle) <= PLATEAU * middle)) >= PLATEAU_SHARE
        around = smoothed.current[max(0, begin - math.ceil(SETTLED * rate)) : end + 1]
        steady = float(np.ptp(np.quantile(around, [0.01, 0.99]))) <= varies
        strokes.append(
            Stroke(
                smoothed,
                samples,
                middle if constant else float(np.quantile(speed, REACHES)),
                constant,
                float(np.mean(smoothed.current[samples])) if steady else math.nan,
            )
        )
    return strokes


def _reversals(position: Array, velocity: Array, least: float) -> list[int]:
    """Return the samples at which the rod reverses after a travel of at least ``least`` in m, in their order."""
    signs = np.sign(velocity)
    moving = np.flatnonzero(signs)
    if len(moving) < 2:
        return []
    changes = moving[1:][signs[moving[1:]] != signs[moving[:-1]]]
    reversals: list[int] = []
    direction = 0.0
    extreme = 0
    for sample in [*map(int, changes), len(position) - 1]:
        travel = position[sample] - position[extreme]
        if direction * travel > 0.0 or (direction == 0.0 and abs(travel) >= least):
            # Goes on, or has begun to move.
            direction = direction or float(np.sign(travel))
            extreme = sample
        elif direction and abs(travel) >= least:
            reversals.append(extreme)
            direction, extreme = -direction, sample
    return reversals


def _moving_part(speed: Array, begin: int) -> tuple[int, int]:
    """Return the first and last sample of a stroke without the rests at its ends, where the rod hardly moves."""
    moving = np.flatnonzero(speed > MOVES * np.quantile(speed, REACHES))
    if not len(moving):
        return begin, begin
    return begin + max(int(moving[0]) - 1, 0), begin + min(int(moving[-1]) + 1, len(speed) - 1)


def cycles_of(strokes: Sequence[Stroke]) -> list[Cycle]:
    """Return the cycles of a run at steady current that do not overlap and are like the cycle before or after them.

    Parameters
    ----------
    strokes : sequence of Stroke
        Of one run, in their order.
    """
    closed: list[tuple[int, Cycle]] = []
    place = 0
    while place + 1 < len(strokes):
        first, second = strokes[place], strokes[place + 1]
        open_by = abs(second.position[-1] - first.position[0])
        gap = abs(second.position[0] - first.position[-1])
        if first.current == second.current and max(open_by, gap) <= CLOSED * first.length:
            closed.append((place, Cycle(first, second)))
            place += 2
        else:
            place += 1
    alike: set[int] = set()
    for (place, cycle), (next_place, following) in pairwise(closed):
        if next_place == place + 2 and _alike(cycle, following):
            alike |= {place, next_place}
    return [cycle for place, cycle in closed if place in alike]


def _alike(one: Cycle, other: Cycle) -> bool:
    same_length = abs(one.length - other.length) <= CLOSED * one.length
    return same_length and abs(one.peak_speed - other.peak_speed) <= CLOSED * one.peak_speed


def grouped(items: Sequence[T], size: Callable[[T], float], same: Callable[[float], float]) -> list[list[T]]:
    """Sort items by size, and group those that are no further from the least of their group than ``same`` of it."""
    groups: list[list[T]] = []
    for item in sorted(items, key=size):
        if groups and size(item) - size(groups[-1][0]) <= same(size(groups[-1][0])):
            groups[-1].append(item)
        else:
            groups.append([item])
    return groups


def rounded(number: float, tolerance: float) -> float:
    """Return a number without the digits that are far below a tolerance: a measured 0.3998 A is 0.4 A."""
    return round(number, 1 - math.floor(math.log10(tolerance))) + 0.0 if tolerance > 0.0 else number
