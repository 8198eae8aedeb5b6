"""What limits the trust in a fit, in plain words."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_identification.problem import Problem, Recording
from mrd_identification.uncertainty import Uncertainty
from mrd_runs.motion import motion

Array = NDArray[np.float64]

FEW_SAMPLES = 60
"""Samples: a parameter that shows on fewer of them rests on little."""


def cautions(
    problem: Problem, theta: Array, uncertain: Uncertainty, seeds: Sequence[Array], held_out_by: str
) -> list[str]:
    """Sentences about intervals, bounds, confounded parameters, seeds and judges, each with what to do about it.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (parameters,)
    uncertain : Uncertainty
    seeds : sequence of ndarray (parameters,)
        What each seed of the search came to.
    held_out_by : str
        See `mrd_identification.identify.Fit`.
    """
    found = []
    if uncertain.blocks and not np.isfinite(uncertain.lower).any():
        found.append(
            f"no intervals: the errors are independent over {uncertain.blocks} stretches only, too few for "
            f"{len(problem.free)} parameters; record longer or more runs"
        )
    for place, (index, parameter) in enumerate(zip(problem.free, problem.parameters, strict=True)):
        value, lower, upper = theta[index], uncertain.lower[place], uncertain.upper[place]
        open_ends = [
            side
            for side, end, bound in (
                ("lower", uncertain.profile_lower[place], parameter.lower),
                ("upper", uncertain.profile_upper[place], parameter.upper),
            )
            if np.isclose(end, bound, rtol=1e-4, atol=0)
        ]
        if uncertain.on_bound[place]:
            side = "lower" if np.isclose(value, parameter.lower) else "upper"
            found.append(
                f"{parameter.name} ended on its {side} bound, {f'{value:g} {parameter.unit}'.rstrip()}: "
                "the runs want a value beyond it, or say nothing about it"
            )
        elif _wide(problem, place, value, lower, upper) or len(open_ends) == 2:
            found.append(f"{parameter.name} is not identifiable from these runs: {_why(problem, uncertain, place)}")
        elif open_ends:
            found.append(
                f"{parameter.name} is bounded on one side only: the runs fit as well up to its {open_ends[0]} bound"
            )
    correlation = uncertain.correlation
    for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > 0.98, 1)), strict=True):
        found.append(
            f"{problem.parameters[i].name} and {problem.parameters[j].name} cannot be told apart well: "
            f"correlation {correlation[i, j]:.3f}; fix one of them, or add runs that differ in speed, stroke and current"
        )
    costs = np.array([problem.cost(seed) for seed in seeds])
    worse = costs > 1.02 * costs.min()
    if worse.any():
        found.append(
            f"{worse.sum()} of {len(seeds)} seeds of the search ended in another, worse optimum; "
            "more generations or a larger population make sure of the best one"
        )
    if held_out_by == "none":
        why = "one run only" if len(problem.recordings) == 1 else "without least squares no run is left out in turn"
        found.append(f"{why}: nothing judges the fit; give --held-out")
    return found


def _wide(problem: Problem, place: int, value: float, lower: float, upper: float) -> bool:
    """Whether an interval says next to nothing: of half the range searched, or of a tenth and twice the value besides."""
    parameter = problem.parameters[place]
    if parameter.log:
        share = np.log(upper / lower) / np.log(parameter.upper / parameter.lower)
    else:
        share = (upper - lower) / (parameter.upper - parameter.lower)
    return bool(share > 0.5 or (share > 0.1 and upper - lower >= 2 * abs(value)))


def _why(problem: Problem, uncertain: Uncertainty, place: int) -> str:
    """What the recordings lack for a parameter."""
    column = np.abs(uncertain.sensitivity[:, place])
    energy = np.sort(column**2)[::-1]
    if energy.sum() == 0:
        return "it does not change the modelled force at all"
    needed = 1 + int(np.searchsorted(np.cumsum(energy), 0.9 * energy.sum()))
    if needed < FEW_SAMPLES:
        where = column >= np.sqrt(energy[needed - 1])
        since = np.concatenate([_travel_since_reversal(recording)[recording.counted] for recording in problem.recordings])
        return (
            f"nine tenths of what it changes fall on {needed} samples, within {1e3 * since[where].max():.2g} mm after the "
            "rod reverses; sample faster, or let it reverse more often and more slowly"
        )
    partner = np.abs(uncertain.correlation[place]).copy()
    partner[place] = 0.0
    if partner.max() > 0.95:
        other = problem.parameters[int(np.argmax(partner))].name
        return f"what it changes, {other} changes too (correlation {uncertain.correlation[place, np.argmax(partner)]:.2f})"
    change = float(np.sqrt(energy.mean()))
    return f"from bound to bound it changes the force by about {change:.2g} N rms, too little beside the error"


def _travel_since_reversal(recording: Recording) -> Array:
    """Distance in m that the rod has moved, at each sample, since it last turned round."""
    moved = motion(recording.run)
    travelled = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(moved.position)))))
    turns = np.flatnonzero(np.diff(np.sign(moved.velocity)) != 0) + 1
    last = np.searchsorted(turns, np.arange(len(travelled)), side="right") - 1
    started = np.where(last >= 0, travelled[turns[np.maximum(last, 0)]] if turns.size else 0.0, 0.0)
    return np.asarray(travelled - started)
