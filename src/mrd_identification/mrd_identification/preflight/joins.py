"""Signs that a file is not one recording as it was sampled: interpolated samples, and recordings that were joined."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mrd_identification.preflight.channels import NOISE_BLOCK, Channel, CheckedRun, milli
from mrd_identification.preflight.clock import GAP_INTERVALS
from mrd_identification.preflight.finding import Finding

Array = NDArray[np.float64]

STRAIGHT = 6.0
"""Second difference over its lower quartile, up to which three samples lie on a line; rounding reaches four times that."""
ROUNDED_STEPS = 2.1
"""The same in steps of the file: each of three samples is rounded by up to half a step, and the middle one counts twice."""
ROUNDING = 1e-7
"""The same over the largest reading: numbers of seven digits."""
HARDLY_BENT = 5.0
"""Second difference over the largest of a line, up to which samples are hardly bent."""
HARDLY_BENT_SHARE = 0.15
"""Share of corners that are hardly bent, up to which there are straight parts and corners only, as no smooth signal has."""
STRAIGHT_SHARE = 0.25
"""Share of samples that lie on a line in an interpolated recording, at least; at twice the rate, half of them do."""
LONGEST_PERIOD = 50
"""Samples; interpolated recordings have at most this many for each original one."""
FEWEST_CORNERS = 20
"""Corners between straight parts, from which their distance can be told."""
REGULAR_SHARE = 0.85
"""Share of the distances between corners that must be equal within one sample."""
JUMP_NOISE = 20.0
"""Jump of the position, in standard deviations of its noise, that no rod makes."""
JUMP_ACCELERATION = 100.0
"""Acceleration over that of a sine of the same stroke and speed, that no rod reaches; a drive reaches a fifth of it."""
NOISE_RATIO = 2.0
"""Ratio of the noise before and after an instant from which the recordings are not of one setting."""
NOISE_SIGMA = 3.0
"""The same change, in standard deviations of the logarithmic noise from block to block."""
RESTING_SPEED = 0.1
"""Speed over the top speed that the rod exceeds in no part of a block in which it rests."""
FEWEST_BLOCKS = 15
"""Blocks of samples on either side of a change of the noise."""


def original_rate(channel: Channel, rate: float) -> float:
    """Return the rate in Hz at which a channel was sampled before it was interpolated linearly; 0 where it was not."""
    curvature = np.abs(np.diff(channel.values, 2))
    largest = float(np.abs(channel.values).max())
    usual = STRAIGHT * np.quantile(curvature, STRAIGHT_SHARE)
    straight = max(usual, ROUNDED_STEPS * channel.smallest_step, ROUNDING * largest)
    bent = curvature > straight
    if not bent.any() or np.mean(curvature[bent] < HARDLY_BENT * straight) > HARDLY_BENT_SHARE:
        return 0.0
    corners = np.flatnonzero(bent[1:] & ~bent[:-1])
    spacing = np.diff(corners)
    if len(spacing) < FEWEST_CORNERS:
        return 0.0
    regular = spacing[np.abs(spacing - np.median(spacing)) <= 1]
    if len(regular) < REGULAR_SHARE * len(spacing) or regular.mean() > LONGEST_PERIOD:
        return 0.0
    return float(rate / regular.mean())


def check_joins(checked: CheckedRun) -> Iterator[Finding]:
    """Find recordings that were joined to one file: jumps of the position, changes of the noise."""
    yield from _check_jumps(checked)
    if checked.is_slowly_sampled:
        return
    for name in ("position", "force"):
        change = _noise_change(checked.channels[name], checked)
        if change is None:
            continue
        sample, before, after = change
        unit, scale = ("mm", 1e3) if name == "position" else ("N", 1.0)
        text = (
            f"the noise of the {name} changes from {scale * before:.2g} to {scale * after:.2g} {unit} rms at "
            f"{checked.run.time[sample]:.3g} s: expected the same noise in the whole run. Two recordings may have been "
            "joined, or a range was switched. One noise for the whole run would be wrong. Split the file there."
        )
        yield checked.finding("gap", "limitation", name, text)


def _check_jumps(checked: CheckedRun) -> Iterator[Finding]:
    channel, interval = checked.channels["position"], checked.sampling_interval
    steps = np.diff(channel.values)
    if len(steps) < 12:
        return
    windows = np.lib.stride_tricks.sliding_window_view(steps, 9)
    usual = 0.5 * (np.median(windows[:, :4], axis=1) + np.median(windows[:, 5:], axis=1))
    jump = windows[:, 4] - usual
    # A spike comes back within a few samples. A held reading is made up for by a jump.
    kept = [np.abs(np.sum(part - usual[:, None], axis=1)) > 0.5 * np.abs(jump) for part in (windows[:, 4:], windows[:, :5])]
    kept.append((windows[:, 3] != 0) | (channel.resolution > 0))
    least = max(
        JUMP_NOISE * channel.noise, 5 * channel.resolution, JUMP_ACCELERATION * checked.scales.acceleration * interval**2
    )
    least += 3 * checked.top_speed * interval
    contiguous = np.diff(checked.run.time)[4:-4] < GAP_INTERVALS * interval
    found = np.flatnonzero((np.abs(jump) > least) & np.all(kept, axis=0) & contiguous)
    if len(found):
        place = found[np.argmax(np.abs(jump[found]))]
        text = (
            f"the position jumps by {milli(abs(jump[place]))} mm from one sample to the next, at "
            f"{checked.run.time[place + 4]:.4g} s, and stays there: no rod does. Two recordings may have been joined. "
            "Hysteresis and heat do not carry over such a place. Split the file there."
        )
        yield checked.finding("gap", "limitation", "position", text)


def _noise_change(channel: Channel, checked: CheckedRun) -> tuple[int, float, float] | None:
    """Return the sample at which the white noise of a channel changes, and its standard deviations before and after.

    The motion changes the noise by itself: the roughness of dry friction ends where the rod stops. So moving and resting
    blocks are compared among themselves, and noise that changes no more than the speed tells nothing.
    """
    noise = channel.local_noise
    if len(noise) < 2 * FEWEST_BLOCKS or not noise.all():
        return None
    speed = np.abs(checked.run.velocity)[: len(noise) * NOISE_BLOCK].reshape(len(noise), -1).max(axis=1)
    moving = speed > RESTING_SPEED * checked.top_speed
    for blocks in (np.flatnonzero(moving), np.flatnonzero(~moving)):
        if len(blocks) < 2 * FEWEST_BLOCKS:
            continue
        level = np.log(noise[blocks])
        place = _place_of_step(level)
        before, after = level[:place], level[place:]
        # What changes gradually, as the motion does, has no such step between the neighbours of the place.
        near = np.median(after[:FEWEST_BLOCKS]) - np.median(before[-FEWEST_BLOCKS:])
        change = np.median(after) - np.median(before)
        spread = max(np.std(before), np.std(after))
        speeds = speed[blocks]
        faster = np.log(np.median(speeds[place:]) / np.median(speeds[:place])) if moving[blocks[0]] else 0.0
        if min(abs(change), abs(near)) >= max(np.log(NOISE_RATIO), NOISE_SIGMA * spread, abs(faster)):
            sigma_before, sigma_after = np.exp(np.median(before)), np.exp(np.median(after))
            return int(blocks[place]) * NOISE_BLOCK, float(sigma_before), float(sigma_after)
    return None


def _place_of_step(level: Array) -> int:
    """Return the index before which a series (n,) most likely has a step, with `FEWEST_BLOCKS` on either side."""
    number = np.arange(1, len(level))
    total = np.cumsum(level)
    step = (total[-1] - total[:-1]) / (len(level) - number) - total[:-1] / number
    gain = number * (len(level) - number) * step**2
    return FEWEST_BLOCKS + int(np.argmax(gain[FEWEST_BLOCKS - 1 : len(level) - FEWEST_BLOCKS]))
