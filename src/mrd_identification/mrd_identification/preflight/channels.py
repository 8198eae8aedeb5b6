"""Channels of a run and the quantities that several preflight checks need: noise, quantisation step, stroke, speed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mrd_identification.preflight.finding import Finding, Severity
from mrd_identification.recording import current_varies
from mrd_runs import Run
from mrd_runs.scales import Scales
from mrd_runs.signals.quantisation import resolution, smallest_step

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NOISY_TURNING_SHARE = 0.1
"""Share of samples that are local extremes, from which a channel counts as noisy. White noise has 2/3. With less, equal
readings in a row are nothing unusual."""
LOW_RATE = 100.0
"""Sample rate in Hz below which a run counts as slowly sampled. Coil and particles follow the current within 3 to 15 ms, and
at least one sample has to fall into that time."""
RATE_TOLERANCE = 0.01
"""Relative difference of sample rates that still count as equal. Crystal clocks agree within 100 ppm, so a larger difference
is another setting."""
MOVING_STROKE = 0.05
"""Share of half the span of all positions, from which on the force of a damper has to respond: several yield travels."""
FEW_STROKES = 3
"""Up to this number of strokes, the force may follow the initial state or the current more than the motion."""
PRE_YIELD_STROKE = 0.1
"""The same share below which a damper may stay in its pre-yield loop: yield travel and lost motion."""
NOISE_BLOCK = 50
"""Samples over which the local noise is estimated: enough for a median, short against a plateau."""


def _white_noise_deviation(third_differences: Array, axis: int | None = None) -> Array:
    """Standard deviation of white noise from third differences of a series.

    Third differences pass white noise with 20 times its variance, and next to nothing of what is slower. The median is
    blind to single steps; 1.4826 turns it into the standard deviation of a normal variable.
    """
    return np.asarray(1.4826 * np.median(np.abs(third_differences), axis=axis) / np.sqrt(20.0))


SHORTEST_REFRESH = 1.2
"""Samples between new readings; a channel that is refreshed more often repeats some by chance."""

FEWEST_REFRESHES = 20
"""New readings from which their intervals are compared."""

REGULAR_SHARE = 0.6
"""Share of the readings that stay equally long, within a sample."""

MOST_IRREGULAR = 0.5
"""Standard deviation in samples of the places of new readings from a regular grid; rounding to samples alone makes 0.3."""


@dataclass(frozen=True)
class Channel:
    """One measured series of a run.

    Attributes
    ----------
    name : str
    unit : str
    values : ndarray (n,)
    """

    name: str
    unit: str
    values: Array

    @cached_property
    def resolution(self) -> float:
        """Smallest difference between two readings; 0 where they are continuous."""
        return resolution(self.values)

    @cached_property
    def refresh_period(self) -> float:
        """Samples between new readings, if they come at regular intervals; otherwise 0.

        The interval may be any number: readings at 100 Hz stay for two and three samples of 250 Hz in turn.
        """
        places = np.flatnonzero(np.diff(self.values)) + 1
        length = np.diff(places)
        if len(length) < FEWEST_REFRESHES:
            return 0.0
        common = np.bincount(length)
        usual = int(np.argmax(common[1:] + np.append(common[2:], 0))) + 1
        is_usual = (length == usual) | (length == usual + 1)
        period = float(length[is_usual].mean())
        changes = np.abs(self.values[places] - self.values[places - 1])
        # Noise within one step and a slow signal also repeat readings, but not with large changes at regular intervals.
        if period < SHORTEST_REFRESH or is_usual.mean() < REGULAR_SHARE or np.median(changes) <= 3 * self.resolution:
            return 0.0
        # Two readings may be alike by chance, so that one refresh is not seen.
        number = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(length / period), 1.0))])
        line = np.polynomial.Polynomial.fit(number, places, 1)
        return float(line.deriv()(0.0)) if np.std(places - line(number)) < MOST_IRREGULAR else 0.0

    @cached_property
    def smallest_step(self) -> float:
        """Smallest difference between two readings, also where they are continuous."""
        return smallest_step(self.values)

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the white noise."""
        return float(_white_noise_deviation(np.diff(self.values, 3)))

    @cached_property
    def local_noise(self) -> Array:
        """White noise in each block of samples."""
        differences = np.diff(self.values, 3)
        blocks = len(differences) // NOISE_BLOCK
        if not blocks:
            return _white_noise_deviation(differences[None], axis=1)
        return _white_noise_deviation(differences[: blocks * NOISE_BLOCK].reshape(-1, NOISE_BLOCK), axis=1)

    @cached_property
    def lowest_noise(self) -> float:
        """White noise where there is least of it, for example on a plateau (10 % quantile over the blocks)."""
        return float(np.quantile(self.local_noise, 0.1))

    @cached_property
    def highest_noise(self) -> float:
        """White noise where there is most of it, for example beside a clipped part (90 % quantile over the blocks)."""
        return float(np.quantile(self.local_noise, 0.9))

    @cached_property
    def is_noisy(self) -> bool:
        """Whether neighbouring readings go up and down because of noise."""
        inner = self.values[1:-1]
        slopes = np.diff(self.values)
        turning = slopes[1:] * slopes[:-1] < 0
        # The extremes are left aside: clipped readings and plateaus do not turn.
        between = (inner > self.values.min()) & (inner < self.values.max())
        return bool(between.sum() >= 0.2 * len(inner) and np.mean(turning[between]) > NOISY_TURNING_SHARE)


@dataclass(frozen=True)
class CheckedRun:
    """A run with its channels and the quantities that several checks need.

    Attributes
    ----------
    run : Run
    scales : Scales
        Those of all runs of the analysis.
    """

    run: Run
    scales: Scales

    @cached_property
    def sampling_interval(self) -> float:
        """Median time between samples in s."""
        return float(np.median(np.diff(self.run.time)))

    @property
    def is_slowly_sampled(self) -> bool:
        """Whether differences of neighbouring samples contain more motion than noise."""
        return 1 / self.sampling_interval < (1 - RATE_TOLERANCE) * LOW_RATE

    @cached_property
    def channels(self) -> dict[str, Channel]:
        """Measured channels by name."""
        channels = {
            "position": Channel("position", "m", self.run.position),
            "force": Channel("force", "N", self.run.force),
            "current": Channel("current", "A", self.run.current),
        }
        if self.run.acceleration is not None:
            channels["acceleration"] = Channel("acceleration", "m/s²", self.run.acceleration)
        return channels

    @cached_property
    def stroke(self) -> float:
        """Stroke in m, peak to peak; 0 where the position contains noise only."""
        position = self.channels["position"]
        span = float(np.ptp(position.values))
        # White noise of 100000 samples spans about 9 standard deviations.
        return span if span > max(10 * position.noise, 2.5 * position.resolution) else 0.0

    @property
    def moves(self) -> bool:
        """Whether the rod moves so far that the force of a damper has to respond."""
        return self.stroke > MOVING_STROKE * self.scales.stroke

    @cached_property
    def top_speed(self) -> float:
        """Speed in m/s that 99.5 % of the samples stay below."""
        return float(np.quantile(np.abs(self.run.velocity), 0.995))

    @cached_property
    def stroke_starts(self) -> Indices:
        """Index of the first sample of each stroke; a stroke goes from one reversal to the next."""
        if not self.stroke:
            return np.zeros(1, np.intp)
        moving = np.flatnonzero(np.abs(self.run.velocity) > 0.02 * self.top_speed)
        extending = self.run.velocity[moving] > 0
        return np.append(0, moving[1:][extending[1:] != extending[:-1]])

    @cached_property
    def current_varies(self) -> bool:
        """Whether the current changes by more than its noise."""
        return current_varies(self.run)

    def finding(self, kind: str, severity: Severity, channel: str, text: str) -> Finding:
        """Make a finding about a channel of this run."""
        return Finding(kind, severity, text, self.run.name, channel)


def milli(value: float) -> str:
    """Write a value in thousandths, with three significant figures."""
    return f"{1e3 * value:.3g}"


def counted(number: int, noun: str) -> str:
    """Write a number of things, with the noun in the singular or the plural."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
