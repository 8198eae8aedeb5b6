"""What is wrong with the recordings, before physics is blamed.

Checks are kept apart by what they see: one run (`_OF_A_RUN`), or all of them (`_OF_ALL_RUNS`). What a delay of the force
against the motion means, no look at the data can say: it is an effect to be tried, not a fault.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from mrd_identification.gap.diagnosis import Finding
from mrd_runs import Run
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

# Clock and samples
GAP = 1.5
"""Median intervals; a longer one lacks at least one sample."""
LOST = 0.1
"""Share of missing or held samples from which a run is useless: hysteresis goes on in the gaps."""
BUNCHED = 0.1
"""Median intervals; two samples closer than this are hardly two readings."""
JITTER = (0.02, 0.2)
"""Median intervals rms: worth a remark; so much that sampling was not steered by hardware."""
RATES = 0.01
"""Relative; clocks of crystals agree within 100 ppm, so that this is another setting."""
LOW_RATE = 100.0
"""Hz; coil and particles follow the current within 3 to 15 ms, so at least one sample has to fall in that time."""

# Readings
NOISY = 0.1
"""Share of samples that are local extremes (white noise: 2/3). Below, values may well repeat, without noise as they are."""
CHANCE = 1e-6
"""Probability below which equal readings in a row are no coincidence."""
HELD = 4
"""Samples; fewer equal ones in a row are left to coincidence."""
CLIPPED = 0.01
"""Share of clipped samples above which force or position are useless: saturation would be found as physics."""
REVERSED = 0.15
"""Of the usual force's way from in to out; where it goes this far to both sides of its middle while the position rests at
its extreme, the rod did turn, and the position was clipped."""
COARSE = (0.01, 0.1)
"""Rms of the rounding error over the channel's standard deviation: as large as the noise of a fair sensor; useless."""
COMMANDED = 0.1
"""Share of samples at which a current changes; one that changes less often is a command in steps, not a coarse reading."""
SPIKE = 20.0
"""Noise standard deviations by which a single position leaves its neighbours; no rod does so."""
FASTEST_JUMP = 300.0
"""m/s²; nor with less than this acceleration within one sample (the bench's drive: 10 m/s²)."""
TOP_BAND = 0.8
"""Nyquist frequencies from which on the power should have fallen off."""
ALIASED = 0.01
"""Share of power above it, small noise not counted."""
SWITCHED = (0.1, 0.25, 0.2)
"""A current that spans more than this (A) and changes by this share of its span at more than this share of the samples
switches faster than it is sampled."""
UNRELATED = 0.1
"""Largest correlation of force and velocity, whatever the lag, of a force that does not respond."""
FEW_STROKES = 3
"""Up to so many, the force may be one of rest or of the current more than one of motion."""
MOVED = 1e-3
"""m of stroke from which a damper has to answer."""
LAG = 2e-3
"""s between position and accelerometer; filters of usual sensors (100 Hz and more) differ by less."""
LONGEST_LAG = 0.25
"""s that is looked for."""
AVERAGED = 0.02
"""s over which position and accelerometer are averaged for it: 8 µm of noise in positions then are 0.05 m/s²."""
ACCELEROMETER = (0.8, 1.25)
"""Gain against the position, as in `mrd_runs.motion`; outside, it is not one of the rod in m/s²."""

# Runs together
SAME_MOTION = 0.999
"""Correlation of the positions of repeats."""
REPEAT = (0.05, 0.2)
"""Relative differences of force between repeats: larger than scatter from run to run (1 to 2 %); no repeat."""
SHAPE = 0.1
"""Rest of a repeat's force, its gain and offset taken out, over the standard deviation."""
RIG_RATIO = 2.4
"""Ratio of forces at the same speed and current which no scatter, heat or remanence explains."""
RIG_FORCE = 30.0
"""N added to both before they are compared: remanence may double a small off-state force."""
OPPOSITE = -0.2
"""Dissipated work over the work that the same forces could do; a damper's is positive, at whatever usual delay."""
LARGEST_STROKE, LARGEST_CURRENT, SMALLEST_FORCE, LARGEST_FORCE = 0.5, 10.0, 5.0, 1e5
"""m, A, N, N peak to peak, of what is likely recorded in another unit (small MR dampers: 5 A, some tens of N at rest)."""
UNITS = {1e3: "kN against N", 9.80665: "kgf against N", 4.44822: "lbf against N"}

# Coverage
FEWEST_REVERSALS = 10
"""Of all runs together: before, loops cannot be told from drift."""
ONE_SPEED = 1.5
"""Ratio of the peak speeds of strokes; within it, speed and frequency do not separate effects."""
SHORT_STROKE = 2e-3
"""m; a loop of usual yield travel (0.1 to 1 mm) and lost motion is not left by shorter ones."""


@dataclass(frozen=True)
class _Channel:
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
class _View:
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
    def channels(self) -> dict[str, _Channel]:
        found = {
            "position": _Channel("position", "m", self.run.position),
            "force": _Channel("force", "N", self.run.force),
            "current": _Channel("current", "A", self.run.current),
        }
        if self.run.acceleration is not None:
            found["acceleration"] = _Channel("acceleration", "m/s²", self.run.acceleration)
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


def preflight(runs: Sequence[Run], model: DamperModel | None = None) -> tuple[Finding, ...]:
    """Look for what is wrong with recordings, and for what they cannot tell.

    Parameters
    ----------
    runs : sequence of Run
    model : DamperModel, optional
        Whose parameters are to be identified from them.

    Returns
    -------
    tuple of Finding
        Faults, limitations, remarks, in this order.
    """
    views = [_View(run) for run in runs]
    found = [finding for view in views for check in _OF_A_RUN for finding in check(view)]
    found += [finding for check in _OF_ALL_RUNS for finding in check(views)]
    found += _coverage(views, model)
    return tuple(sorted(found, key=lambda finding: ("fault", "limitation", "remark").index(finding.severity)))


def _stretches(mask: Mask) -> tuple[Indices, Indices]:
    """First and last index of each stretch of a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return edges[::2], edges[1::2] - 1


def _equal_neighbours(values: Array) -> tuple[Indices, Indices]:
    """First and last sample of each stretch of equal readings."""
    first, last = _stretches(np.diff(values) == 0)
    return first, last + 1


def _milli(value: float) -> str:
    return f"{1e3 * value:.3g}"


def _overlap(one: Array, other: Array, shift: int) -> tuple[Array, Array]:
    """The parts of two series that lie at the same time when the other is ``shift`` samples late."""
    count = min(len(one) + min(shift, 0), len(other) - max(shift, 0), len(one), len(other))
    return one[max(-shift, 0) :][:count], other[max(shift, 0) :][:count]


def _correlations(one: Array, other: Array, reach: int | None = None) -> tuple[Indices, Array]:
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


# ---- One run


def _clock(view: _View) -> Iterator[Finding]:
    intervals = np.diff(view.run.time) / view.interval
    usual = (intervals < GAP) & (intervals > BUNCHED)
    late = intervals[intervals >= GAP]
    missing = int(np.sum(np.round(late) - 1))
    if missing:
        share = missing / (missing + len(view.run))
        yield view.finding(
            "gap", "fault" if share > LOST else "limitation", "time",
            f"{missing} samples ({100 * share:.2g} %) are missing in {len(late)} gaps, the longest {late.max():.1f} "
            f"intervals, expected none; what the damper did there is lost: look at the DAQ"
            f"{' and record it again' if share > LOST else ''}",
        )
    bunched = int(np.sum(intervals <= BUNCHED))
    if bunched:
        yield view.finding(
            "clock", "limitation", "time",
            f"{bunched} samples follow the one before within {BUNCHED:g} intervals, expected equal intervals of "
            f"{_milli(view.interval)} ms; look for samples written twice",
        )
    jitter = float(np.std(intervals[usual])) if usual.any() else 0.0
    if jitter > JITTER[0]:
        yield view.finding(
            "clock", "limitation" if jitter > JITTER[1] else "remark", "time",
            f"intervals scatter by {100 * jitter:.2g} % rms, expected less than {100 * JITTER[0]:g} %; if these are not the "
            "times of sampling but of writing, forces near reversals carry that error: sample by a hardware clock",
        )


def _holds(view: _View) -> Iterator[Finding]:
    """Readings that stay while they cannot."""
    for channel in view.channels.values():
        values = channel.values
        first, last = _equal_neighbours(values)
        if view.slow and channel.name != "position":
            continue  # a plateau may be as short as this
        if not len(first) or np.ptp(values) == 0:
            continue
        length = last - first + 1
        refreshed = _refreshed_every(channel, length) if channel.name != "current" else 0
        if refreshed:
            rate = view.run.rate / refreshed
            yield view.finding(
                "clock", "limitation", channel.name,
                f"stays the same for {refreshed} samples at a time: it is refreshed at {rate:.3g} Hz, expected "
                f"{view.run.rate:.4g} Hz like the samples; set the sensor's own rate or record at {rate:.3g} Hz",
            )
            continue
        held = _jumps(channel, first, last) if channel.name == "position" else _unlikely(channel, first, last)
        count = int(length[held].sum() - held.sum())
        if count:
            share = count / len(values)
            useless = share > LOST and channel.name in ("position", "force")
            yield view.finding(
                "gap", "fault" if useless else "limitation", channel.name,
                f"{count} samples ({100 * share:.2g} %) repeat the one before, up to {length[held].max()} in a row, where "
                f"readings change; expected a new reading each: look at the channel's connection"
                f"{' and record it again' if useless else ''}",
            )


def _refreshed_every(channel: _Channel, length: Indices) -> int:
    """Samples between new readings of a channel whose readings all stay equally long; 0 for others."""
    short = length[length <= 20]
    if len(short) < max(20, len(channel.values) / 40):
        return 0
    usual = int(np.bincount(short).argmax())
    changes = np.abs(np.diff(channel.values))
    large = np.median(changes[changes > 0]) > 3 * channel.step
    regular = np.mean(np.abs(length - usual) <= 0) > 0.6 and usual * np.sum(short == usual) > 0.4 * len(channel.values)
    return usual if large and regular else 0


def _unlikely(channel: _Channel, first: Indices, last: Indices) -> Mask:
    """Which equal readings are longer than the noise of the channel would let them be."""
    if not channel.noisy or channel.quiet <= 2 * channel.step:
        return np.zeros(len(first), dtype=bool)
    values = channel.values
    # Two normal readings fall on one step with this probability at most.
    equal = max(channel.step / (2 * np.sqrt(np.pi) * channel.quiet), 1e-3)
    long = last - first + 1 > max(HELD, 1 + np.log(CHANCE / len(values)) / np.log(equal))
    # On a plateau readings change by a step or two, and at the ends of the range it is clipping.
    entry = np.abs(values[first] - values[np.maximum(first - 1, 0)])
    away = np.abs(values[np.minimum(last + 1, len(values) - 1)] - values[last])
    inner = (values[first] != values.max()) & (values[first] != values.min())
    return np.asarray(long & inner & (np.maximum(entry, away) > 2.5 * channel.step))


def _jumps(channel: _Channel, first: Indices, last: Indices) -> Mask:
    """Which equal readings amid motion are followed by the jump that makes up for them."""
    values, least = channel.values, max(5 * channel.step, 8 * channel.noise)
    inside = (first >= 3) & (last < len(values) - 1) & (last - first + 1 >= 3)
    start, end = np.where(inside, first, 3), np.where(inside, last, 3)
    slope = (values[start] - values[start - 3]) / 3
    made_up = (values[end + 1] - values[end]) / np.where(slope == 0, np.inf, slope * (end - start + 1))
    return np.asarray(inside & (np.abs(values[end + 1] - values[end]) > least) & (made_up > 0.6) & (made_up < 1.7))


def _spikes(view: _View) -> Iterator[Finding]:
    channel = view.channels["position"]
    values = channel.values
    around = np.median(np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]]), axis=0)
    away = np.abs(values[2:-2] - around)
    least = max(SPIKE * channel.noise, 5 * channel.step, FASTEST_JUMP * view.interval**2)
    # A corner of the motion leaves its neighbours by about the way between two samples.
    count = int(np.sum(away > least + 3 * view.speed * view.interval))
    if count:
        yield view.finding(
            "gap", "limitation", "position",
            f"{count} samples jump away from their neighbours and back, by up to {_milli(away.max())} mm, as no rod does; "
            "the damper's hysteresis would follow them: look at the sensor's connection, remove these samples",
        )


def _clipping(view: _View) -> Iterator[Finding]:
    for channel in view.channels.values():
        for side, top in (("highest", channel.values.max()), ("lowest", channel.values.min())):
            if channel.name == "current" and abs(top) < 0.02:
                continue  # a supply that is off reads about zero
            clipped = _flat_top(view, channel, float(top))
            share = clipped / len(view.run)
            if not clipped:
                continue
            useless = share > CLIPPED and channel.name in ("position", "force")
            yield view.finding(
                "clipping", "fault" if useless else "limitation", channel.name,
                f"{clipped} samples ({100 * share:.2g} %) stay at the {side} reading, {top:.4g} {channel.unit}, where "
                "others scatter: it is beyond the range of its sensor or converter; widen that range"
                + (" and record it again" if useless else ""),
            )


def _flat_top(view: _View, channel: _Channel, top: float) -> int:
    """Samples in a flat top that no other level shares; 0 without one."""
    # Behind a clipped amplifier the converter's own noise is left, a few of its steps.
    band = 0.0 if view.slow else min(4 * channel.step, 0.25 * channel.loud)
    first, last = _stretches(np.abs(channel.values - top) <= band)
    length = last - first + 1
    if channel.name == "position":
        return _clipped_turns(view, first, last)
    if not channel.noisy:
        return 0
    elsewhere = np.subtract(*_equal_neighbours(channel.values)[::-1]) + 1
    at_top = np.abs(channel.values[_equal_neighbours(channel.values)[0]] - top) <= band
    other = int(max(elsewhere[~at_top & (elsewhere > 0)], default=1))
    long = length >= max(HELD, 2 * other)
    return int(length[long].sum()) if long.sum() >= 2 or length[long].sum() >= 5 * HELD else 0


def _clipped_turns(view: _View, first: Indices, last: Indices) -> int:
    """Samples of a position that stands still at its extreme while the force reverses, so that the rod did."""
    position, force = view.channels["position"], view.run.force
    # A turn comes to rest gradually, over steps not much larger than those of the digits.
    entry = np.abs(position.values[first] - position.values[first - 1])
    kept = (first > 0) & (last - first >= HELD) & (entry > np.maximum(4 * position.step, 4 * position.noise))
    first, last = first[kept], last[kept]
    if len(first) < 2:
        return 0
    moving = np.abs(view.run.velocity) > 0.2 * view.speed
    low, high = (np.median(force[moving & way]) for way in (view.run.velocity < 0, view.run.velocity > 0))
    outwards = 1 if position.values[first[0]] > np.median(position.values) else -1
    before, after = (
        outwards * float(np.median(force[at]) - 0.5 * (low + high)) for at in (first - 1, first + 4 * (last - first) // 5)
    )
    if min(before, -after) < REVERSED * (high - low):
        return 0
    return int(np.sum(last - first + 1))


def _quantisation(view: _View) -> Iterator[Finding]:
    for channel in view.channels.values():
        spread = float(np.std(channel.values))
        if not channel.step or not spread:
            continue
        if channel.name == "current" and (not view.varies or np.mean(np.diff(channel.values) != 0) < COMMANDED):
            continue
        if channel.name == "position" and not view.stroke:
            continue
        error = channel.step / np.sqrt(12.0) / spread
        if error < COARSE[0]:
            continue
        needed = channel.name in ("position", "force")
        severity = "fault" if needed and error > COARSE[1] else "limitation" if needed else "remark"
        yield view.finding(
            "quantisation", severity, channel.name,
            f"is read in steps of {channel.step:.3g} {channel.unit}, {np.ptp(channel.values) / channel.step:.0f} over its "
            f"span: rounding is {100 * error:.2g} % of its standard deviation, expected below {100 * COARSE[0]:g} %; use a "
            "smaller range of the converter",
        )


def _dead(view: _View) -> Iterator[Finding]:
    run, force, position = view.run, view.channels["force"], view.channels["position"]
    if view.stroke > MOVED:
        if np.ptp(run.force) <= 2 * force.step:
            yield view.finding(
                "dead_channel", "fault", "force",
                f"stays at {run.force[0]:.4g} N while the rod moves over {_milli(view.stroke)} mm; expected a damper's "
                "force: look at the load cell and its channel",
            )
        elif len(view.strokes) > FEW_STROKES:
            related = float(np.abs(_correlations(run.velocity, signal.detrend(run.force))[1]).max())
            if related < UNRELATED:
                yield view.finding(
                    "dead_channel", "fault", "force",
                    f"does not respond to the motion: correlation with the velocity at most {related:.2g} at any lag, "
                    f"expected above {UNRELATED:g}; look at the load cell, its channel, and whether the damper is mounted",
                )
    elif np.std(position.values) <= 1.3 * position.noise or np.ptp(position.values) <= 2.5 * position.step:
        low, high = np.quantile(run.force, [0.01, 0.99])
        sides = np.sign(run.force - 0.5 * (low + high))[np.abs(run.force - 0.5 * (low + high)) > 0.25 * (high - low)]
        if high - low > max(10 * force.noise, SMALLEST_FORCE) and np.count_nonzero(np.diff(sides)) > FEW_STROKES:
            # Steps of the current move the force of a rod at rest, too.
            by_current = view.varies and np.corrcoef(run.current, run.force)[0, 1] ** 2 > 0.5
            yield view.finding(
                "dead_channel", "limitation" if by_current else "fault", "position",
                f"rests at {_milli(run.position[0])} mm while the force swings over {high - low:.3g} N; expected the "
                "motion that causes it: look at the position sensor",
            )
    still = run.acceleration is not None and np.ptp(run.acceleration) <= 2 * view.channels["acceleration"].step
    if still and view.stroke > MOVED:
        yield view.finding(
            "dead_channel", "remark", "acceleration", "is constant while the rod moves: of no use; look at the sensor"
        )


def _aliasing(view: _View) -> Iterator[Finding]:
    for name in ("position", "force"):
        values = view.channels[name].values
        if not (view.stroke if name == "position" else np.ptp(values)):
            continue
        _, density = signal.periodogram(values, window="hann", detrend="linear")
        # What is white and small is noise; of what is as large as the signal, no digits tell what it is.
        noise = view.channels[name].noise
        white = 2 * noise**2 if noise < 0.1 * np.std(values) else 0.0
        share = float(np.sum(density[int(TOP_BAND * len(density)) :] - white) / density.sum())
        if share > ALIASED:
            yield view.finding(
                "aliasing", "limitation", name,
                f"{100 * share:.2g} % of its power lies between {0.5 * TOP_BAND * view.run.rate:.3g} Hz and half the sample "
                f"rate, expected below {100 * ALIASED:g} %: noise, or what is faster and folded there; sample faster or "
                "filter before sampling",
            )
    current = view.run.current
    span = float(np.subtract(*np.quantile(current, [0.99, 0.01])))
    often = float(np.mean(np.abs(np.diff(current)) > SWITCHED[1] * span)) if span > SWITCHED[0] else 0.0
    if often > SWITCHED[2]:
        yield view.finding(
            "aliasing", "limitation", "current",
            f"switches every {1 / often:.2g} samples, expected {1 / SWITCHED[2]:g} at least: what it was in between is "
            "unknown; sample faster or switch more slowly",
        )


def _accelerometer(view: _View) -> Iterator[Finding]:
    """Gain and lag of the accelerometer against the position.

    The second difference of positions is exactly the acceleration's average over the samples between, weighted by a
    triangle: both are compared after the same filter, without a derivative.
    """
    run = view.run
    if run.acceleration is None or view.stroke < MOVED or np.ptp(run.acceleration) == 0:
        return
    if np.ptp(np.diff(run.time)) > 0.5 * view.interval:
        return
    width = max(1, round(AVERAGED * run.rate))
    triangle = np.bartlett(2 * width + 1)[1:-1] / width
    read = np.convolve(run.acceleration, triangle, "valid")
    position = run.position
    true = (position[2 * width :] - 2 * position[width:-width] + position[: -2 * width]) / (width * view.interval) ** 2
    read, true = read[1:-1] - read[1:-1].mean(), true - true.mean()
    if len(true) < 10 * width or np.std(true) < 5 * 2.45 * view.channels["position"].noise / (width * view.interval) ** 2:
        return
    reach = min(len(true) // 4, round(LONGEST_LAG * run.rate))
    shifts, related = _correlations(true, read, reach)
    # Of the lags that a periodic motion allows, the smallest.
    near = shifts[related > related.max() - 0.01]
    shift = int(near[np.argmin(np.abs(near))])
    if related[reach] < -0.9 or related.max() < 0.5:
        yield view.finding(
            "rig", "limitation", "acceleration",
            f"does not follow the motion (correlation {related[reach]:.2g} with the acceleration of the position, expected "
            "1); is it the rod's, > 0 where it extends faster?",
        )
        return
    a, b = _overlap(true, read, shift)
    index, late = np.arange(len(a), dtype=float), 0.0
    for _ in range(4):
        moved = np.interp(index - late, index, a)
        design = np.stack([moved, -np.gradient(moved), np.ones_like(a)], axis=1)
        (gain, slope, _), *_ = np.linalg.lstsq(design, b, rcond=None)
        late = float(np.clip(late + slope / gain, -reach, reach))
    rest = b - design @ [gain, slope, b.mean()]
    # Averages that overlap are as good as one in each width.
    error = float(np.std(rest) * np.sqrt(2 * width) / (abs(gain) * np.linalg.norm(design[:, 1]))) * view.interval
    lag = (shift + late) * view.interval
    if not ACCELEROMETER[0] < gain < ACCELEROMETER[1] and related.max() > 0.95:
        yield view.finding(
            "rig", "limitation", "acceleration",
            f"is {gain:.3g} times the acceleration of the position, expected {ACCELEROMETER[0]:g} to {ACCELEROMETER[1]:g}; "
            f"is it the rod's{', in g instead of m/s²' if 0.08 < gain < 0.125 else ', in m/s²'}?",
        )
    if abs(lag) > LAG + 2 * error and abs(lag) > 4 * error:
        late_one, early = ("acceleration", "position") if lag > 0 else ("position", "acceleration")
        yield view.finding(
            "lag", "limitation", late_one,
            f"comes {_milli(abs(lag))} ± {_milli(1.96 * error)} ms after {early}, expected less than {_milli(LAG)} ms: "
            "velocities from both are wrong; sample all channels at once, with the same filters",
        )


def _units(view: _View) -> Iterator[Finding]:
    run = view.run
    current, force = float(np.abs(run.current).max()), float(np.ptp(run.force))
    if np.ptp(run.position) > LARGEST_STROKE:
        yield view.finding(
            "rig", "fault", "position",
            f"spans {np.ptp(run.position):.3g}, expected at most {LARGEST_STROKE:g} m; is it in mm? Convert it to m",
        )
    if current > LARGEST_CURRENT:
        yield view.finding(
            "rig", "fault", "current",
            f"reaches {current:.3g}, expected at most {LARGEST_CURRENT:g} A; is it in mA? Convert it to A",
        )
    # A dead force says so itself.
    if force > LARGEST_FORCE or (view.stroke > MOVED and 2 * view.channels["force"].step < force < SMALLEST_FORCE):
        small = force < SMALLEST_FORCE
        yield view.finding(
            "rig", "fault", "force",
            f"spans {force:.3g}, expected {SMALLEST_FORCE:g} to {LARGEST_FORCE:g} N; is it in "
            f"{'kN or V' if small else 'mN'}? Convert it to N",
        )


# ---- All runs


def _rates(views: Sequence[_View]) -> Iterator[Finding]:
    rates = np.array([1 / view.interval for view in views])
    if rates.max() > (1 + RATES) * rates.min():
        yield Finding(
            "clock", "remark",
            f"runs are sampled at {rates.min():.4g} to {rates.max():.4g} Hz; what is fast shows in the faster ones only",
        )
    slow = [view for view in views if view.slow]
    if slow:
        longest = max(view.interval for view in slow)
        travel = max(view.speed * view.interval for view in slow)
        which = "all runs" if len(slow) == len(views) else ", ".join(view.run.name for view in slow)
        yield Finding(
            "aliasing", "limitation",
            f"{which}: one sample every {_milli(longest)} ms, in which the rod moves up to {_milli(travel)} mm; time "
            "constants and lost travel below about that, and anything above "
            f"{0.5 / longest:.3g} Hz, cannot be seen: sample at {LOW_RATE:g} Hz at least, better 1 kHz",
            slow[0].run.name if len(slow) == 1 else "",
        )


def _signs(views: Sequence[_View]) -> Iterator[Finding]:
    moved = [view for view in views if view.stroke > MOVED and len(view.strokes) > FEW_STROKES]
    opposite = [view for view in moved if _dissipation(view) < OPPOSITE]
    text = (
        "the damper would drive the rod: force and motion have opposite signs, expected force > 0 to resist extension and "
        "position > 0 to extend; turn the sign of {}"
    )
    if opposite and len(opposite) == len(moved):
        yield Finding("rig", "fault", text.format("the force (or of the position) in all runs"), channel="force")
        return
    for view in opposite:
        yield view.finding("rig", "fault", "force", text.format("this run's force or position, the others' are right"))


def _dissipation(view: _View) -> float:
    """Work done on the damper over what the same forces and ways could do at most."""
    force = view.run.force - view.run.force.mean()
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(view.run.position)
    # Noise of the position does work to and fro: count it over stretches.
    count = max(1, len(work) // 200)
    parts = np.array([part.sum() for part in np.array_split(work, max(1, len(work) // count))])
    total = float(np.abs(parts).sum())
    return float(parts.sum()) / total if total else 0.0


CELL = 0.02
"""Share of a run's samples from which they tell a force, not a transition."""
SPEEDS = np.array([0.02, 0.04, 0.08, 0.16, 0.32, 0.64])
"""m/s; edges of the cells in which forces of runs are compared, above the speeds at which hysteresis rules."""
CURRENTS = np.array([-np.inf, *np.arange(0.05, 3.0, 0.1), np.inf])
"""A; edges around round set-points."""


def _forces(view: _View) -> Array:
    """Half the force between out and in stroke, N, (speeds, currents); nan where there are few samples."""
    speed = np.digitize(np.abs(view.run.velocity), SPEEDS) - 1
    current = np.digitize(np.abs(view.run.current), CURRENTS) - 1
    shape = (len(SPEEDS) - 1, len(CURRENTS) - 1)
    found = np.full((2, *shape), np.nan)
    inside = (speed >= 0) & (speed < shape[0])
    cell = np.where(inside, speed * shape[1] + current, -1)
    for side, mask in enumerate((view.run.velocity > 0, view.run.velocity < 0)):
        counts = np.bincount(cell[inside & mask], minlength=shape[0] * shape[1])
        for index in np.flatnonzero(counts >= max(20, CELL * len(speed))):
            found[side].flat[index] = np.median(view.run.force[mask & (cell == index)])
    return np.asarray(0.5 * (found[0] - found[1]))


def _rigs(views: Sequence[_View]) -> Iterator[Finding]:
    """Runs whose forces at the same speed and current differ beyond any scatter."""
    # Short strokes do not leave the damper's hysteresis.
    moved = [view for view in views if view.stroke > 2 * SHORT_STROKE]
    forces = [np.abs(_forces(view)) for view in moved]
    while len(moved) > 1:
        compared = [_against(forces[:index] + forces[index + 1 :], own) for index, own in enumerate(forces)]
        # One strange run makes others look strange that share cells with it alone.
        worst = max(range(len(moved)), key=lambda index: compared[index][0])
        strangeness, ratio = compared[worst]
        if not strangeness:
            return
        factor = max(ratio, 1 / max(ratio, 1e-9))
        unit = next((f" ({text}?)" for known, text in UNITS.items() if 0.8 < factor / known < 1.25), "")
        yield moved.pop(worst).finding(
            "rig", "fault", "force",
            f"is {ratio:.3g} times that of the other runs at the same speed and current, expected within a factor "
            f"{RIG_RATIO:g}{unit}; is it another damper, load cell or unit? Diagnose rigs one by one",
        )
        forces.pop(worst)


def _against(others: Sequence[Array], own: Array) -> tuple[int, float]:
    """How many other runs a run's forces (speeds, currents) disagree with in all, and their ratio."""
    rest = np.stack(others)
    shared = np.isfinite(own) & np.isfinite(rest).any(axis=0)
    if not shared.any():
        return 0, 1.0
    usual = np.nanmedian(rest[:, shared], axis=0)
    ratio, size = float(own[shared] @ usual / (usual @ usual + 1e-12)), float(np.sqrt(np.mean(usual**2)))
    if abs(np.log((ratio * size + RIG_FORCE) / (size + RIG_FORCE))) < np.log(RIG_RATIO):
        return 0, ratio
    return int(np.isfinite(rest[:, shared]).any(axis=1).sum()), ratio


def _duplicates(views: Sequence[_View]) -> Iterator[Finding]:
    """Runs that are, for the most part, the same samples."""
    for one, other in itertools.combinations(views, 2):
        length = min(len(one.run), len(other.run))
        middle = len(other.run) // 2
        places = np.flatnonzero(one.run.force == other.run.force[middle])
        for place in places[np.argsort(np.abs(places - middle))][:20]:
            a, b = _overlap(one.run.force, other.run.force, middle - int(place))
            if len(a) < 0.5 * length or not np.array_equal(a, b) or not np.ptp(a):
                continue
            # Without any noise, two simulations of one experiment are the same too.
            others = (channel.noisy for name, channel in one.channels.items() if name != "force")
            recorded = one.channels["force"].noisy and (one.channels["position"].step > 0 or any(others))
            yield other.finding(
                "repeat", "fault" if recorded else "limitation", "force",
                f"is the same recording as {one.run.name}: {len(a)} samples of its force are equal to the last digit; "
                + ("give each recording once" if recorded else "without noise, it says nothing more"),
            )
            break


def _repeats(views: Sequence[_View]) -> Iterator[Finding]:
    """Pairs of runs with the same motion and current, or which claim to have them."""
    for one, other in itertools.combinations(views, 2):
        if abs(one.interval / other.interval - 1) > RATES or not one.stroke or not other.stroke:
            continue
        claimed = bool(one.run.info.get("experiment")) and one.run.info["experiment"] == other.run.info.get("experiment")
        if not 0.9 < one.stroke / other.stroke < 1.1:
            alike, shift = 0.0, 0
        else:
            alike, shift = _alignment(one.run.position, other.run.position)
        if alike < SAME_MOTION:
            if claimed:
                yield other.finding(
                    "repeat", "limitation", "position",
                    f"claims the experiment of {one.run.name} but moves otherwise (correlation {alike:.3f}, expected "
                    f"{SAME_MOTION:g}; strokes {_milli(other.stroke)} and {_milli(one.stroke)} mm); it is no repeat of it: "
                    "look at the servo",
                )
            continue
        yield from _compared(one, other, shift, claimed)


def _alignment(one: Array, other: Array) -> tuple[float, int]:
    """Correlation of two series at the shift that suits them best, and that shift."""
    shifts, related = _correlations(one, other)
    best = int(np.argmax(related))
    # Of the peaks of a periodic motion, the nearest.
    peaks = np.flatnonzero((related[1:-1] >= related[:-2]) & (related[1:-1] >= related[2:])) + 1
    peaks = peaks[related[peaks] > related[best] - 1e-4]
    best = int(peaks[np.argmin(np.abs(shifts[peaks]))]) if len(peaks) else best
    shift = int(shifts[best])
    return float(np.corrcoef(*_overlap(one, other, shift))[0, 1]), shift


def _compared(one: _View, other: _View, shift: int, claimed: bool) -> Iterator[Finding]:
    """What differs between two runs of the same motion."""
    currents = _overlap(one.run.current, other.run.current, shift)
    span = max(0.01, *(float(np.ptp(current)) for current in currents), *(0.5 * float(np.abs(c).max()) for c in currents))
    different = float(np.sqrt(np.mean((currents[0] - currents[1]) ** 2)))
    if different > 0.1 * span + 4 * (one.channels["current"].noise + other.channels["current"].noise):
        if claimed:
            yield other.finding(
                "repeat", "limitation", "current",
                f"claims the experiment of {one.run.name} and moves like it, but its current differs by {different:.2g} A "
                "rms; it is no repeat of it: look at the coil's supply",
            )
        return
    first, second = _overlap(one.run.force, other.run.force, shift)
    # Align them within a sample: at reversals the force of one sample is another than that of the next.
    a, b = _overlap(one.run.position, other.run.position, shift)
    slope = np.gradient(a)
    late = -float(np.clip(slope @ (b - b.mean() - a + a.mean()) / (slope @ slope), -1, 1))
    index = np.arange(len(second), dtype=float)
    inner = slice(2, -2)
    second = np.interp(index + late, index, second)[inner]
    first = first[inner]
    spread = float(np.std(first))
    gain, offset = np.polyfit(first - first.mean(), second, 1)
    offset -= first.mean()
    rest = float(np.std(second - np.polyval([gain, second.mean()], first - first.mean())))
    noise = float(np.hypot(one.channels["force"].noise, other.channels["force"].noise))
    differs = []
    if abs(gain - 1) > REPEAT[0]:
        differs.append(f"its force is {gain:.3g} times as large")
    if abs(offset) > max(REPEAT[0] * spread, 5 * noise):
        differs.append(f"it is {offset:.3g} N off")
    if rest > max(SHAPE * spread, 6 * noise):
        differs.append(f"its shape differs by {rest:.3g} N rms")
    if differs:
        much = abs(gain - 1) > REPEAT[1] or abs(offset) > REPEAT[1] * spread or rest > SHAPE * spread
        yield other.finding(
            "repeat", "limitation" if much else "remark", "force",
            f"moves like {one.run.name} at the same current, but {' and '.join(differs)}, beside a noise of {noise:.2g} N; "
            "expected the same within a few %: something changed between them, such as temperature, mounting or gain",
        )


def _coverage(views: Sequence[_View], model: DamperModel | None) -> Iterator[Finding]:
    current = np.array([[view.run.current.min(), view.run.current.max(), view.run.current.mean()] for view in views])
    changing = [view for view in views if view.varies]
    dependent = f", nor how {model.id} depends on the current" if model is not None and model.laws else ""
    if not changing and np.ptp(current[:, 2]) < max(0.01, 0.02 * float(np.abs(current).max())):
        yield Finding(
            "coverage", "limitation",
            f"the current never changes ({current[:, 2].mean():.3g} A): effects of the magnetics stage cannot be tested"
            f"{dependent}; record runs with steps of the current",
            channel="current",
        )
    elif not changing:
        yield Finding(
            "coverage", "limitation",
            "the current is constant within every run: how the force follows a change of it (lag, hysteresis) cannot be "
            "tested; record a run with steps of the current",
            channel="current",
        )
    reversals = sum(len(view.strokes) - 1 for view in views)
    for view in views:
        if view.stroke < MOVED / 10:
            yield view.finding("coverage", "limitation", "position", "the rod rests: says nothing of the damper in motion")
        elif len(view.strokes) < 3:
            yield view.finding(
                "coverage", "limitation", "position",
                f"is shorter than one stroke to and fro ({len(view.strokes) - 1} reversals): no loop; record longer",
            )
    if all(len(view.strokes) < 3 for view in views):
        yield Finding(
            "coverage", "fault", "no run holds a stroke to and fro: there is no loop to compare; record longer",
            channel="position",
        )
    elif reversals < FEWEST_REVERSALS:
        yield Finding(
            "coverage", "limitation",
            f"{reversals} reversals in all runs, expected {FEWEST_REVERSALS} at least: effects at reversals (hysteresis, "
            "play, compliance) rest on too little; record longer",
            channel="position",
        )
    stroke = max(view.stroke for view in views)
    if stroke < SHORT_STROKE:
        yield Finding(
            "coverage", "limitation",
            f"no stroke is longer than {_milli(stroke)} mm, expected {_milli(SHORT_STROKE)} mm at least: the damper may "
            "never leave its pre-yield loop; record longer strokes",
            channel="position",
        )
    peaks, frequencies = _peaks_and_frequencies(views)
    if len(peaks) and np.quantile(peaks, 0.95) < ONE_SPEED * np.quantile(peaks, 0.05):
        several = np.quantile(frequencies, 0.95) > ONE_SPEED * np.quantile(frequencies, 0.05)
        yield Finding(
            "coverage", "limitation",
            f"all strokes peak at one speed ({_milli(float(np.median(peaks)))} mm/s): what grows with "
            f"{'it' if several else 'it, or with frequency,'} cannot be told from what does not; record other speeds",
            channel="position",
        )
    lowest = min(float(view.run.position.min()) for view in views)
    highest = max(float(view.run.position.max()) for view in views)
    at = f" at {frequencies.min():.2g} to {frequencies.max():.2g} Hz" if len(frequencies) else ""
    yield Finding(
        "coverage", "remark",
        f"{len(views)} runs, {sum(view.run.duration for view in views):.4g} s: position {_milli(lowest)} to "
        f"{_milli(highest)} mm, speed up to {_milli(max(view.speed for view in views))} mm/s, current {current.min():.3g} "
        f"to {current.max():.3g} A, {reversals} reversals{at}",
    )


def _peaks_and_frequencies(views: Sequence[_View]) -> tuple[Array, Array]:
    """Peak speed in m/s and frequency in Hz of every full stroke."""
    peaks, frequencies = [np.empty(0)], [np.empty(0)]
    for view in views:
        if len(view.strokes) > 2:
            peaks.append(np.maximum.reduceat(np.abs(view.run.velocity), view.strokes)[1:-1])
            frequencies.append(0.5 / np.diff(view.run.time[view.strokes])[1:])
    return np.concatenate(peaks), np.concatenate(frequencies)


_OF_A_RUN: tuple[Callable[[_View], Iterator[Finding]], ...] = (
    _units, _dead, _clock, _holds, _spikes, _clipping, _quantisation, _aliasing, _accelerometer,
)
_OF_ALL_RUNS: tuple[Callable[[Sequence[_View]], Iterator[Finding]], ...] = (_rates, _signs, _rigs, _duplicates, _repeats)
