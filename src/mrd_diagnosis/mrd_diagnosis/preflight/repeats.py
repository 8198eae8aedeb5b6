"""Repeats that are none, and one recording given twice."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Finding
from mrd_diagnosis.preflight.channels import RATES, View, correlations, milli, overlap

Array = NDArray[np.float64]

SAME_MOTION = 0.999
"""Correlation of the positions of repeats."""
REPEAT = (0.05, 0.2)
"""Relative differences of force between repeats: larger than scatter from run to run (1 to 2 %); no repeat."""
SHAPE = 0.1
"""Rest of a repeat's force, its gain and offset taken out, over the standard deviation."""
MOVED = 3.0
"""The same, over the relative difference of the velocities: most of a force turns within a short way after a reversal, so
that a motion which differs by a few per cent changes it by more."""


def duplicates(views: Sequence[View]) -> Iterator[Finding]:
    """Runs that are, for the most part, the same samples."""
    for one, other in itertools.combinations(views, 2):
        length = min(len(one.run), len(other.run))
        middle = len(other.run) // 2
        places = np.flatnonzero(one.run.force == other.run.force[middle])
        for place in places[np.argsort(np.abs(places - middle))][:20]:
            a, b = overlap(one.run.force, other.run.force, middle - int(place))
            if len(a) < 0.5 * length or not np.array_equal(a, b) or not np.ptp(a):
                continue
            # Without any noise, two simulations of one experiment are the same too.
            others = (channel.noisy for name, channel in one.channels.items() if name != "force")
            recorded = one.channels["force"].noisy and (one.channels["position"].step > 0 or any(others))
            yield other.finding(
                "repeat",
                "fault" if recorded else "limitation",
                "force",
                f"is the same recording as {one.run.name}: {len(a)} samples of its force are equal to the last digit; "
                + ("give each recording once" if recorded else "without noise, it says nothing more"),
            )
            break


def repeats(views: Sequence[View]) -> Iterator[Finding]:
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
                    "repeat",
                    "limitation",
                    "position",
                    f"claims the experiment of {one.run.name} but moves otherwise (correlation {alike:.3f}, expected "
                    f"{SAME_MOTION:g}; strokes {milli(other.stroke)} and {milli(one.stroke)} mm); it is no repeat of it: "
                    "look at the servo",
                )
            continue
        yield from _compared(one, other, shift, claimed)


def _alignment(one: Array, other: Array) -> tuple[float, int]:
    """Correlation of two series at the shift that suits them best, and that shift."""
    shifts, related = correlations(one, other)
    best = int(np.argmax(related))
    # Of the peaks of a periodic motion, the nearest.
    peaks = np.flatnonzero((related[1:-1] >= related[:-2]) & (related[1:-1] >= related[2:])) + 1
    peaks = peaks[related[peaks] > related[best] - 1e-4]
    best = int(peaks[np.argmin(np.abs(shifts[peaks]))]) if len(peaks) else best
    shift = int(shifts[best])
    return float(np.corrcoef(*overlap(one, other, shift))[0, 1]), shift


def _compared(one: View, other: View, shift: int, claimed: bool) -> Iterator[Finding]:
    """What differs between two runs of the same motion."""
    currents = overlap(one.run.current, other.run.current, shift)
    span = max(0.01, *(float(np.ptp(current)) for current in currents), *(0.5 * float(np.abs(c).max()) for c in currents))
    different = float(np.sqrt(np.mean((currents[0] - currents[1]) ** 2)))
    if different > 0.1 * span + 4 * (one.channels["current"].noise + other.channels["current"].noise):
        if claimed:
            yield other.finding(
                "repeat",
                "limitation",
                "current",
                f"claims the experiment of {one.run.name} and moves like it, but its current differs by {different:.2g} A "
                "rms; it is no repeat of it: look at the coil's supply",
            )
        return
    first, second = overlap(one.run.force, other.run.force, shift)
    # Align them within a sample: at reversals the force of one sample is another than that of the next.
    a, b = overlap(one.run.position, other.run.position, shift)
    slope = np.gradient(a)
    late = -float(np.clip(slope @ (b - b.mean() - a + a.mean()) / (slope @ slope), -1, 1))
    index = np.arange(len(second), dtype=float)
    inner = slice(2, -2)
    second = np.interp(index + late, index, second)[inner]
    first = first[inner]
    v, v_again = overlap(one.run.velocity, other.run.velocity, shift)
    moved = float(np.std((np.interp(index + late, index, v_again) - v)[inner]) / np.std(v))
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
    reshaped = rest > max(SHAPE, MOVED * moved) * spread
    if reshaped and rest > 6 * noise:
        differs.append(f"its shape differs by {rest:.3g} N rms")
    if differs:
        much = abs(gain - 1) > REPEAT[1] or abs(offset) > REPEAT[1] * spread or reshaped
        yield other.finding(
            "repeat",
            "limitation" if much else "remark",
            "force",
            f"moves like {one.run.name} at the same current, but {' and '.join(differs)}, beside a noise of {noise:.2g} N; "
            "expected the same within a few %: something changed between them, such as temperature, mounting or gain",
        )
