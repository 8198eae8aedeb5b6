"""Readings of one channel: held, spiked, clipped, coarse, folded."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from mrd_diagnosis.diagnosis import Finding
from mrd_diagnosis.preflight.channels import Channel, View, equal_neighbours, milli, stretches
from mrd_diagnosis.preflight.clock import LOST

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

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


def holds(view: View) -> Iterator[Finding]:
    """Readings that stay while they cannot."""
    for channel in view.channels.values():
        values = channel.values
        first, last = equal_neighbours(values)
        if view.slow and channel.name != "position":
            continue  # a plateau may be as short as this
        if not len(first) or np.ptp(values) == 0:
            continue
        length = last - first + 1
        refreshed = _refreshed_every(channel, length) if channel.name != "current" else 0
        if refreshed:
            rate = view.run.rate / refreshed
            yield view.finding(
                "clock",
                "limitation",
                channel.name,
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
                "gap",
                "fault" if useless else "limitation",
                channel.name,
                f"{count} samples ({100 * share:.2g} %) repeat the one before, up to {length[held].max()} in a row, where "
                f"readings change; expected a new reading each: look at the channel's connection"
                f"{' and record it again' if useless else ''}",
            )


def _refreshed_every(channel: Channel, length: Indices) -> int:
    """Samples between new readings of a channel whose readings all stay equally long; 0 for others."""
    short = length[length <= 20]
    if len(short) < max(20, len(channel.values) / 40):
        return 0
    usual = int(np.bincount(short).argmax())
    changes = np.abs(np.diff(channel.values))
    large = np.median(changes[changes > 0]) > 3 * channel.step
    regular = np.mean(np.abs(length - usual) <= 0) > 0.6 and usual * np.sum(short == usual) > 0.4 * len(channel.values)
    return usual if large and regular else 0


def _unlikely(channel: Channel, first: Indices, last: Indices) -> Mask:
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


def _jumps(channel: Channel, first: Indices, last: Indices) -> Mask:
    """Which equal readings amid motion are followed by the jump that makes up for them."""
    values, least = channel.values, max(5 * channel.step, 8 * channel.noise)
    inside = (first >= 3) & (last < len(values) - 1) & (last - first + 1 >= 3)
    start, end = np.where(inside, first, 3), np.where(inside, last, 3)
    slope = (values[start] - values[start - 3]) / 3
    made_up = (values[end + 1] - values[end]) / np.where(slope == 0, np.inf, slope * (end - start + 1))
    return np.asarray(inside & (np.abs(values[end + 1] - values[end]) > least) & (made_up > 0.6) & (made_up < 1.7))


def spikes(view: View) -> Iterator[Finding]:
    """Positions that leave their neighbours as no rod does."""
    channel = view.channels["position"]
    values = channel.values
    around = np.median(np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]]), axis=0)
    away = np.abs(values[2:-2] - around)
    least = max(SPIKE * channel.noise, 5 * channel.step, FASTEST_JUMP * view.interval**2)
    # A corner of the motion leaves its neighbours by about the way between two samples.
    count = int(np.sum(away > least + 3 * view.speed * view.interval))
    if count:
        yield view.finding(
            "gap",
            "limitation",
            "position",
            f"{count} samples jump away from their neighbours and back, by up to {milli(away.max())} mm, as no rod does; "
            "the damper's hysteresis would follow them: look at the sensor's connection, remove these samples",
        )


def clipping(view: View) -> Iterator[Finding]:
    """Readings cut off at the end of a range."""
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
                "clipping",
                "fault" if useless else "limitation",
                channel.name,
                f"{clipped} samples ({100 * share:.2g} %) stay at the {side} reading, {top:.4g} {channel.unit}, where "
                "others scatter: it is beyond the range of its sensor or converter; widen that range"
                + (" and record it again" if useless else ""),
            )


def _flat_top(view: View, channel: Channel, top: float) -> int:
    """Samples in a flat top that no other level shares; 0 without one."""
    # Behind a clipped amplifier the converter's own noise is left, a few of its steps.
    band = 0.0 if view.slow else min(4 * channel.step, 0.25 * channel.loud)
    first, last = stretches(np.abs(channel.values - top) <= band)
    length = last - first + 1
    if channel.name == "position":
        return _clipped_turns(view, first, last)
    if not channel.noisy:
        return 0
    elsewhere = np.subtract(*equal_neighbours(channel.values)[::-1]) + 1
    at_top = np.abs(channel.values[equal_neighbours(channel.values)[0]] - top) <= band
    other = int(max(elsewhere[~at_top & (elsewhere > 0)], default=1))
    long = length >= max(HELD, 2 * other)
    return int(length[long].sum()) if long.sum() >= 2 or length[long].sum() >= 5 * HELD else 0


def _clipped_turns(view: View, first: Indices, last: Indices) -> int:
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


def quantisation(view: View) -> Iterator[Finding]:
    """Readings in steps that are coarse beside what they measure."""
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
            "quantisation",
            severity,
            channel.name,
            f"is read in steps of {channel.step:.3g} {channel.unit}, {np.ptp(channel.values) / channel.step:.0f} over its "
            f"span: rounding is {100 * error:.2g} % of its standard deviation, expected below {100 * COARSE[0]:g} %; use a "
            "smaller range of the converter",
        )


def aliasing(view: View) -> Iterator[Finding]:
    """Signals faster than the sampling follows."""
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
                "aliasing",
                "limitation",
                name,
                f"{100 * share:.2g} % of its power lies between {0.5 * TOP_BAND * view.run.rate:.3g} Hz and half the sample "
                f"rate, expected below {100 * ALIASED:g} %: noise, or what is faster and folded there; sample faster or "
                "filter before sampling",
            )
    current = view.run.current
    span = float(np.subtract(*np.quantile(current, [0.99, 0.01])))
    often = float(np.mean(np.abs(np.diff(current)) > SWITCHED[1] * span)) if span > SWITCHED[0] else 0.0
    if often > SWITCHED[2]:
        yield view.finding(
            "aliasing",
            "limitation",
            "current",
            f"switches every {1 / often:.2g} samples, expected {1 / SWITCHED[2]:g} at least: what it was in between is "
            "unknown; sample faster or switch more slowly",
        )
