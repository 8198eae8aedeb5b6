"""Response of the force to steps of the coil current at constant speed.

The method follows Koo, Goncalves and Ahmadian (2003): the rod moves at constant speed while the current steps, and the
response time is that until the force has made 63.2 or 95 % of its change.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mrd_characterisation.average import RUNS_FOR_INTERVAL, Average, average
from mrd_characterisation.characterisation import SAME_CURRENT, SAME_SPEED, Direction, Response, Value
from mrd_characterisation.strokes import grouped, rounded
from mrd_runs.signals.current_steps import LEAST_STEP, current_steps
from mrd_runs.signals.smoothed_run import SmoothedRun

Array = NDArray[np.float64]

CONSTANT = 0.05
"""Relative change of the speed up to which it is constant."""

SLOWEST = 0.02
"""Least speed over that of the fast strokes; below, the force of a step grows with the travel rather than with time."""

FEWEST_NEAR = 6
"""Samples that a parabola through a crossing needs."""

FEWEST_BEFORE, FEWEST_AFTER = 5, 15
"""Samples of constant speed and current before and after a step that is used."""

FEWEST_STEPS = 2
"""Equal steps that are needed: of a single one nobody knows how far it is random."""

USUAL_HOLD = 0.75
"""Quantile of the times after the steps that is looked at first; steps that were cut shorter are left out."""

LENGTHS = 5.0
"""Time that is looked at after a step, over the time in which the force makes 95 % of its change."""

BEFORE, TAIL = 0.25, 0.6
"""The force before a step is that of this share of the time looked at; the settled force that from this share on."""

TAIL_PASSES, SETTLED_TAIL = 3, 1e-3
"""Times that the exponential of the tail is fitted; share of the change that is left when a tail has settled."""

SETTLES = 0.7
"""Largest response time over the time looked at; beyond, the force has not settled, and its change is not known."""

LEAST_CHANGE = 5.0
"""Change of the force over its noise in the mean of the steps, below which there is no response to measure."""

BEGUN = 0.05
"""Share of its change from which on a current has begun to step."""

RESAMPLED = 10
"""Parts into which equal steps are divided; the interval follows from leaving out each (the jackknife, Quenouille 1949).
Where there are enough runs, these are the parts."""

SHARES = {"63": 1.0 - math.exp(-1.0), "95": 0.95}

_METHOD = (
    "Time from the step of the measured current, the middle of the sampling interval in which it begins, until {what} has "
    "made {share} of its change, of the mean of equal steps while the speed is constant within 5 %. {drift}The end of the "
    "change is the level that an exponential through the last 40 % of {time} ms after the step approaches."
)
_DRIFT = "A drift of the force along the stroke, the same before and after the step, is taken out. "


@dataclass(frozen=True, eq=False)
class Step:
    """A current step at constant speed.

    Attributes
    ----------
    run : SmoothedRun
    first : int
        The sample at which the current has begun to change.
    before, after : float
        Current in A.
    velocity : float
        m/s.
    lead, quiet, hold : float
        s: constant speed before; since the step before; constant speed and current after.
    """

    run: SmoothedRun
    first: int
    before: float
    after: float
    velocity: float
    lead: float
    quiet: float
    hold: float


def steps_of(smoothed: SmoothedRun, scale: float, fast: float) -> list[Step]:
    """Return the current steps of a run at constant speed.

    Parameters
    ----------
    smoothed : SmoothedRun
    scale : float
        A, the largest current of all runs.
    fast : float
        m/s, speed of the fast strokes of all runs.
    """
    run, current, velocity = smoothed.run, smoothed.current, smoothed.motion.velocity
    # At a slow speed the noise of the position alone makes the velocity vary by more than a few per cent.
    averaged = uniform_filter1d(velocity, 2 * FEWEST_AFTER)
    places = [int(place) for place in current_steps(current, run.rate, scale)]
    steps = []
    edges = [0, *places, len(run)]
    for earlier, place, later in zip(edges[:-2], places, edges[2:], strict=True):
        if later - place < FEWEST_AFTER or place - earlier < FEWEST_BEFORE:
            continue
        before = float(np.median(current[max(earlier, place - (place - earlier) // 2) : place]))
        after = float(np.median(current[(place + later) // 2 : later]))
        if abs(after - before) < LEAST_STEP * scale:
            continue
        first = _first_changed((current - before) / (after - before), place, earlier, later)
        speed = float(np.median(velocity[max(0, first - FEWEST_BEFORE) : first + FEWEST_BEFORE]))
        if abs(speed) < SLOWEST * fast:
            continue
        varies = np.abs(averaged - speed) > CONSTANT * abs(speed)
        ahead, behind = np.flatnonzero(varies[first:later]), np.flatnonzero(varies[:first][::-1])
        held = int(ahead[0]) if len(ahead) else later - first
        lead = int(behind[0]) if len(behind) else first
        if held >= FEWEST_AFTER and min(lead, first - earlier) >= FEWEST_BEFORE:
            # The last sample before the next step may already belong to it.
            step = Step(
                smoothed, first, before, after, speed, lead / run.rate, (first - earlier) / run.rate, (held - 2) / run.rate
            )
            steps.append(step)
    return steps


def _first_changed(share: Array, place: int, earlier: int, later: int) -> int:
    """Return the first sample at which a share of the change of the current is made, near that where a step was found."""
    while place > earlier + 1 and share[place - 1] > BEGUN:
        place -= 1
    while place < later - 1 and share[place] <= BEGUN:
        place += 1
    return place


def response_values(steps: Sequence[Step], scale: float) -> tuple[list[Value], list[Response], list[str]]:
    """Return response times of force and current, mean responses, and sentences on steps that show none.

    Parameters
    ----------
    steps : sequence of Step
        Of all runs of a damper.
    scale : float
        A, the largest current.
    """
    values: list[Value] = []
    responses: list[Response] = []
    unsettled: list[float] = []
    without_response = 0
    groups = _equal_steps(steps, scale)
    repeated = [group for group in groups if len(group) >= FEWEST_STEPS]
    for group in repeated:
        found = _measured(group)
        if isinstance(found, float):
            unsettled.append(found)
        elif found is None:
            without_response += 1
        else:
            values += found[0]
            responses.append(found[1])
    notes = []
    if len(repeated) < len(groups) and not responses:
        notes.append(
            f"{_count(len(groups) - len(repeated)).capitalize()} at constant speed occurred only once: no response time. "
            "Repeat each step at the same speed."
        )
    if unsettled:
        notes.append(
            f"After {_count(len(unsettled))} the force had not settled when the current or the speed "
            f"changed again, {1e3 * min(unsettled):.3g} ms or more after the step. Hold each level at constant speed for "
            "longer."
        )
    if without_response:
        notes.append(
            f"The force does not respond to {_count(without_response)} beyond its noise. Repeat the steps "
            "more often, or take larger ones."
        )
    return values, responses, notes


def _count(kinds: int) -> str:
    return "one kind of current step" if kinds == 1 else f"{kinds} kinds of current steps"


def _equal_steps(steps: Sequence[Step], scale: float) -> list[list[Step]]:
    """Group steps of the same currents, direction and speed."""
    tolerance = 0.05 * scale
    level_of = {
        current: rounded(float(np.mean(level)), SAME_CURRENT * scale)
        if abs(np.mean(level)) > 0.5 * SAME_CURRENT * scale
        else 0.0
        for level in grouped([c for step in steps for c in (step.before, step.after)], float, lambda _: tolerance)
        for current in level
    }
    steps = [replace(step, before=level_of[step.before], after=level_of[step.after]) for step in steps]
    return [
        group
        for of_before in grouped(steps, lambda step: step.before, lambda _: 0.0)
        for of_after in grouped(of_before, lambda step: step.after, lambda _: 0.0)
        for sign in (1.0, -1.0)
        for group in grouped(
            [step for step in of_after if sign * step.velocity > 0.0],
            lambda step: abs(step.velocity),
            lambda speed: 2.0 * SAME_SPEED * speed,
        )
    ]


def _measured(steps: Sequence[Step]) -> tuple[list[Value], Response] | float | None:
    """Return the response times and the mean response of equal steps.

    The time looked at in s where the force does not settle within it; None where it does not respond beyond its noise.
    """
    hold = float(np.quantile([step.hold for step in steps], USUAL_HOLD, method="lower"))
    chosen = [step for step in steps if step.hold >= hold]
    if not _responds(chosen, hold):
        return None
    first = _times(chosen, hold)
    if first is None:
        return hold
    # Now that it is known how long the response takes, steps that were held for long enough all count.
    looked_at = min(hold, max(LENGTHS * first["force", "95"], FEWEST_AFTER / chosen[0].run.run.rate))
    longer = _long_enough(steps, looked_at)
    times = _times(longer, looked_at) if len(longer) >= FEWEST_STEPS else None
    if times is None or times["force", "95"] > SETTLES * looked_at:
        return hold
    names = [step.run.run.name for step in longer]
    runs = list(dict.fromkeys(names))
    # What changes between runs shows only where whole runs are left out.
    part_of = list(map(runs.index, names)) if len(runs) >= RUNS_FOR_INTERVAL else [n % RESAMPLED for n in range(len(longer))]
    parts = sorted(set(part_of))
    left_out = [_times([s for s, of in zip(longer, part_of, strict=True) if of != part], looked_at) for part in parts]
    direction: Direction = "rebound" if longer[0].velocity > 0.0 else "compression"
    condition: dict[str, Any] = {
        "current": longer[0].after,
        "current_before": longer[0].before,
        "speed": float(np.mean([abs(step.velocity) for step in longer])),
    }
    values = []
    for (what, share), time in times.items():
        quantity = f"{'response' if what == 'force' else what}_time_{share}"
        without = [part[what, share] for part in left_out if part is not None]
        definition = _METHOD.format(
            what=f"the {what}" if what == "force" else "the current itself",
            share="63.2 %" if share == "63" else "95 %",
            drift=_DRIFT if what == "force" else "",
            time=f"{1e3 * looked_at:.3g}",
        )
        mean = _jackknife(time, without, names)
        values.append(Value(quantity, *mean, definition, direction=direction, **condition))
    grid, force, coil = _mean_response(longer, looked_at)
    return values, Response(**condition, direction=direction, time=grid, force=force, coil=coil)


def _long_enough(steps: Sequence[Step], looked_at: float) -> list[Step]:
    """Return the steps that were held for a time in s, and before which current and speed were constant for long enough."""
    return [
        step
        for step in steps
        if step.hold >= looked_at and step.quiet >= 0.5 * looked_at and step.lead >= BEFORE * looked_at
    ]


def _jackknife(value: float, without: Sequence[float], names: Sequence[str]) -> Average:
    """Return a time with its interval from the times without each part of the steps."""
    parts, runs = len(without), len(set(names))
    if parts < 2:
        return Average(value, math.nan, math.nan, math.nan, len(names), runs)
    # Pseudo-values: what each part would give for itself.
    pseudo = average([parts * value - (parts - 1) * other for other in without], ["" for _ in without])
    half = pseudo.upper - pseudo.value
    return Average(value, value - half, value + half, pseudo.scatter * math.sqrt(len(names) / parts), len(names), runs)


def _times(steps: Sequence[Step], looked_at: float) -> dict[tuple[str, str], float] | None:
    """Return the times in s by signal ("force", "current") and share; None where the force does not respond clearly."""
    if not steps:
        return None
    grid, force, coil = _mean_response(steps, looked_at)
    times: dict[tuple[str, str], float] = {}
    for signal, series in (("force", force), ("current", coil)):
        times |= {(signal, name): _crossing(grid, series, share) for name, share in SHARES.items()}
    return None if any(map(math.isnan, times.values())) else times


def _responds(steps: Sequence[Step], looked_at: float) -> bool:
    """Return whether the change of the force is clear of its noise, in the mean of the steps."""
    grid, force, _ = _mean_response(steps, looked_at)
    return bool(np.isfinite(force).all() and LEAST_CHANGE * float(force[grid < 0.0].std()) < 1.0)


def _mean_response(steps: Sequence[Step], looked_at: float) -> tuple[Array, Array, Array]:
    """Return time from the step in s, and the mean shares of the changes of force and current."""
    rate = max(step.run.run.rate for step in steps)
    lead = min(BEFORE * looked_at, *(min(step.lead, step.quiet) for step in steps))
    # Between two samples the current is taken to change linearly: the step is in the middle.
    places = np.arange(-max(FEWEST_BEFORE, int(lead * rate)), int(looked_at * rate), dtype=np.float64)
    grid: Array = (places + 0.5) / rate
    forces, coils = [], []
    for step in steps:
        run = step.run.run
        begin, end = max(0, step.first - len(grid)), step.first + len(grid)
        since = run.time[begin:end] - 0.5 * (run.time[step.first - 1] + run.time[step.first])
        forces.append(np.interp(grid, since, run.force[begin:end]))
        coils.append(np.interp(grid, since, step.run.current[begin:end]))
    force, coil = np.asarray(np.mean(forces, axis=0)), np.asarray(np.mean(coils, axis=0))
    return grid, _share_of_change(grid, force, drifts=True), _share_of_change(grid, coil)


def _share_of_change(grid: Array, series: Array, drifts: bool = False) -> Array:
    """Return a series as share of its change: 0 before the step, 1 at the end; a drift that is the same in both is left out.

    Where the tail has not settled, it is an exponential, whose time constant follows from the crossings so far; so is what
    the step before has left.
    """
    before, tail = grid < 0.0, grid >= TAIL * grid[-1]
    used = before | tail
    columns = [np.ones(len(grid)), tail.astype(float)] + ([grid] if drifts else [])
    share = _without_drift(grid, series, columns, used)
    for _ in range(TAIL_PASSES):
        early, late = _crossing(grid, share, SHARES["63"]), _crossing(grid, share, SHARES["95"])
        constant = (late - early) / math.log((1.0 - SHARES["63"]) / (1.0 - SHARES["95"]))
        # Of a tail that has settled, the exponential would only fit the noise.
        if not constant > 0.0 or math.exp(-TAIL * grid[-1] / constant) < SETTLED_TAIL:
            break
        decays = [np.where(part, np.exp(-(grid - grid[part][0]) / constant), 0.0) for part in (tail, before)]
        share = _without_drift(grid, series, [*columns, *decays], used)
    return share


def _without_drift(grid: Array, series: Array, columns: Sequence[Array], used: NDArray[np.bool_]) -> Array:
    """Return a series without its level before the step and its drift, over its change, by least squares."""
    coefficients = np.linalg.lstsq(np.column_stack(columns)[used], series[used], rcond=None)[0]
    drift = coefficients[2] * grid if columns[2:] and columns[2] is grid else 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((series - coefficients[0] - drift) / coefficients[1])


def _crossing(grid: Array, series: Array, share: float) -> float:
    """Return the time in s at which a series first reaches a share of its change; nan where it never does.

    The crossing is that of a parabola through the samples around, over a third of the time to both sides.
    """
    after = grid > 0.0
    width = max(1, int(np.count_nonzero(after)) // 50)
    smooth = np.convolve(np.pad(series, (width // 2, (width - 1) // 2), mode="edge"), np.full(width, 1.0 / width), "valid")
    reached = np.flatnonzero(after & (smooth >= share))
    if not len(reached):
        return math.nan
    place = max(int(reached[0]), 1)
    time = _interpolated(grid, smooth, share, place)
    for _ in range(3):
        near = after & (np.abs(grid - time) <= time / 3.0)
        if np.count_nonzero(near) < FEWEST_NEAR:
            # Within a few samples noise matters less than rounding.
            return _interpolated(grid, series, share, max(1, int(np.flatnonzero(after & (series >= share))[0])))
        parabola = Polynomial.fit(grid[near] - time, series[near] - share, 2)
        roots = [root.real for root in map(complex, parabola.roots()) if abs(root.imag) < 1e-9 and abs(root) <= time / 3.0]
        if not roots:
            break
        time += min(roots, key=abs)
    return time


def _interpolated(grid: Array, series: Array, share: float, place: int) -> float:
    """Return the time in s at which a series reaches a share on its way to a sample."""
    low, high = series[place - 1], series[place]
    part = (share - low) / (high - low) if high > low else 1.0
    return float(grid[place - 1] + (grid[place] - grid[place - 1]) * np.clip(part, 0.0, 1.0))
