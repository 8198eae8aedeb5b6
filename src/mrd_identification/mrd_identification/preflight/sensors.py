"""Checks of the sensors against each other and against what a damper can do: units, dead channels, accelerometer, signs."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from mrd_base.tool import command
from mrd_identification.preflight.alignment import cross_correlation, overlap
from mrd_identification.preflight.channels import FEW_STROKES, CheckedRun, milli
from mrd_identification.preflight.finding import Finding, Severity
from mrd_runs.faults import relative_work
from mrd_runs.scales import LARGEST

Array = NDArray[np.float64]

LARGEST_STROKE, LARGEST_FORCE = 2 * LARGEST.stroke, 2 * LARGEST.force
"""Spans of the position in m and of the force in N that no damper on a bench has: they are recorded in mm and mN."""
VERY_FEW_NEWTONS, FEW_NEWTONS = 5.0, 30.0
"""Spans of the force in N of all runs below which it is rather in kN than that of a damper, and below which it may be."""
SWING = 0.02
"""Share of half the span of all forces, from which on a force swings."""
UNRELATED_CORRELATION = 0.1
"""Correlation of force and velocity, at the best delay, below which the force does not respond to the motion."""
ALLOWED_LAG = 2e-3
"""Lag in s between position and accelerometer; the filters of usual sensors (100 Hz and more) differ by less."""
LONGEST_LAG = 0.25
"""Longest lag in s that is looked for; beyond it, periodic motions become ambiguous."""
AVERAGING_TIME = 0.02
"""Time in s over which position and accelerometer are averaged before they are compared: 8 µm of noise in the position then
are 0.05 m/s² in its second difference."""
ACCELEROMETER_GAIN = (0.8, 1.25)
"""Gain of an accelerometer against the position, as in `mrd_runs.signals.motion`. Outside, it does not measure the rod's
acceleration in m/s²."""
WRONG_GAIN_OF_VELOCITY = 0.1
"""Deviation of the gain of a recorded velocity against the position from 1, from which it is not its derivative."""
LAG_OF_VELOCITY = 5e-3
"""Lag in s of a recorded velocity that a smoother may have."""
WRONG_SIGN_WORK = -0.2
"""Work done on the damper over the largest work of the same forces, below which a sign is wrong. The work on a damper is
positive at every usual delay."""


def check_units(checked: CheckedRun) -> Iterator[Finding]:
    """Find values that no small damper has in SI units."""
    run = checked.run
    span, current, force = float(np.ptp(run.position)), float(np.abs(run.current).max()), float(np.ptp(run.force))
    if span > LARGEST_STROKE:
        text = f"the position spans {span:.3g} m: expected at most {LARGEST_STROKE:g} m. If it is in mm, convert it to m."
        yield checked.finding("rig", "fault", "position", text)
    if current > LARGEST.current:
        text = (
            f"the current reaches {current:.3g} A: expected at most {LARGEST.current:g} A. If it is in mA, convert it to A."
        )
        yield checked.finding("rig", "fault", "current", text)
    if force > LARGEST_FORCE:
        text = f"the force spans {force:.3g} N: expected at most {LARGEST_FORCE:g} N. If it is in mN, convert it to N."
        yield checked.finding("rig", "fault", "force", text)


def check_small_forces(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    """Find forces that may be those of a very small damper, or in kN."""
    spans = [float(np.ptp(checked.run.force)) for checked in runs if checked.moves]
    if spans and 0.0 < max(spans) < FEW_NEWTONS:
        text = (
            f"the force spans at most {max(spans):.3g} N, as that of a very small damper does. If it is in kN or V, convert "
            "it to N: all forces in this report are then too small by that factor, and nothing else changes."
        )
        severity: Severity = "limitation" if max(spans) < VERY_FEW_NEWTONS else "remark"
        yield Finding("rig", severity, text, channel="force")


def check_dead_channels(checked: CheckedRun) -> Iterator[Finding]:
    """Find channels that do not respond to the motion or to the force."""
    position = checked.channels["position"]
    if checked.moves:
        yield from _check_dead_force(checked)
    elif np.std(position.values) <= 1.3 * position.noise or np.ptp(position.values) <= 2.5 * position.resolution:
        yield from _check_dead_position(checked)
    acceleration = checked.channels.get("acceleration")
    if acceleration is None or not checked.moves:
        return
    if np.ptp(acceleration.values) <= 2 * acceleration.resolution:
        text = (
            "the acceleration is constant while the rod moves: expected the acceleration of the rod. The channel tells "
            "nothing. Check the accelerometer."
        )
        yield checked.finding("dead_channel", "remark", "acceleration", text)


def _check_dead_force(checked: CheckedRun) -> Iterator[Finding]:
    run = checked.run
    if np.ptp(run.force) <= 2 * checked.channels["force"].resolution:
        text = (
            f"the force stays at {run.force[0]:.4g} N while the rod moves over {milli(checked.stroke)} mm: expected the "
            "force of a damper. Check the load cell and its channel."
        )
        yield checked.finding("dead_channel", "fault", "force", text)
    elif len(checked.stroke_starts) > FEW_STROKES:
        correlation = float(np.abs(cross_correlation(run.velocity, signal.detrend(run.force))[1]).max())
        if correlation < UNRELATED_CORRELATION:
            text = (
                f"the force does not respond to the motion: its correlation with the velocity is at most {correlation:.2g} "
                f"at any delay, expected above {UNRELATED_CORRELATION:g}. Check the load cell and its channel, and whether "
                "the damper is mounted."
            )
            yield checked.finding("dead_channel", "fault", "force", text)


def _check_dead_position(checked: CheckedRun) -> Iterator[Finding]:
    run = checked.run
    low, high = np.quantile(run.force, [0.01, 0.99])
    from_middle = run.force - 0.5 * (low + high)
    sides = np.sign(from_middle)[np.abs(from_middle) > 0.25 * (high - low)]
    swings = np.count_nonzero(np.diff(sides)) > FEW_STROKES
    if high - low > max(10 * checked.channels["force"].noise, SWING * checked.scales.force) and swings:
        # Steps of the current change the force on a resting rod as well: they then explain most of its variance.
        by_current = checked.current_varies and np.corrcoef(run.current, run.force)[0, 1] ** 2 > 0.5
        text = (
            f"the position rests at {milli(run.position[0])} mm while the force swings over {high - low:.3g} N: expected "
            "the motion that causes this force. Check the position sensor."
        )
        yield checked.finding("dead_channel", "limitation" if by_current else "fault", "position", text)


def check_accelerometer(checked: CheckedRun) -> Iterator[Finding]:
    """Find an accelerometer whose gain or lag does not fit the position.

    The second difference of the position is exactly the average of the acceleration over the samples between, with
    triangular weights. So the accelerometer is filtered with these weights and compared with that difference: no derivative
    has to be estimated.
    """
    run, interval = checked.run, checked.sampling_interval
    if run.acceleration is None or not checked.moves or np.ptp(run.acceleration) == 0:
        return
    if np.ptp(np.diff(run.time)) > 0.5 * interval:
        return
    width = max(1, round(AVERAGING_TIME * run.rate))
    measured, expected = _averaged_accelerations(run.acceleration, run.position, width, interval)
    # A second difference has sqrt(6) = 2.45 times the noise of the position.
    noise = checked.channels["position"].noise
    if len(expected) < 10 * width or np.std(expected) < 5 * 2.45 * noise / (width * interval) ** 2:
        return
    reach = min(len(expected) // 4, round(LONGEST_LAG * run.rate))
    shifts, correlation = cross_correlation(expected, measured, reach)
    # A turned accelerometer has a correlation near -1 without a shift; another signal has a small one at every shift.
    if correlation[reach] < -0.9 or correlation.max() < 0.5:
        text = (
            "the acceleration does not follow the motion: its correlation with the acceleration of the position is "
            f"{correlation[reach]:.2g}, expected 1. Check that the accelerometer sits on the rod and is positive where the "
            "velocity of extension grows."
        )
        yield checked.finding("rig", "limitation", "acceleration", text)
        return
    # A periodic motion allows several lags: take the smallest.
    near = shifts[correlation > correlation.max() - 0.01]
    shift = int(near[np.argmin(np.abs(near))])
    gain, lag, error = _gain_and_lag(*overlap(expected, measured, shift), reach=reach, averaged=2 * width)
    lag, error = (shift + lag) * interval, error * interval
    if not ACCELEROMETER_GAIN[0] < gain < ACCELEROMETER_GAIN[1] and correlation.max() > 0.95:
        advice = "It is probably in g: convert it to m/s²" if 0.08 < gain < 0.125 else "Check its place and its unit, m/s²"
        text = (
            f"the acceleration is {gain:.3g} times the acceleration of the position: expected {ACCELEROMETER_GAIN[0]:g} to "
            f"{ACCELEROMETER_GAIN[1]:g}. {advice}."
        )
        yield checked.finding("rig", "limitation", "acceleration", text)
    if abs(lag) > ALLOWED_LAG + 2 * error and abs(lag) > 4 * error:
        late, early = ("acceleration", "position") if lag > 0 else ("position", "acceleration")
        text = (
            f"the {late} lags the {early} by {milli(abs(lag))} ± {milli(1.96 * error)} ms: expected less than "
            f"{milli(ALLOWED_LAG)} ms. A velocity computed from both is wrong. Sample all channels at the same time, with "
            "the same filters."
        )
        yield checked.finding("lag", "limitation", late, text)


def _averaged_accelerations(acceleration: Array, position: Array, width: int, interval: float) -> tuple[Array, Array]:
    """Average two accelerations with triangular weights over twice ``width`` samples, and remove their means."""
    triangle = np.bartlett(2 * width + 1)[1:-1] / width
    measured = np.convolve(acceleration, triangle, "valid")
    expected = (position[2 * width :] - 2 * position[width:-width] + position[: -2 * width]) / (width * interval) ** 2
    return measured[1:-1] - measured[1:-1].mean(), expected - expected.mean()


def _gain_and_lag(expected: Array, measured: Array, reach: int, averaged: int) -> tuple[float, float, float]:
    """Fit gain and lag of a measured series against the expected one; return gain, lag and the error of the lag in samples.

    ``averaged`` is the number of samples over which both series were averaged.
    """
    index, lag = np.arange(len(expected), dtype=float), 0.0
    for _ in range(4):
        shifted = np.interp(index - lag, index, expected)
        design = np.stack([shifted, -np.gradient(shifted), np.ones_like(expected)], axis=1)
        (gain, slope, _), *_ = np.linalg.lstsq(design, measured, rcond=None)
        lag = float(np.clip(lag + slope / gain, -reach, reach))
    residual = measured - design @ [gain, slope, measured.mean()]
    # Averages that overlap hold one independent value in each averaged span.
    error = float(np.std(residual) * np.sqrt(averaged) / (abs(gain) * np.linalg.norm(design[:, 1])))
    return float(gain), lag, error


def check_velocity(checked: CheckedRun) -> Iterator[Finding]:
    """Find a recorded velocity that is not the derivative of the recorded position, because either was filtered or shifted.

    Both are averaged over the same time, the velocity by its integral and the position by its difference, so that no
    derivative has to be estimated.
    """
    run, interval = checked.run, checked.sampling_interval
    if checked.is_slowly_sampled or not checked.moves or np.ptp(np.diff(run.time)) > 0.5 * interval:
        return
    width = max(1, round(AVERAGING_TIME * run.rate))
    path = np.append(0.0, np.cumsum(0.5 * (run.velocity[1:] + run.velocity[:-1]))) * interval
    expected, measured = (series[width:] - series[:-width] for series in (run.position, path))
    expected, measured = expected - expected.mean(), measured - measured.mean()
    reach = min(len(expected) // 4, round(LONGEST_LAG * run.rate))
    if reach < 1 or np.std(expected) < 10 * checked.channels["position"].noise or np.std(measured) == 0:
        return
    gain, lag, _ = _gain_and_lag(expected, measured, reach=reach, averaged=width)
    lag *= interval
    if abs(gain - 1) > WRONG_GAIN_OF_VELOCITY or abs(lag) > LAG_OF_VELOCITY + interval:
        shift = f"{milli(abs(lag))} ms {'late' if lag > 0 else 'early'}"
        text = (
            f"the recorded velocity is {gain:.3g} times that of the position and {shift}: expected the derivative of the "
            "position. It was filtered or shifted, so that forces come out at wrong speeds. Leave the velocity out of the "
            "file: it is then computed from the position."
        )
        yield checked.finding("lag", "limitation", "velocity", text)


def check_signs(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    """Find runs in which the damper would drive the rod."""
    moving = [checked for checked in runs if checked.moves and len(checked.stroke_starts) > FEW_STROKES]
    wrong = [checked for checked in moving if relative_work(checked.run) < WRONG_SIGN_WORK]
    text = (
        "the force or the position has the wrong sign{}: F·v is negative on average, expected positive (force > 0 resists "
        "extension, position > 0 extends). Turn the wrong one with `{} {} --flip force --output DIR`, or --flip position."
    )
    turn = command("mrd_runs", "import")
    if wrong and len(wrong) == len(moving):
        yield Finding("rig", "fault", text.format(" in all runs", turn, "FILE..."), channel="force")
        return
    for checked in wrong:
        yield checked.finding("rig", "fault", "force", text.format("", turn, "FILE"))
