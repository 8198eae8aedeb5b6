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
REVERSED = 0.6
"""Of the force's usual swing; a position that stands still while the force reverses by as much has been clipped."""
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
ALIASED = {"position": 1e-3, "force": 1e-3, "current": 0.05}
"""Share of power above it. Steps of a current fall off slowly; 5 % mean that it switches within two or three samples."""
UNRELATED = 0.1
"""Largest correlation of force and velocity, whatever the lag, of a force that does not respond."""
MOVED = 1e-3
"""m of stroke from which a damper has to answer."""
LAG = 2e-3
"""s between position and accelerometer; filters of usual sensors (100 Hz and more) differ by less."""
ACCELEROMETER = (0.8, 1.25)
"""Gain against the position, as in `mrd_runs.motion`; outside, it is not one of the rod in m/s²."""

# Runs together
SAME_MOTION = 0.999
"""Correlation of the positions of repeats."""
REPEAT = (0.05, 0.2)
"""Relative differences of force between repeats: larger than scatter from run to run (1 to 2 %); no repeat."""
SHAPE = 0.1
"""Rest of a repeat's force, its gain and offset taken out, over the standard deviation."""
RIG_RATIO = 2.0
"""Ratio of forces at the same speed and current which no scatter, heat or remanence explains."""
RIG_FORCE = 50.0
"""N added to both before they are compared: what remanence and friction may add to a small off-state force."""
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

    ``step`` is the common step of its values (0: none), ``noise`` the standard deviation of what is white in it.
    """

    name: str
    unit: str
    values: Array

    @cached_property
    def step(self) -> float:
        levels = np.unique(self.values)
        gaps = np.diff(levels)
        gaps = gaps[gaps > 1e-12 * max(np.abs(levels[0]), np.abs(levels[-1]))] if len(gaps) else gaps
        if not len(gaps):
            return 0.0
        step = float(gaps.min())
        whole = np.abs(gaps / step - np.round(gaps / step)) < 0.02
        return step if np.mean(whole) > 0.99 and step * len(self.values) > 1e-3 * np.ptp(self.values) else 0.0

    @cached_property
    def noise(self) -> float:
        # Third differences pass white noise with 20 times its variance and next to nothing of what is slower.
        return float(1.4826 * np.median(np.abs(np.diff(self.values, 3))) / np.sqrt(20.0))

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
        return spread if spread > 10 * max(position.noise, position.step) else 0.0

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
        return bool(high - low > max(8 * noise, 2e-3))

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
            f"{missing} samples ({100 * share:.2g} %) are missing in {len(late)} gaps, the longest {late.max():.1f} intervals, "
            f"expected none; what the damper did there is lost: {'record it again' if share > LOST else 'look at the DAQ'}",
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
        repeated = float(np.mean(np.diff(values) == 0))
        coincidence = 1 + np.log(CHANCE / len(values)) / np.log(repeated)
        held = np.zeros(len(first), dtype=bool)
        if channel.noisy and channel.noise > 2 * channel.step:
            held = length > max(HELD, coincidence)
            # At the ends of the range it is clipping.
            held &= (values[first] != values.max()) & (values[first] != values.min())
        elif channel.name == "position":
            held = _jumps(channel, first, last)
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
            f"{count} samples jump away from their neighbours and back, by up to {_milli(away.max())} mm, as no rod does; the "
            "damper's hysteresis would follow them: look at the sensor's connection, remove these samples",
        )


def _clipping(view: _View) -> Iterator[Finding]:
    for channel in view.channels.values():
        for side, top in (("highest", channel.values.max()), ("lowest", channel.values.min())):
            if channel.name == "current" and top == 0.0:
                continue  # a supply that is off reads zero
            clipped = _flat_top(view, channel, float(top))
            share = clipped / len(view.run)
            if not clipped:
                continue
            useless = share > CLIPPED and channel.name in ("position", "force")
            yield view.finding(
                "clipping", "fault" if useless else "limitation", channel.name,
                f"{clipped} samples ({100 * share:.2g} %) stay at the {side} reading, {top:.4g} {channel.unit}, where others "
                "scatter: it is beyond the range of its sensor or converter; widen that range"
                + (" and record it again" if useless else ""),
            )


def _flat_top(view: _View, channel: _Channel, top: float) -> int:
    """Samples in a flat top that no other level shares; 0 without one."""
    # Behind a clipped amplifier the converter's own noise is left, a few of its steps.
    band = min(4 * channel.step, 0.25 * channel.noise)
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
    inside = (first > 0) & (last < len(force) - 1) & (last - first >= 2)
    first, last = first[inside], last[inside]
    # A turn comes to rest gradually, over steps not much larger than those of the digits.
    entry = np.abs(position.values[first] - position.values[first - 1])
    abrupt = entry > np.maximum(4 * position.step, 4 * position.noise)
    if abrupt.sum() < 2:
        return 0
    swing = 2 * float(np.median(np.abs(force - np.median(force))))
    upper = position.values[first] > np.median(position.values)
    fall = np.where(upper, 1, -1) * (force[first - 1] - force[last])
    if np.median(fall[abrupt]) < REVERSED * swing:
        return 0
    return int(np.sum(last[abrupt] - first[abrupt] + 1))


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
            f"is read in steps of {channel.step:.3g} {channel.unit}, {np.ptp(channel.values) / channel.step:.0f} over its span: "
            f"rounding is {100 * error:.2g} % of its standard deviation, expected below {100 * COARSE[0]:g} %; use a "
            "smaller range of the converter",
        )


def _dead(view: _View) -> Iterator[Finding]:
    run, force = view.run, view.channels["force"]
    swings = float(np.ptp(run.force)) > max(30 * force.noise, 20.0)
    if view.stroke > MOVED:
        if np.ptp(run.force) <= 2 * force.step:
            yield view.finding(
                "dead_channel", "fault", "force",
                f"stays at {run.force[0]:.4g} N while the rod moves over {_milli(view.stroke)} mm; expected a damper's force: "
                "look at the load cell and its channel",
            )
        elif (related := _correlation(run.velocity, run.force)) < UNRELATED:
            yield view.finding(
                "dead_channel", "fault", "force",
                f"does not respond to the motion: correlation with the velocity at most {related:.2g} at any lag, expected "
                f"above {UNRELATED:g}; look at the load cell, its channel, and whether the damper is mounted",
            )
    elif not view.stroke and swings:
        yield view.finding(
            "dead_channel", "limitation" if view.varies else "fault", "position",
            f"rests at {_milli(run.position[0])} mm while the force spans {np.ptp(run.force):.3g} N; expected the motion that "
            "causes it: look at the position sensor",
        )
    if run.acceleration is not None and view.stroke > MOVED and np.ptp(run.acceleration) <= 2 * view.channels["acceleration"].step:
        yield view.finding(
            "dead_channel", "remark", "acceleration", "is constant while the rod moves, so it is not used; look at the sensor"
        )


def _correlation(one: Array, other: Array) -> float:
    """Largest magnitude of the correlation at any lag up to a quarter of the series."""
    one, other = one - one.mean(), signal.detrend(other)
    size = fft.next_fast_len(2 * len(one), real=True)
    product = fft.irfft(fft.rfft(one, size) * np.conj(fft.rfft(other, size)), size)
    reach = len(one) // 4
    scale = np.linalg.norm(one) * np.linalg.norm(other)
    return float(np.abs(np.concatenate([product[: reach + 1], product[-reach:]])).max() / scale) if scale else 0.0


def _aliasing(view: _View) -> Iterator[Finding]:
    for name, most in ALIASED.items():
        values = view.channels[name].values
        if np.ptp(values) == 0 or (name == "current" and (not view.varies or np.ptp(values) < 0.1)):
            continue
        if name == "position" and not view.stroke:
            continue
        _, density = signal.periodogram(values, window="hann", detrend="linear")
        share = float(density[int(TOP_BAND * len(density)) :].sum() / density.sum())
        if share > most:
            yield view.finding(
                "aliasing", "limitation", name,
                f"{100 * share:.2g} % of its power lies between {0.5 * TOP_BAND * view.run.rate:.3g} Hz and half the sample rate, "
                f"expected below {100 * most:g} %: noise, or what is faster and folded there; sample faster or filter before "
                "sampling",
            )


def _accelerometer(view: _View) -> Iterator[Finding]:
    """Gain and lag of the accelerometer against the position, from their cross spectrum."""
    run = view.run
    if run.acceleration is None or view.stroke < MOVED or np.ptp(run.acceleration) == 0:
        return
    if np.ptp(np.diff(run.time)) > GAP * view.interval:
        return
    length = min(len(run), max(256, round(4 * run.rate)))
    options = {"fs": run.rate, "nperseg": length, "detrend": "linear"}
    frequency, cross = signal.csd(run.position, run.acceleration, **options)
    own, other = signal.welch(run.position, **options)[1], signal.welch(run.acceleration, **options)[1]
    coherence = np.abs(cross) ** 2 / np.maximum(own * other, 1e-300)
    segments = max(1.0, 2 * len(run) / length - 1)
    # Leakage of the window makes neighbouring lines alike, so that few segments are coherent by themselves.
    used = (frequency > 3 / (length * view.interval)) & (frequency < 0.4 * run.rate) & (coherence > 0.95)
    used &= other > 1e-4 * other.max()
    if not used.any():
        return
    omega, coherence = 2 * np.pi * frequency[used], np.minimum(coherence[used], 1 - 1e-6)
    response = -cross[used] / (omega**2 * own[used])
    weight = 2 * segments * coherence / (1 - coherence)
    # Coarsely, so that phases need no unwrapping; then by the slope of what phase is left.
    grid = np.arange(-0.25, 0.25, 0.25 / omega.max())
    turned = response / np.abs(response) * np.exp(1j * np.outer(grid, omega))
    fits = (turned.real @ weight) / weight.sum()
    near = grid[fits > fits.max() - 0.01]
    lag = float(near[np.argmin(np.abs(near))])
    phase = np.angle(response * np.exp(1j * omega * lag))
    lag -= float(np.sum(weight * omega * phase) / np.sum(weight * omega**2))
    rest = np.angle(response * np.exp(1j * omega * lag))
    misfit = max(1.0, float(np.sum(weight * rest**2)) / max(1, len(omega) - 1))
    error = float(np.sqrt(misfit / np.sum(weight * omega**2)))
    gain = float(np.sum(np.sqrt(weight) * np.abs(response)) / np.sum(np.sqrt(weight)))
    if not ACCELEROMETER[0] < gain < ACCELEROMETER[1] or fits.max() < 0:
        yield view.finding(
            "rig", "limitation", "acceleration",
            f"is {gain:.3g} times the acceleration of the position, expected {ACCELEROMETER[0]:g} to {ACCELEROMETER[1]:g}; is it "
            f"the rod's{', in g instead of m/s²' if 0.08 < gain < 0.125 else ', in m/s²'}?",
        )
    if abs(lag) > LAG + 2 * error and abs(lag) > 4 * error:
        late, early = ("acceleration", "position") if lag > 0 else ("position", "acceleration")
        yield view.finding(
            "lag", "limitation", late,
            f"comes {_milli(abs(lag))} ± {_milli(1.96 * error)} ms after {early}, expected less than {_milli(LAG)} ms: velocities "
            "from both are wrong; sample all channels at once, with the same filters",
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
            f"spans {force:.3g}, expected {SMALLEST_FORCE:g} to {LARGEST_FORCE:g} N; is it in {'kN or V' if small else 'mN'}? "
            "Convert it to N",
        )


# ---- All runs


def _rates(views: Sequence[_View]) -> Iterator[Finding]:
    rates = np.array([1 / view.interval for view in views])
    if rates.max() > (1 + RATES) * rates.min():
        yield Finding(
            "clock", "remark",
            f"runs are sampled at {rates.min():.4g} to {rates.max():.4g} Hz; what is fast shows in the faster ones only",
        )
    slow = [view for view in views if 1 / view.interval < (1 - RATES) * LOW_RATE]
    if slow:
        longest = max(view.interval for view in slow)
        travel = max(view.speed * view.interval for view in slow)
        which = "all runs" if len(slow) == len(views) else ", ".join(view.run.name for view in slow)
        yield Finding(
            "aliasing", "limitation",
            f"{which}: one sample every {_milli(longest)} ms, in which the rod moves up to {_milli(travel)} mm; time constants "
            "and lost travel below about that, and anything above "
            f"{0.5 / longest:.3g} Hz, cannot be seen: sample at {LOW_RATE:g} Hz at least, better 1 kHz",
            slow[0].run.name if len(slow) == 1 else "",
        )


def _signs(views: Sequence[_View]) -> Iterator[Finding]:
    opposite = [view for view in views if view.stroke > MOVED and _dissipation(view) < OPPOSITE]
    text = (
        "the damper would drive the rod: force and motion have opposite signs, expected force > 0 to resist extension and "
        "position > 0 to extend; turn the sign of {}"
    )
    if opposite and len(opposite) == sum(view.stroke > MOVED for view in views):
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


SPEEDS = np.array([0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64])
"""m/s; edges of the cells in which forces of runs are compared, above the speeds at which hysteresis rules."""
CURRENTS = np.array([-np.inf, *np.arange(0.05, 3.0, 0.1), np.inf])
"""A; edges around round set-points."""


def _forces(view: _View) -> Array:
    """Half the force between out and in stroke, N, (speeds, currents); nan where there are fewer than 20 samples each."""
    speed = np.digitize(np.abs(view.run.velocity), SPEEDS) - 1
    current = np.digitize(np.abs(view.run.current), CURRENTS) - 1
    shape = (len(SPEEDS) - 1, len(CURRENTS) - 1)
    found = np.full((2, *shape), np.nan)
    inside = (speed >= 0) & (speed < shape[0])
    cell = np.where(inside, speed * shape[1] + current, -1)
    for side, mask in enumerate((view.run.velocity > 0, view.run.velocity < 0)):
        counts = np.bincount(cell[inside & mask], minlength=shape[0] * shape[1])
        for index in np.flatnonzero(counts >= 20):
            found[side].flat[index] = np.median(view.run.force[mask & (cell == index)])
    return np.asarray(0.5 * (found[0] - found[1]))


def _rigs(views: Sequence[_View]) -> Iterator[Finding]:
    """Runs whose forces at the same speed and current differ beyond any scatter."""
    # Short strokes do not leave the damper's hysteresis.
    moved = [view for view in views if view.stroke > 2 * SHORT_STROKE]
    if len(moved) < 2:
        return
    force = np.abs(np.stack([_forces(view) for view in moved]))
    others = np.full(force.shape, np.nan)
    for index in range(len(moved)):
        rest = np.delete(force, index, axis=0)
        known = np.isfinite(rest).any(axis=0)
        others[index][known] = np.nanmedian(rest[:, known], axis=0)
    named = set()
    for view, own, rest in zip(moved, force, others, strict=True):
        shared = np.isfinite(own) & np.isfinite(rest)
        if not shared.any():
            continue
        apart = float(np.median(np.log((own[shared] + RIG_FORCE) / (rest[shared] + RIG_FORCE))))
        if abs(apart) < np.log(RIG_RATIO):
            continue
        ratio = float(np.median(own[shared] / np.maximum(rest[shared], 1e-9)))
        named.add(view)
        unit = next((f" ({text}?)" for factor, text in UNITS.items() if 0.8 < max(ratio, 1 / ratio) / factor < 1.25), "")
        yield view.finding(
            "rig", "fault", "force",
            f"is {ratio:.3g} times that of the other runs at the same speed and current, expected within a factor "
            f"{RIG_RATIO:g}{unit}; is it another damper, load cell or unit? Diagnose rigs one by one",
        )


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
                    f"{SAME_MOTION:g}; strokes {_milli(other.stroke)} and {_milli(one.stroke)} mm); it is no repeat of it: look "
                    "at the servo",
                )
            continue
        yield from _compared(one, other, shift, claimed)


def _overlap(one: Array, other: Array, shift: int) -> tuple[Array, Array]:
    """The parts of two series that lie at the same time when the other is ``shift`` samples late."""
    count = min(len(one) + min(shift, 0), len(other) - max(shift, 0), len(one), len(other))
    return one[max(-shift, 0) :][:count], other[max(shift, 0) :][:count]


def _alignment(one: Array, other: Array) -> tuple[float, int]:
    """Correlation of two series at the shift that suits them best, at most a fifth of the shorter, and that shift."""
    size = fft.next_fast_len(len(one) + len(other), real=True)
    product = fft.irfft(np.conj(fft.rfft(one - one.mean(), size)) * fft.rfft(other - other.mean(), size), size)
    reach = min(len(one), len(other)) // 5
    shifts = np.concatenate([np.arange(reach + 1), np.arange(-reach, 0)])
    shift = int(shifts[np.argmax(product[shifts])])
    a, b = _overlap(one, other, shift)
    return float(np.corrcoef(a, b)[0, 1]), shift


def _compared(one: _View, other: _View, shift: int, claimed: bool) -> Iterator[Finding]:
    """What differs between two runs of the same motion."""
    currents = _overlap(one.run.current, other.run.current, shift)
    span = max(0.01, *(float(np.ptp(current)) for current in currents), *(0.5 * float(np.abs(c).max()) for c in currents))
    different = float(np.sqrt(np.mean((currents[0] - currents[1]) ** 2)))
    if different > 0.1 * span + 4 * (one.channels["current"].noise + other.channels["current"].noise):
        if claimed:
            yield other.finding(
                "repeat", "limitation", "current",
                f"claims the experiment of {one.run.name} and moves like it, but its current differs by {different:.2g} A rms; it "
                "is no repeat of it: look at the coil's supply",
            )
        return
    first, second = _overlap(one.run.force, other.run.force, shift)
    if np.array_equal(first, second) and np.ptp(first) > 0:
        yield other.finding(
            "repeat", "fault", "",
            f"is the same recording as {one.run.name}: its forces are equal to the last digit; give each recording once",
        )
        return
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
            "expected the same within some per cent: something changed from run to run, such as temperature, mounting or gain",
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
                f"is shorter than one stroke to and fro ({len(view.strokes) - 1} reversals): no loop to judge; record longer",
            )
    if reversals < FEWEST_REVERSALS:
        yield Finding(
            "coverage", "limitation",
            f"{reversals} reversals in all runs, expected {FEWEST_REVERSALS} at least: effects at reversals (hysteresis, play, "
            "compliance) rest on too little; record longer",
            channel="position",
        )
    stroke = max(view.stroke for view in views)
    if stroke < SHORT_STROKE:
        yield Finding(
            "coverage", "limitation",
            f"no stroke is longer than {_milli(stroke)} mm, expected {_milli(SHORT_STROKE)} mm at least: the damper may never "
            "leave its pre-yield loop; record longer strokes",
            channel="position",
        )
    peaks, frequencies = _peaks_and_frequencies(views)
    if len(peaks) and np.quantile(peaks, 0.95) < ONE_SPEED * np.quantile(peaks, 0.05):
        yield Finding(
            "coverage", "limitation",
            f"all strokes peak at one speed ({_milli(float(np.median(peaks)))} mm/s): what grows with speed or frequency cannot "
            "be told from what does not; record other speeds",
            channel="position",
        )
    lowest = min(float(view.run.position.min()) for view in views)
    highest = max(float(view.run.position.max()) for view in views)
    at = f" at {frequencies.min():.2g} to {frequencies.max():.2g} Hz" if len(frequencies) else ""
    yield Finding(
        "coverage", "remark",
        f"{len(views)} runs, {sum(view.run.duration for view in views):.4g} s: position {_milli(lowest)} to {_milli(highest)} mm, "
        f"speed up to {_milli(max(view.speed for view in views))} mm/s, current {current.min():.3g} to {current.max():.3g} A, "
        f"{reversals} reversals{at}",
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
_OF_ALL_RUNS: tuple[Callable[[Sequence[_View]], Iterator[Finding]], ...] = (_rates, _signs, _rigs, _repeats)
