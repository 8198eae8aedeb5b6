"""The path along which a damper model is integrated: samples plus the vertices where the rod reverses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from mrd_runs import Run
from mrd_runs.signals.mains import MAINS_LINES, Line, mains_lines
from mrd_runs.signals.motion import motion_between_samples, subdivide, subdivided_indices
from mrd_runs.signals.smoothed_run import Excess, SmoothedRun
from mrd_sim.lead_in import LeadIn

Array = NDArray[np.float64]

FORCE_STEP = 0.03
"""Share of half the force's range. Sampling intervals with a larger change of force are divided."""

MOST_PIECES = 8
"""Pieces of one sampling interval; the time that a force takes grows with them."""

COARSE_STEP = 0.05
"""Share of the largest speed, current and force that none of them passes by between two vertices of a coarse path."""


TEMPERATURE_WINDOW = 1.0
"""s, the length of the moving average over the measured temperature. No damper warms up by a kelvin in such a time: even the
largest dissipate less than a kilowatt in each kilogram."""


@dataclass(frozen=True)
class Path:
    """Motion and current on the vertices of a polyline, in SI units.

    Hysteresis depends on the turning points of the motion, and these rarely fall on a sample. So a vertex is inserted
    wherever the velocity changes sign between two samples, and the models integrate exactly from vertex to vertex.

    Attributes
    ----------
    dt : ndarray (m,)
        s since the previous vertex; 0 at the first.
    position, velocity, acceleration : ndarray (m,)
        m, m/s, m/s².
    current : ndarray (m,)
        A.
    samples : ndarray (n,) of int
        Indices of the vertices that are samples.
    mains : sequence of Line
        Hum on the recorded force near each of `MAINS_LINES`; without a recording, of no size and phase.
    smoothed : SmoothedRun or None
        Recorded run along which the path leads.
    kept : slice or None
        Samples that are vertices, where not all are; the index of any other sample is that of the last vertex before it.
    lead_in : LeadIn or None
        Motion before the first sample, whose vertices come first; without one, a model begins at rest and unloaded.
    excess : Excess or None
        Force on the vertices that a simulator of the user's own has beyond the model that stands for it.
    temperature : ndarray (m,) or None
        Measured temperature of the damper in K.
    """

    dt: Array
    position: Array
    velocity: Array
    acceleration: Array
    current: Array
    samples: NDArray[np.intp]
    mains: Sequence[Line] = tuple(map(Line, MAINS_LINES))
    smoothed: SmoothedRun | None = None
    kept: slice | None = None
    lead_in: LeadIn | None = None
    excess: Excess | None = None
    temperature: Array | None = None
    _bare: "Path | None" = None

    @property
    def recorded(self) -> "Path":
        """The path without its lead-in."""
        return self._bare or self

    @property
    def lead(self) -> int:
        """Number of vertices of the lead-in."""
        return 0 if self.lead_in is None else len(self.lead_in.before)

    def led_in(self, lead_in: LeadIn | None) -> "Path":
        """Return the path with another lead-in, at the current of its first vertex."""
        bare = self.recorded
        if lead_in is None:
            return bare
        before = lead_in.before

        current = np.concatenate([np.full(len(before), bare.current[0]), bare.current])
        current[0] += lead_in.current
        return replace(
            bare,
            dt=np.concatenate([[0.0], -np.diff(before, append=0.0), bare.dt[1:]]),
            position=np.concatenate([bare.position[0] + lead_in.position, bare.position]),
            velocity=np.concatenate([lead_in.velocity, bare.velocity]),
            acceleration=np.concatenate([lead_in.acceleration, bare.acceleration]),
            current=current,
            samples=bare.samples + len(before),
            lead_in=lead_in,
            excess=None if bare.excess is None else bare.excess.mapped(lambda series: np.pad(series, (len(before), 0))),
            temperature=None if bare.temperature is None else np.pad(bare.temperature, (len(before), 0), mode="edge"),
            _bare=bare,
        )

    def as_warm_as(self, other: "Path") -> "Path":
        """Return the path with the temperature that another one has at the same times, both without their lead-in."""
        if other.recorded.temperature is None:
            return self
        times = np.cumsum(self.dt), np.cumsum(other.recorded.dt)
        return replace(self, temperature=np.interp(*times, other.recorded.temperature))

    @property
    def fine(self) -> "Path":
        """The same path with more vertices where the recorded force changes fast, for effects that follow the force."""
        # A path that kept itself would stay in memory until the garbage collector comes by.
        return self if self.smoothed is None else self._fine

    @cached_property
    def _fine(self) -> "Path":
        assert self.smoothed is not None
        if self._bare is not None:
            return self._bare.fine.led_in(self.lead_in)
        path = replace(_along(self.smoothed, pieces(self.smoothed.run)), mains=self.mains, smoothed=self.smoothed)
        return path if self.kept is None else path.coarse(self.kept)

    def coarse(self, kept: slice) -> "Path":
        """Return the path with fewer vertices: some samples, every reversal, and wherever speed, current or force change.

        A model that is exact along a polyline gives the same force at the kept samples, but for the bend of the motion
        between them. Only a path along a recorded run can become coarse.
        """
        assert self.smoothed is not None
        if self._bare is not None:
            return self._bare.coarse(kept).led_in(self.lead_in)
        run = self.smoothed.run
        force = np.interp(np.cumsum(self.dt), run.time - run.time[0], run.force)
        keep = np.ones(len(self.dt), dtype=bool)
        keep[self.samples] = False
        for series in (self.velocity, self.current, force):
            keep |= _passes_level(series, COARSE_STEP * float(np.abs(series).max()))
        keep[self.samples[kept]] = keep[[0, -1]] = True
        return replace(
            self,
            dt=np.diff(np.cumsum(self.dt)[keep], prepend=0.0),
            position=self.position[keep],
            velocity=self.velocity[keep],
            acceleration=self.acceleration[keep],
            current=self.current[keep],
            samples=(np.cumsum(keep) - 1)[self.samples],
            kept=kept,
            excess=None if self.excess is None else self.excess.mapped(lambda series: series[keep]),
            temperature=None if self.temperature is None else self.temperature[keep],
        )


def run_path(smoothed: SmoothedRun, mains: Sequence[Line] | None = None) -> Path:
    """Return the path of a recorded run: its smoothed motion, its current without sensor noise, the hum.

    ``mains`` is the hum on its force where that is known; to find it takes longer than all else.
    """
    mains = mains_lines(smoothed.run, smoothed.current) if mains is None else mains
    return replace(_along(smoothed, 1), mains=mains, smoothed=smoothed)


def _along(smoothed: SmoothedRun, parts: int | NDArray[np.intp]) -> Path:
    """Return the path of a recorded run with its sampling intervals `subdivided_indices`."""
    time = smoothed.run.time
    path = make_path(
        subdivide(time, parts), *motion_between_samples(time, smoothed.motion, parts), subdivide(smoothed.current, parts)
    )

    def on_vertices(series: Array) -> Array:
        return np.interp(np.cumsum(path.dt), time - time[0], series)

    temperature = _without_noise(smoothed.run)
    return replace(
        path,
        samples=path.samples[subdivided_indices(len(time), parts)],
        excess=None if smoothed.excess is None else smoothed.excess.mapped(on_vertices),
        temperature=None if temperature is None else on_vertices(temperature),
    )


def _without_noise(run: Run) -> Array | None:
    """Return the temperature of a run in K averaged over `TEMPERATURE_WINDOW`: its noise is none of the fluid."""
    if run.temperature is None:
        return None
    return np.asarray(
        scipy.ndimage.uniform_filter1d(run.temperature, max(1, round(TEMPERATURE_WINDOW * run.rate)), mode="nearest")
    )


def pieces(run: Run) -> NDArray[np.intp]:
    """Return the number of pieces of each sampling interval (n - 1,) for effects that follow the force.

    After a reversal the force changes within few samples, and along a curve. Elements in series give way meanwhile, which is
    integrated to first order. Over whole intervals of recordings at 500 Hz, backlash came out 5 to 13 % too small.
    """
    jumps = np.abs(np.diff(run.force))
    largest_step = max(FORCE_STEP * _half_range(run), np.finfo(float).tiny)
    return np.clip(np.ceil(jumps / largest_step), 1, MOST_PIECES).astype(np.intp)


def _half_range(run: Run) -> float:
    return 0.5 * float(np.ptp(np.quantile(run.force, [0.01, 0.99])))


def _passes_level(series: Array, step: float) -> NDArray[np.bool_]:
    """Return the vertices (m,) at which a series has passed a multiple of ``step``, and those before a jump."""
    if step <= 0.0:
        return np.zeros(len(series), dtype=bool)
    passed = np.diff(np.floor(series / step)) != 0
    return np.asarray(np.append(False, passed) | np.append(np.abs(np.diff(series)) >= step, False))


def make_path(time: Array, position: Array, velocity: Array, acceleration: Array, current: Array) -> Path:
    """Build a path from equally long series, inserting the reversal vertices.

    A vertex stands at the instant at which the velocity, taken as linear, passes zero. Its position follows from the cubic
    that matches position and velocity at both neighbours.
    """
    before = np.flatnonzero(velocity[:-1] * velocity[1:] < 0)
    fraction = velocity[before] / (velocity[before] - velocity[before + 1])
    instant = (1 - fraction) * time[before] + fraction * time[before + 1]
    inside = (instant > time[before]) & (instant < time[before + 1])  # rounding may put it on a sample
    before, fraction = before[inside], fraction[inside]
    after = before + 1
    step = time[after] - time[before]
    turning = cubic_hermite(fraction, step, position[before], velocity[before], position[after], velocity[after])

    def between(series: Array) -> Array:
        return (1 - fraction) * series[before] + fraction * series[after]

    def insert(series: Array, vertices: Array) -> Array:
        return np.ascontiguousarray(np.insert(series, after, vertices), dtype=np.float64)

    instants = insert(time, between(time))
    is_sample = np.insert(np.ones(len(time), dtype=bool), after, False)
    return Path(
        dt=np.diff(instants, prepend=instants[0]),
        position=insert(position, turning),
        velocity=insert(velocity, np.zeros(len(before))),
        acceleration=insert(acceleration, between(acceleration)),
        current=insert(current, between(current)),
        samples=np.flatnonzero(is_sample),
    )


def cubic_hermite(fraction: Array, step: Array, x0: Array, v0: Array, x1: Array, v1: Array) -> Array:
    """Interpolate at a ``fraction`` of steps of ``step`` s, by the cubic that matches position and velocity at both ends."""
    f2, f3 = fraction**2, fraction**3
    return np.asarray(
        (2 * f3 - 3 * f2 + 1) * x0 + (f3 - 2 * f2 + fraction) * step * v0 + (3 * f2 - 2 * f3) * x1 + (f3 - f2) * step * v1
    )
