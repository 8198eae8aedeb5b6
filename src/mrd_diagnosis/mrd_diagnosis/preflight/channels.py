"""A run as the checks see it, and what they have in common."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from mrd_diagnosis.diagnosis import Finding
from mrd_runs import Run

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

NOISY = 0.1
"""Share of samples that are local extremes (white noise: 2/3). Below, values may well repeat, without noise as they are."""
LOW_RATE = 100.0
"""Hz; coil and particles follow the current within 3 to 15 ms, so at least one sample has to fall in that time."""
RATES = 0.01
"""Relative; clocks of crystals agree within 100 ppm, so that this is another setting."""


@dataclass(frozen=True)
class Channel:
    """A series of a run with what its digits tell.

    ``step`` is the least step of its values (0: none), ``noise`` the standard deviation of what is white in it.
    """

    name: str
    unit: str
    values: Array

    @cached_property
    def step(self) -> float:
        levels = np.unique(self.values)
        gaps = np.diff(levels)
        gaps = gaps[gaps > 1e-12 * max(np.abs(levels[0]), np.abs(levels[-1]))] if len(gaps) else gaps
        # Of values without steps, the closest two are a span over their number squared apart, the others over their number.
        return float(gaps.min()) if len(gaps) and gaps.min() > 0.1 * np.median(gaps) else 0.0

    @cached_property
    def noise(self) -> float:
        # Third differences pass white noise with 20 times its variance and next to nothing of what is slower.
        return float(1.4826 * np.median(np.abs(np.diff(self.values, 3))) / np.sqrt(20.0))

    @cached_property
    def _local_noise(self) -> Array:
        steps = np.abs(np.diff(self.values, 3))
        blocks = steps[: len(steps) // 50 * 50].reshape(-1, 50) if len(steps) >= 50 else steps[None]
        return np.asarray(1.4826 * np.median(blocks, axis=1) / np.sqrt(20.0))

    @cached_property
    def quiet(self) -> float:
        """Noise where there is least of it, as on a plateau."""
        return float(np.quantile(self._local_noise, 0.1))

    @cached_property
    def loud(self) -> float:
        """Noise where there is most of it, as off a flat top."""
        return float(np.quantile(self._local_noise, 0.9))

    @cached_property
    def noisy(self) -> bool:
        """Whether readings away from the extremes go up and down by themselves."""
        inner = self.values[1:-1]
        slopes = np.diff(self.values)
        turning = slopes[1:] * slopes[:-1] < 0
        between = (inner > self.values.min()) & (inner < self.values.max())
        return bool(between.sum() >= 0.2 * len(inner) and np.mean(turning[between]) > NOISY)


@dataclass(frozen=True)
class View:
    """A run as the checks see it."""

    run: Run

    @cached_property
    def interval(self) -> float:
        return float(np.median(np.diff(self.run.time)))

    @property
    def slow(self) -> bool:
        """Whether so little is sampled that differences of samples tell more of the motion than of noise."""
        return 1 / self.interval < (1 - RATES) * LOW_RATE

    @cached_property
    def channels(self) -> dict[str, Channel]:
        found = {
            "position": Channel("position", "m", self.run.position),
            "force": Channel("force", "N", self.run.force),
            "current": Channel("current", "A", self.run.current),
        }
        if self.run.acceleration is not None:
            found["acceleration"] = Channel("acceleration", "m/s²", self.run.acceleration)
        return found

    @cached_property
    def stroke(self) -> float:
        """m, peak to peak; 0 where there is nothing but noise."""
        position = self.channels["position"]
        spread = float(np.ptp(position.values))
        return spread if spread > max(10 * position.noise, 2.5 * position.step) else 0.0

    @cached_property
    def speed(self) -> float:
        """m/s that all but a few samples stay below."""
        return float(np.quantile(np.abs(self.run.velocity), 0.995))

    @cached_property
    def strokes(self) -> Indices:
        """First samples of the strokes, each from reversal to reversal."""
        if not self.stroke:
            return np.zeros(1, np.intp)
        moving = np.flatnonzero(np.abs(self.run.velocity) > 0.02 * self.speed)
        upwards = self.run.velocity[moving] > 0
        return np.append(0, moving[1:][upwards[1:] != upwards[:-1]])

    @cached_property
    def varies(self) -> bool:
        """Whether the current changes by more than its noise."""
        current = self.channels["current"]
        low, high = np.quantile(current.values, [0.01, 0.99])
        noise = 1.4826 * float(np.median(np.abs(np.diff(current.values)))) / np.sqrt(2.0)
        return bool(high - low > max(6 * noise, 2e-3))

    def finding(self, kind: str, severity: str, channel: str, text: str) -> Finding:
        """A finding about this run."""
        return Finding(kind, severity, text, self.run.name, channel)  # type: ignore[arg-type]


MOVED = 1e-3
"""m of stroke from which a damper has to answer."""
FEW_STROKES = 3
"""Up to so many, the force may be one of rest or of the current more than one of motion."""
SHORT_STROKE = 2e-3
"""m; a loop of usual yield travel (0.1 to 1 mm) and lost motion is not left by shorter ones."""


def stretches(mask: Mask) -> tuple[Indices, Indices]:
    """First and last index of each stretch of a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return edges[::2], edges[1::2] - 1


def equal_neighbours(values: Array) -> tuple[Indices, Indices]:
    """First and last sample of each stretch of equal readings."""
    first, last = stretches(np.diff(values) == 0)
    return first, last + 1


def milli(value: float) -> str:
    """A value in thousandths, to three figures."""
    return f"{1e3 * value:.3g}"


def overlap(one: Array, other: Array, shift: int) -> tuple[Array, Array]:
    """The parts of two series that lie at the same time when the other is ``shift`` samples late."""
    count = min(len(one) + min(shift, 0), len(other) - max(shift, 0), len(one), len(other))
    return one[max(-shift, 0) :][:count], other[max(shift, 0) :][:count]


def correlations(one: Array, other: Array, reach: int | None = None) -> tuple[Indices, Array]:
    """Shifts up to ``reach`` (a fifth of the shorter) of the other series, and the correlation of what then overlaps."""
    one, other = one - one.mean(), other - other.mean()
    size = fft.next_fast_len(len(one) + len(other), real=True)
    product = fft.irfft(np.conj(fft.rfft(one, size)) * fft.rfft(other, size), size)
    reach = min(len(one), len(other)) // 5 if reach is None else reach
    shifts = np.arange(-reach, reach + 1)
    first, first_other = np.maximum(-shifts, 0), np.maximum(shifts, 0)
    count = np.minimum(len(one) - first, len(other) - first_other)
    energy, energy_other = (np.append(0.0, np.cumsum(series**2)) for series in (one, other))
    norm = (energy[first + count] - energy[first]) * (energy_other[first_other + count] - energy_other[first_other])
    return shifts, np.asarray(product[shifts] / np.sqrt(np.maximum(norm, 1e-300)))
