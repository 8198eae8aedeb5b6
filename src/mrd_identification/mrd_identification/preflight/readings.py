"""Checks of the readings of single channels: held, jumping, clipped, coarse and aliased readings."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from mrd_base.tool import command
from mrd_identification.preflight.channels import Channel, CheckedRun, counted, milli
from mrd_identification.preflight.clock import USELESS_LOSS
from mrd_identification.preflight.finding import Finding, Severity
from mrd_identification.preflight.spectra import NOISY_TURNING

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

NEEDED_CHANNELS = ("position", "force")
"""Channels without which a run is useless."""
COINCIDENCE_PROBABILITY = 1e-6
"""Probability below which equal readings in a row are no coincidence: far below one such case in all runs of a bench."""
SHORTEST_HOLD = 4
"""Samples; fewer equal readings in a row are always taken for a coincidence."""
LONGEST_REFRESH = 20
"""Samples; a current that changes more slowly is a command in steps."""
COMMANDED_LEVELS = 0.5
"""Number of different readings over the number of holds, up to which a current is a command that steps between levels."""
USELESS_CLIPPING = 0.01
"""Share of clipped samples from which force or position are useless: saturation would be taken for physics."""
FEWEST_PILED_UP = 8
"""Samples at the limit of a force from which they may be clipped."""
CLIPPED_IN_A_ROW = 3
"""Samples at the limit in a row that no sharp extreme has."""
CLIPPED_SHARE_IN_A_ROW = 0.3
"""Share of the samples at the limit that must be in such a row."""
BANDS_BESIDE = 20
"""Bands of readings beside the limit that are compared with it."""
PILED_UP = 8
"""Ratio of the samples at the limit to those in any band beside it. The last step before a smooth turn has 2.4 times as many
as the step before, that before a flat one (of fourth order) 5.3 times."""
VARYING_SPEED = 0.05
"""Span of the speed at the limit, over the top speed, from which a constant force is no plateau of the damper."""
REVERSED_FORCE = 0.15
"""Share of the usual force range, from inward to outward motion. If the force goes this far to both sides of its middle
while the position rests at its extreme, the rod did turn, and the position was clipped."""
COARSE_ROUNDING = 0.01
"""Rms rounding error over the standard deviation of the channel that is as large as the noise of a fair sensor."""
USELESS_ROUNDING = 0.1
"""Rms rounding error over the standard deviation of the channel from which force or position are useless: one step is
a third of the standard deviation."""
SAMPLED_CURRENT_CHANGES = 0.1
"""Share of samples at which the current changes. A current that changes less often is a command in steps, for which the
size of a step tells nothing about the converter."""
SPIKE_NOISE = 20.0
"""Distance of a position from its neighbours, in standard deviations of the noise, that no rod reaches."""
SPIKE_ACCELERATION = 600.0
"""Acceleration over that of a sine of the same stroke and speed, that no rod reaches; a drive reaches 20."""
SPIKE_FORCE = 0.5
"""Distance of a single force from its neighbours, over the usual range of the force, that no damper makes."""
SPIKE_OVER_NEIGHBOURS = 3.0
"""Distance of a spike from its neighbours, over the distance between these. They differ at a jump of the force, as after a
reversal, and within an impact; beside a spike they do not."""
TOP_BAND = 0.8
"""Frequency over the Nyquist frequency from which the power of a well-sampled signal has fallen off."""
ALIASED_POWER = 0.01
"""Share of power in the top band, small noise not counted, from which signals may be folded there: 10 % of the rms value."""
SWITCHED_SPAN = 0.2
"""Span of a current, over the largest of all runs, from which switching between samples is looked for; noise and ripple
span less."""
SWITCHED_STEP = 0.25
"""Change of the current from one sample to the next, over its span, that counts as switching; noise changes it by less."""
SWITCHED_SHARE = 0.2
"""Share of samples at which the current switches, from which fewer than five samples show the response to a switch."""


def true_segments(mask: Mask) -> tuple[Indices, Indices]:
    """Return the first and the last index of each segment in which a mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return edges[::2], edges[1::2] - 1


def equal_segments(values: Array) -> tuple[Indices, Indices]:
    """Return the first and the last index of each segment of equal readings."""
    first, last = true_segments(np.diff(values) == 0)
    return first, last + 1


def check_held_readings(checked: CheckedRun) -> Iterator[Finding]:
    """Find readings that stay the same where the signal changes."""
    for channel in checked.channels.values():
        values = channel.values
        first, last = equal_segments(values)
        # In a slowly sampled run, a plateau may be as short as a hold.
        if checked.is_slowly_sampled and channel.name != "position":
            continue
        if not len(first) or np.ptp(values) == 0:
            continue
        length = last - first + 1
        refresh_period = channel.refresh_period
        levels = len(np.unique(values[first]))
        steps = refresh_period > LONGEST_REFRESH or levels <= COMMANDED_LEVELS * len(first)
        if channel.name == "current" and (not checked.current_varies or steps):
            refresh_period = 0.0
        if refresh_period:
            rate = checked.run.rate / refresh_period
            expected = f"expected a new reading at the sample rate of {checked.run.rate:.4g} Hz"
            text = (
                f"the {channel.name} is refreshed at {rate:.3g} Hz only: each reading stays the same for "
                f"{refresh_period:.3g} samples, {expected}. Raise the rate of the sensor, or record at {rate:.3g} Hz."
            )
            yield checked.finding("clock", "limitation", channel.name, text)
            continue
        if channel.name == "position":
            held = _followed_by_a_jump(channel, first, last)
        else:
            held = _longer_than_coincidence(channel, first, last)
        count = int(length[held].sum() - held.sum())
        if count:
            share = count / len(values)
            useless = share > USELESS_LOSS and channel.name in NEEDED_CHANNELS
            text = (
                f"the {channel.name} repeats the reading before in {count} samples ({100 * share:.2g} %): up to "
                f"{length[held].max()} readings in a row are equal, expected changing readings. Check the connection of the "
                f"channel{' and record the run again' if useless else ''}."
            )
            yield checked.finding("gap", "fault" if useless else "limitation", channel.name, text)


def _longer_than_coincidence(channel: Channel, first: Indices, last: Indices) -> Mask:
    """Return whether each segment of equal readings is longer than the noise of the channel allows."""
    step = channel.resolution
    if not channel.is_noisy or channel.lowest_noise <= 2 * step:
        return np.zeros(len(first), dtype=bool)
    values = channel.values
    # Two normal readings round to the same step with at most this probability; filtered ones may be alike more often.
    pairs = float(np.count_nonzero(last - first == 1)) / len(values)
    equal = max(step / (2 * np.sqrt(np.pi) * channel.lowest_noise), pairs, 1e-3)
    long = last - first + 1 > max(SHORTEST_HOLD, 1 + np.log(COINCIDENCE_PROBABILITY / len(values)) / np.log(equal))
    # On a plateau, readings change by one or two steps; at the ends of the range, equal readings are clipping.
    before = np.abs(values[first] - values[np.maximum(first - 1, 0)])
    after = np.abs(values[np.minimum(last + 1, len(values) - 1)] - values[last])
    inner = (values[first] != values.max()) & (values[first] != values.min())
    return np.asarray(long & inner & (np.maximum(before, after) > 2.5 * step))


def _followed_by_a_jump(channel: Channel, first: Indices, last: Indices) -> Mask:
    """Return whether each segment of equal readings during motion ends with a jump that makes up for the motion."""
    values, least = channel.values, max(5 * channel.resolution, 8 * channel.noise)
    inside = (first >= 3) & (last < len(values) - 1) & (last - first + 1 >= 3)
    start, end = np.where(inside, first, 3), np.where(inside, last, 3)
    slope = (values[start] - values[start - 3]) / 3
    jump = values[end + 1] - values[end]
    # The slope is estimated from three samples, so the jump may differ from the missed motion by half.
    made_up = jump / np.where(slope == 0, np.inf, slope * (end - start + 1))
    return np.asarray(inside & (np.abs(jump) > least) & (made_up > 0.6) & (made_up < 1.7))


def check_spikes(checked: CheckedRun) -> Iterator[Finding]:
    """Find single positions and forces that are farther from their neighbours than any rod moves and any damper responds."""
    yield from _check_spikes_of_position(checked)
    yield from _check_spikes_of_force(checked)


def _neighbours(values: Array) -> Array:
    """Return the two samples before and the two behind each sample but the first and last two, (4, n - 4)."""
    return np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]])


def _check_spikes_of_force(checked: CheckedRun) -> Iterator[Finding]:
    if checked.is_slowly_sampled:  # an impact may then take one sample
        return
    channel = checked.channels["force"]
    neighbours = _neighbours(channel.values)
    distance = np.abs(channel.values[2:-2] - np.median(neighbours, axis=0))
    low, high = np.quantile(channel.values, [0.01, 0.99])
    least = max(SPIKE_NOISE * channel.noise, 5 * channel.resolution, SPIKE_FORCE * float(high - low))
    spikes = distance > least + SPIKE_OVER_NEIGHBOURS * np.ptp(neighbours, axis=0)
    if count := int(spikes.sum()):
        text = (
            f"the force jumps in {counted(count, 'single sample')}: it leaves its neighbours by up to "
            f"{distance[spikes].max():.3g} N and comes back at once, which no damper does. Least squares "
            "follow these samples. Check the cable and the amplifier of the load cell, and remove these samples, or fit "
            f"with `{command('mrd_identification', 'identify')} --loss huber`."
        )
        yield checked.finding("gap", "limitation", "force", text)


def _check_spikes_of_position(checked: CheckedRun) -> Iterator[Finding]:
    channel, interval = checked.channels["position"], checked.sampling_interval
    values = channel.values
    distance = np.abs(values[2:-2] - np.median(_neighbours(values), axis=0))
    least = max(
        SPIKE_NOISE * channel.noise, 5 * channel.resolution, SPIKE_ACCELERATION * checked.scales.acceleration * interval**2
    )
    # At a corner of the motion, a position is about the travel between two samples away from its neighbours.
    count = int(np.sum(distance > least + 3 * checked.top_speed * interval))
    if count:
        text = (
            f"the position jumps in {counted(count, 'sample')}: it leaves its neighbours by up to {milli(distance.max())} "
            "mm and comes back, which no rod does. A damper model would respond to these jumps. Check the connection of the "
            "position sensor, and remove these samples."
        )
        yield checked.finding("gap", "limitation", "position", text)


def check_clipping(checked: CheckedRun) -> Iterator[Finding]:
    """Find readings that are cut off at the end of a range."""
    for channel in checked.channels.values():
        if channel.refresh_period:  # it stays at its extreme as long as anywhere
            continue
        for side, limit in (("highest", channel.values.max()), ("lowest", channel.values.min())):
            # A supply that is off reads about zero.
            if channel.name == "current" and abs(limit) < 0.02:
                continue
            clipped = _clipped_samples(checked, channel, float(limit))
            if not clipped:
                continue
            share = clipped / len(checked.run)
            useless = share > USELESS_CLIPPING and channel.name in NEEDED_CHANNELS
            text = (
                f"the {channel.name} is clipped at its {side} reading, {limit:.4g} {channel.unit}: {clipped} samples "
                f"({100 * share:.2g} %) stay there, expected noise as in the other samples. The signal exceeds the range of "
                f"its sensor or converter. Widen that range{' and record the run again' if useless else ''}."
            )
            yield checked.finding("clipping", "fault" if useless else "limitation", channel.name, text)


def _clipped_samples(checked: CheckedRun, channel: Channel, limit: float) -> int:
    """Number of samples in a flat part at ``limit`` that no other level has; 0 without one."""
    # If an amplifier clips, the noise of the converter behind it is left: a few steps.
    band = 0.0 if checked.is_slowly_sampled else min(4 * channel.resolution, 0.25 * channel.highest_noise)
    first, last = true_segments(np.abs(channel.values - limit) <= band)
    length = last - first + 1
    if channel.name == "position":
        return _clipped_turns(checked, first, last)
    if channel.name == "force":
        return _piled_up(checked, channel, limit, max(band, 1e-9 * abs(limit)))
    if not channel.is_noisy:
        return 0
    first_equal, last_equal = equal_segments(channel.values)
    elsewhere = (last_equal - first_equal + 1)[np.abs(channel.values[first_equal] - limit) > band]
    long = length >= max(SHORTEST_HOLD, 2 * int(max(elsewhere, default=1)))
    return int(length[long].sum()) if long.sum() >= 2 or length[long].sum() >= 5 * SHORTEST_HOLD else 0


def _piled_up(checked: CheckedRun, channel: Channel, limit: float, band: float) -> int:
    """Number of samples within a band at the limit, if the band holds many more than others and the speed varies in it."""
    inwards = np.abs(channel.values - limit)
    at_limit = inwards <= band
    count = int(at_limit.sum())
    if count < FEWEST_PILED_UP:
        return 0
    # Where a signal turns smoothly, readings dwell near its extreme as well, but not in one band only.
    step = channel.smallest_step
    width = max(band, step) * (1 + 1e-6)
    beside = np.histogram(inwards[~at_limit], bins=band + width * np.arange(BANDS_BESIDE + 1))[0]
    speed = np.abs(checked.run.velocity[at_limit])
    # At a constant speed, a force without noise is constant as well.
    varies = np.ptp(np.quantile(speed, [0.05, 0.95])) > VARYING_SPEED * checked.top_speed
    third = np.diff(channel.values, 3)[np.convolve(at_limit, np.ones(4), "valid") == 0]
    noisy = len(third) > 1 and np.mean(third[1:] * third[:-1] < 0) > NOISY_TURNING
    lacks_noise = noisy and np.median(np.abs(third)) > max(4 * band, 6 * step)
    # A periodic force has the same extreme, but of a sample or two, in each period.
    first, last = true_segments(at_limit)
    length = last - first + 1
    in_a_row = length[length >= CLIPPED_IN_A_ROW].sum() > CLIPPED_SHARE_IN_A_ROW * count
    lacks_noise = lacks_noise and in_a_row and not checked.is_slowly_sampled
    return count if count > PILED_UP * beside.max() and (varies or lacks_noise) else 0


def _clipped_turns(checked: CheckedRun, first: Indices, last: Indices) -> int:
    """Number of samples in which the position rests at its extreme while the force shows that the rod turned."""
    position, force = checked.channels["position"], checked.run.force
    # A true turn comes to rest gradually, over steps not much larger than the quantisation step.
    entry = np.abs(position.values[first] - position.values[first - 1])
    sudden = entry > np.maximum(4 * position.resolution, 4 * position.noise)
    kept = (first > 0) & (last - first >= SHORTEST_HOLD) & sudden
    first, last = first[kept], last[kept]
    if len(first) < 2:
        return 0
    velocity = checked.run.velocity
    moving = np.abs(velocity) > 0.2 * checked.top_speed
    low, high = (np.median(force[moving & direction]) for direction in (velocity < 0, velocity > 0))
    outwards = 1 if position.values[first[0]] > np.median(position.values) else -1
    before, after = (
        outwards * float(np.median(force[index]) - 0.5 * (low + high))
        for index in (first - 1, first + 4 * (last - first) // 5)
    )
    if min(before, -after) < REVERSED_FORCE * (high - low):
        return 0
    return int(np.sum(last - first + 1))


def check_quantisation(checked: CheckedRun) -> Iterator[Finding]:
    """Find channels whose quantisation step is coarse against the signal."""
    for channel in checked.channels.values():
        step, deviation = channel.resolution, float(np.std(channel.values))
        if not step or not deviation:
            continue
        if channel.name == "current" and not checked.current_varies:
            continue
        if channel.name == "current" and np.mean(np.diff(channel.values) != 0) < SAMPLED_CURRENT_CHANGES:
            continue
        if channel.name == "position" and not checked.stroke:
            continue
        rounding = step / np.sqrt(12.0) / deviation
        if rounding < COARSE_ROUNDING:
            continue
        severity: Severity = "remark"
        if channel.name in NEEDED_CHANNELS:
            severity = "fault" if rounding > USELESS_ROUNDING else "limitation"
        text = (
            f"the {channel.name} is read in coarse steps of {step:.3g} {channel.unit}, {np.ptp(channel.values) / step:.0f} "
            f"over its span: the rounding error is {100 * rounding:.2g} % of the standard deviation, expected below "
            f"{100 * COARSE_ROUNDING:g} %. Use a smaller range of the converter."
        )
        yield checked.finding("quantisation", severity, channel.name, text)


def check_aliasing(checked: CheckedRun) -> Iterator[Finding]:
    """Find signals that change faster than they are sampled."""
    for name in NEEDED_CHANNELS:
        values = checked.channels[name].values
        if not (checked.stroke if name == "position" else np.ptp(values)):
            continue
        _, density = signal.periodogram(values, window="hann", detrend="linear")
        # A small white part is noise. If the white part is as large as the signal, it may be anything.
        noise = checked.channels[name].noise
        white = 2 * noise**2 if noise < 0.1 * np.std(values) else 0.0
        share = float(np.sum(density[int(TOP_BAND * len(density)) :] - white) / density.sum())
        if share > ALIASED_POWER:
            text = (
                f"the {name} has {100 * share:.2g} % of its power between {0.5 * TOP_BAND * checked.run.rate:.3g} Hz and "
                f"half the sample rate: expected below {100 * ALIASED_POWER:g} %. This is noise, or a faster signal that is "
                "folded into this band. Sample faster, or filter before sampling."
            )
            yield checked.finding("aliasing", "limitation", name, text)
    current = checked.run.current
    span = float(np.subtract(*np.quantile(current, [0.99, 0.01])))
    share = (
        float(np.mean(np.abs(np.diff(current)) > SWITCHED_STEP * span))
        if checked.current_varies and span > SWITCHED_SPAN * checked.scales.current
        else 0.0
    )
    if share > SWITCHED_SHARE:
        text = (
            f"the current switches faster than it is sampled: it switches every {1 / share:.2g} samples, expected at least "
            f"{1 / SWITCHED_SHARE:g} samples between two switches. Sample faster, or switch more slowly."
        )
        yield checked.finding("aliasing", "limitation", "current", text)
