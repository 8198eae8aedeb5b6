"""Sensors against each other and against what a damper can do: units, dead channels, accelerometer, signs."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import signal

from mrd_diagnosis.diagnosis import Finding
from mrd_diagnosis.preflight.channels import FEW_STROKES, MOVED, View, correlations, milli, overlap

UNRELATED = 0.1
"""Largest correlation of force and velocity, whatever the lag, of a force that does not respond."""
LAG = 2e-3
"""s between position and accelerometer; filters of usual sensors (100 Hz and more) differ by less."""
LONGEST_LAG = 0.25
"""s that is looked for."""
AVERAGED = 0.02
"""s over which position and accelerometer are averaged for it: 8 µm of noise in positions then are 0.05 m/s²."""
ACCELEROMETER = (0.8, 1.25)
"""Gain against the position, as in `mrd_runs.signals.motion`; outside, it is not one of the rod in m/s²."""
OPPOSITE = -0.2
"""Dissipated work over the work that the same forces could do; a damper's is positive, at whatever usual delay."""
LARGEST_STROKE, LARGEST_CURRENT, SMALLEST_FORCE, LARGEST_FORCE = 0.5, 10.0, 5.0, 1e5
"""m, A, N, N peak to peak, of what is likely recorded in another unit (small MR dampers: 5 A, some tens of N at rest)."""


def units(view: View) -> Iterator[Finding]:
    """Sizes that no small damper has in SI units."""
    run = view.run
    current, force = float(np.abs(run.current).max()), float(np.ptp(run.force))
    if np.ptp(run.position) > LARGEST_STROKE:
        yield view.finding(
            "rig",
            "fault",
            "position",
            f"spans {np.ptp(run.position):.3g}, expected at most {LARGEST_STROKE:g} m; is it in mm? Convert it to m",
        )
    if current > LARGEST_CURRENT:
        yield view.finding(
            "rig",
            "fault",
            "current",
            f"reaches {current:.3g}, expected at most {LARGEST_CURRENT:g} A; is it in mA? Convert it to A",
        )
    # A dead force says so itself.
    if force > LARGEST_FORCE or (view.stroke > MOVED and 2 * view.channels["force"].step < force < SMALLEST_FORCE):
        small = force < SMALLEST_FORCE
        yield view.finding(
            "rig",
            "fault",
            "force",
            f"spans {force:.3g}, expected {SMALLEST_FORCE:g} to {LARGEST_FORCE:g} N; is it in "
            f"{'kN or V' if small else 'mN'}? Convert it to N",
        )


def dead(view: View) -> Iterator[Finding]:
    """Channels that do not respond."""
    run, force, position = view.run, view.channels["force"], view.channels["position"]
    if view.stroke > MOVED:
        if np.ptp(run.force) <= 2 * force.step:
            yield view.finding(
                "dead_channel",
                "fault",
                "force",
                f"stays at {run.force[0]:.4g} N while the rod moves over {milli(view.stroke)} mm; expected a damper's "
                "force: look at the load cell and its channel",
            )
        elif len(view.strokes) > FEW_STROKES:
            related = float(np.abs(correlations(run.velocity, signal.detrend(run.force))[1]).max())
            if related < UNRELATED:
                yield view.finding(
                    "dead_channel",
                    "fault",
                    "force",
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
                "dead_channel",
                "limitation" if by_current else "fault",
                "position",
                f"rests at {milli(run.position[0])} mm while the force swings over {high - low:.3g} N; expected the "
                "motion that causes it: look at the position sensor",
            )
    still = run.acceleration is not None and np.ptp(run.acceleration) <= 2 * view.channels["acceleration"].step
    if still and view.stroke > MOVED:
        yield view.finding(
            "dead_channel", "remark", "acceleration", "is constant while the rod moves: of no use; look at the sensor"
        )


def accelerometer(view: View) -> Iterator[Finding]:
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
    shifts, related = correlations(true, read, reach)
    # Of the lags that a periodic motion allows, the smallest.
    near = shifts[related > related.max() - 0.01]
    shift = int(near[np.argmin(np.abs(near))])
    if related[reach] < -0.9 or related.max() < 0.5:
        yield view.finding(
            "rig",
            "limitation",
            "acceleration",
            f"does not follow the motion (correlation {related[reach]:.2g} with the acceleration of the position, expected "
            "1); is it the rod's, > 0 where it extends faster?",
        )
        return
    a, b = overlap(true, read, shift)
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
            "rig",
            "limitation",
            "acceleration",
            f"is {gain:.3g} times the acceleration of the position, expected {ACCELEROMETER[0]:g} to {ACCELEROMETER[1]:g}; "
            f"is it the rod's{', in g instead of m/s²' if 0.08 < gain < 0.125 else ', in m/s²'}?",
        )
    if abs(lag) > LAG + 2 * error and abs(lag) > 4 * error:
        late_one, early = ("acceleration", "position") if lag > 0 else ("position", "acceleration")
        yield view.finding(
            "lag",
            "limitation",
            late_one,
            f"comes {milli(abs(lag))} ± {milli(1.96 * error)} ms after {early}, expected less than {milli(LAG)} ms: "
            "velocities from both are wrong; sample all channels at once, with the same filters",
        )


def signs(views: Sequence[View]) -> Iterator[Finding]:
    """Dampers that would drive the rod."""
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


def _dissipation(view: View) -> float:
    """Work done on the damper over what the same forces and ways could do at most."""
    force = view.run.force - view.run.force.mean()
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(view.run.position)
    # Noise of the position does work to and fro: count it over stretches.
    count = max(1, len(work) // 200)
    parts = np.array([part.sum() for part in np.array_split(work, max(1, len(work) // count))])
    total = float(np.abs(parts).sum())
    return float(parts.sum()) / total if total else 0.0
