"""Checks of runs that repeat each other: one recording given twice, and repeats that differ."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_identification.preflight.alignment import best_shift, overlap
from mrd_identification.preflight.channels import RATE_TOLERANCE, CheckedRun, milli
from mrd_identification.preflight.finding import Finding
from mrd_runs.scales import SMALLEST

Array = NDArray[np.float64]

SAME_MOTION = 0.999
"""Correlation of the positions from which two runs have the same motion."""
DIFFERENT_REPEAT = 0.05
"""Relative difference of gain or offset between repeats that is worth a remark: the scatter from run to run is 1 to 2 %."""
NO_REPEAT = 0.2
"""Relative difference of gain or offset from which a run is no repeat of another."""
DIFFERENT_SHAPE = 0.1
"""Rms difference of the forces after gain and offset are fitted, over their standard deviation: five times what scatter
from run to run leaves."""
SHAPE_OVER_MOTION = 3.0
"""Difference in shape over the relative difference of the velocities that the motion explains. Most of the force turns
within a short way after a reversal, so a motion that differs by a few per cent changes the force by more."""


def check_duplicates(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    """Find runs whose samples are mostly those of another run."""
    for first, second in itertools.combinations(runs, 2):
        equal = _equal_samples(first.run.force, second.run.force)
        if not equal:
            continue
        # Two simulations of one experiment without noise are equal as well.
        other_noise = (channel.is_noisy for name, channel in first.channels.items() if name != "force")
        digitised = first.channels["position"].resolution > 0
        recorded = first.channels["force"].is_noisy and (digitised or any(other_noise))
        text = (
            f"this run has the same force as {first.run.name}: {equal} samples are equal to the last digit, expected "
            "different noise. "
            + ("Give each recording once." if recorded else "Without noise, the second run adds nothing. Leave it out.")
        )
        yield second.finding("repeat", "fault" if recorded else "limitation", "force", text)


def _equal_samples(first: Array, second: Array) -> int:
    """Number of samples in which two series are equal, if that is most of the shorter one; otherwise 0."""
    middle = len(second) // 2
    matches = np.flatnonzero(first == second[middle])
    for match in matches[np.argsort(np.abs(matches - middle))][:20]:
        a, b = overlap(first, second, middle - int(match))
        if len(a) >= 0.5 * min(len(first), len(second)) and np.array_equal(a, b) and np.ptp(a):
            return len(a)
    return 0


def check_repeats(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    """Find runs with the same motion and current but another force, and runs that only claim to repeat another."""
    for first, second in itertools.combinations(runs, 2):
        if abs(first.sampling_interval / second.sampling_interval - 1) > RATE_TOLERANCE:
            continue
        if not first.stroke or not second.stroke:
            continue
        experiment = first.run.info.get("experiment")
        same_experiment = bool(experiment) and experiment == second.run.info.get("experiment")
        correlation, shift = 0.0, 0
        if 0.9 < first.stroke / second.stroke < 1.1:
            correlation, shift = best_shift(first.run.position, second.run.position)
        if correlation < SAME_MOTION:
            if same_experiment:
                text = (
                    f"this run names the experiment of {first.run.name} but moves differently: the correlation of the "
                    f"positions is {correlation:.3f}, expected {SAME_MOTION:g}, and the strokes are {milli(second.stroke)} "
                    f"and {milli(first.stroke)} mm. It is not a repeat. Check the servo."
                )
                yield second.finding("repeat", "limitation", "position", text)
            continue
        difference, same_current = _current_difference(first, second, shift)
        if same_current:
            yield from _check_force_of_repeat(first, second, shift)
        elif same_experiment:
            text = (
                f"this run names the experiment of {first.run.name} and moves like it but has another current: the "
                f"difference is {difference:.2g} A rms, expected noise only. It is not a repeat. Check the supply of the "
                "coil."
            )
            yield second.finding("repeat", "limitation", "current", text)


def _current_difference(first: CheckedRun, second: CheckedRun, shift: int) -> tuple[float, bool]:
    """Return the rms difference of two currents in A, and whether noise and scatter of the supply explain it."""
    currents = overlap(first.run.current, second.run.current, shift)
    span = max(*(float(np.ptp(current)) for current in currents), *(0.5 * float(np.abs(c).max()) for c in currents))
    difference = float(np.sqrt(np.mean((currents[0] - currents[1]) ** 2)))
    noise = first.channels["current"].noise + second.channels["current"].noise
    largest = max(float(np.abs(current).max()) for current in currents)
    return difference, largest < SMALLEST.current or difference <= 0.1 * span + 4 * noise


def _check_force_of_repeat(first: CheckedRun, second: CheckedRun, shift: int) -> Iterator[Finding]:
    """Find differences of the forces of two runs with the same motion and current."""
    force, repeated_force, motion_difference = _align_within_a_sample(first, second, shift)
    deviation = float(np.std(force))
    gain, offset = np.polyfit(force - force.mean(), repeated_force, 1)
    offset -= force.mean()
    # What is left after gain and offset is a difference in shape.
    shape = float(np.std(repeated_force - np.polyval([gain, repeated_force.mean()], force - force.mean())))
    noise = float(np.hypot(first.channels["force"].noise, second.channels["force"].noise))
    reshaped = shape > max(DIFFERENT_SHAPE, SHAPE_OVER_MOTION * motion_difference) * deviation
    differences = []
    if abs(gain - 1) > DIFFERENT_REPEAT:
        differences.append(f"it is {gain:.3g} times as large")
    if abs(offset) > max(DIFFERENT_REPEAT * deviation, 5 * noise):
        differences.append(f"it is {offset:.3g} N higher")
    if reshaped and shape > 6 * noise:
        differences.append(f"its shape differs by {shape:.3g} N rms")
    if differences:
        large = abs(gain - 1) > NO_REPEAT or abs(offset) > NO_REPEAT * deviation or reshaped
        text = (
            f"the force differs from {first.run.name}, which has the same motion and current: {' and '.join(differences)}, "
            f"expected the same force within a few per cent (the noise is {noise:.2g} N). Check what changed between the "
            "runs, such as temperature, mounting or gain."
        )
        yield second.finding("repeat", "limitation" if large else "remark", "force", text)


def _align_within_a_sample(first: CheckedRun, second: CheckedRun, shift: int) -> tuple[Array, Array, float]:
    """Return the forces of a run and of its repeat at the same positions, and the relative difference of the velocities.

    Alignment to whole samples is not enough: at reversals, the force changes much from one sample to the next.
    """
    position, repeated_position = overlap(first.run.position, second.run.position, shift)
    slope = np.gradient(position)
    ahead = repeated_position - repeated_position.mean() - position + position.mean()
    lateness = -float(np.clip(slope @ ahead / (slope @ slope), -1, 1))
    force, repeated_force = overlap(first.run.force, second.run.force, shift)
    velocity, repeated_velocity = overlap(first.run.velocity, second.run.velocity, shift)
    index = np.arange(len(force), dtype=float)
    inner = slice(2, -2)
    change = (np.interp(index + lateness, index, repeated_velocity) - velocity)[inner]
    repeated_force = np.interp(index + lateness, index, repeated_force)[inner]
    return force[inner], repeated_force, float(np.std(change) / np.std(velocity))
