"""What limits the trust in a fit, in plain words."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from mrd_identification.problem import Problem
from mrd_identification.uncertainty import FEWEST_SPARE_BLOCKS, Uncertainty, normal_inverse
from mrd_sim.models import Parameter
from mrd_sim.path import Path

Array = NDArray[np.float64]

FEW_SAMPLES = 60
"""Samples: a parameter that shows on fewer of them rests on little."""

AT_ONCE = 3
"""Samples: what happens in fewer of them after a reversal has no course that could be fitted."""

UNKNOWN = 0.5
"""Share of the range between a parameter's bounds; an interval that holds more says nothing."""

DECADE = 10.0
"""Ratio of an interval's ends: of a parameter on a logarithmic scale, not even the order of magnitude is known."""

LOOSE = 0.1
"""Share of the range up to which an interval is good enough, whatever else there is to say of its parameter."""

CONFOUNDED = 0.98
"""Correlation of two parameters by the sensitivities alone, whatever the errors were."""

OTHER_RUNS = "add runs that differ in speed, stroke and current"


def cautions(problem: Problem, theta: Array, uncertain: Uncertainty, seeds: Sequence[Array], held_out_by: str) -> list[str]:
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
    needed = int(np.sum(~uncertain.on_bound)) + FEWEST_SPARE_BLOCKS + problem.run_offsets
    if 0 < uncertain.blocks < needed:
        found.append(
            f"no intervals: the errors hang together so long that these runs hold {uncertain.blocks} independent stretches, "
            f"{needed} are needed for {needed - FEWEST_SPARE_BLOCKS} parameters; record longer or more runs"
        )
    unknown = set()
    for place, parameter in enumerate(problem.parameters):
        if uncertain.on_bound[place]:
            found.append(_on_bound(problem, theta, uncertain, place))
            continue
        reason = _unknown(problem, theta, uncertain, place)
        if reason:
            unknown.add(place)
            found.append(f"{parameter.name} is not identifiable from these runs: {reason}")
            continue
        sentence = _one_sided(parameter, *_interval(uncertain, place))
        if sentence:
            found.append(sentence)
    found += _confounded(problem, uncertain, unknown)
    costs = np.array([problem.cost(seed) for seed in seeds])
    # A thousandth of the force beside it, for fits without any error.
    worse = costs > 1.02 * costs.min() + 0.5e-6 * np.sum((problem.force - problem.force.mean()) ** 2)
    if worse.any():
        found.append(
            f"{worse.sum()} of {len(seeds)} seeds of the search ended in another, worse optimum; "
            "more generations or a larger population make sure of the best one"
        )
    if held_out_by == "none":
        why = "one run only" if len(problem.recordings) == 1 else "without least squares no run is left out in turn"
        found.append(f"{why}: nothing judges the fit; give --held-out")
    return found


def _interval(uncertain: Uncertainty, place: int) -> tuple[float, float]:
    """95 % interval: from the profile, which sees curvature and bounds, where it was computed."""
    lower, upper = uncertain.profile_lower[place], uncertain.profile_upper[place]
    if np.isfinite(lower) and np.isfinite(upper):
        return float(lower), float(upper)
    return float(uncertain.lower[place]), float(uncertain.upper[place])


def _share(parameter: Parameter, lower: float, upper: float) -> float:
    """How much of the range between the bounds an interval holds; nan without an interval."""
    lower, upper = max(lower, parameter.lower), min(upper, parameter.upper)
    if parameter.log:
        return float(np.log(upper / lower) / np.log(parameter.upper / parameter.lower))
    return (upper - lower) / (parameter.upper - parameter.lower)


def _with_unit(value: float, parameter: Parameter) -> str:
    return f"{value:.3g} {parameter.unit}".rstrip()


def _on_bound(problem: Problem, theta: Array, uncertain: Uncertainty, place: int) -> str:
    """What the recordings say of a parameter that ended on a bound."""
    parameter = problem.parameters[place]
    at_lower = problem.unit(theta)[place] < 0.5
    bound = parameter.lower if at_lower else parameter.upper
    text = f"{parameter.name} ended on its {'lower' if at_lower else 'upper'} bound, {_with_unit(bound, parameter)}"
    if not uncertain.sensitivity[:, place].any():
        return f"{text}, near which it does not change the modelled force: the runs say nothing of it"
    end = float((uncertain.profile_upper if at_lower else uncertain.profile_lower)[place])
    if np.isfinite(end) and _share(parameter, min(bound, end), max(bound, end)) > UNKNOWN:
        return f"{text}, but the runs say next to nothing of it: they fit as well with {_with_unit(end, parameter)}"
    if uncertain.beyond[place] > 2.0:
        return f"{text}; the runs want a value beyond it, so it stands in for something that the model lacks"
    if np.isfinite(end):
        return f"{text}; the runs fit as well with anything from there to {_with_unit(end, parameter)}"
    return f"{text}: the runs want a value near it, or say nothing about it"


def _unknown(problem: Problem, theta: Array, uncertain: Uncertainty, place: int) -> str:
    """Why a parameter is not identifiable; empty if it is, or where there are no intervals to tell by."""
    parameter = problem.parameters[place]
    if not uncertain.sensitivity[:, place].any():
        return "it does not change the modelled force at all"
    lower, upper = _interval(uncertain, place)
    lower, upper = max(lower, parameter.lower), min(upper, parameter.upper)
    if _share(parameter, lower, upper) > UNKNOWN or (parameter.log and upper > DECADE * lower):
        return _why(problem, theta, uncertain, place)
    return ""


def _one_sided(parameter: Parameter, lower: float, upper: float) -> str:
    """What is to be said of a loose interval that reaches to a bound or holds 0; empty if nothing."""
    if not _share(parameter, lower, upper) > LOOSE:
        return ""
    lower, upper = max(lower, parameter.lower), min(upper, parameter.upper)
    if lower <= 0.0 <= upper:
        return (
            f"{parameter.name} cannot be told from 0: the runs fit as well with anything from {lower:.3g} to "
            f"{_with_unit(upper, parameter)}"
        )
    open_below, open_above = np.isclose([lower, upper], [parameter.lower, parameter.upper], rtol=1e-4, atol=0)
    if open_below or open_above:
        from_ = f"{'its lower bound, ' if open_below else ''}{_with_unit(lower, parameter)}"
        to = f"{'its upper bound, ' if open_above else ''}{_with_unit(upper, parameter)}"
        return f"{parameter.name} is bounded on one side only: the runs fit as well with anything from {from_} to {to}"
    return ""


def _likeness(uncertain: Uncertainty) -> Array:
    """Correlation (free, free) of the parameters that white errors would give, so by the sensitivities alone.

    One that comes about by the errors at hand is not cured by other runs.
    """
    norm = np.linalg.norm(uncertain.sensitivity, axis=0)
    places = np.flatnonzero((norm > 0) & ~uncertain.on_bound)
    found = np.eye(len(norm))
    if places.size:
        scaled = uncertain.sensitivity[:, places] / norm[places]
        inverse = normal_inverse(scaled.T @ scaled)
        deviation = np.sqrt(np.diag(inverse))
        found[np.ix_(places, places)] = inverse / np.outer(deviation, deviation)
    return found


def _confounded(problem: Problem, uncertain: Uncertainty, unknown: set[int]) -> list[str]:
    """Groups of parameters that change the force alike and are loose for it."""
    correlation = _likeness(uncertain)
    # Where there are no intervals at all, nothing shows that they are tight enough.
    loose = np.array(
        [not _share(parameter, *_interval(uncertain, place)) <= LOOSE for place, parameter in enumerate(problem.parameters)]
    )
    alike = np.triu(np.abs(correlation) > CONFOUNDED, 1) & (loose[:, None] | loose)
    count, group_of = connected_components(alike, directed=False)
    found = []
    for group in range(count):
        members = np.flatnonzero(group_of == group)
        if len(members) < 2 or set(members) <= unknown:
            continue
        names = [problem.parameters[member].name for member in members]
        among = np.ix_(members, members)
        strongest = max(correlation[among][alike[among]], key=abs)
        up_to, which = ("", "one") if len(names) == 2 else ("up to ", "some")
        found.append(
            f"{', '.join(names[:-1])} and {names[-1]} cannot be told apart well: correlation {up_to}{strongest:.3f}; "
            f"fix {which} of them, or {OTHER_RUNS}"
        )
    return found


def _why(problem: Problem, theta: Array, uncertain: Uncertainty, place: int) -> str:
    """What the recordings lack for a parameter."""
    column = np.abs(uncertain.sensitivity[:, place])
    energy = np.sort(column**2)[::-1]
    needed = 1 + int(np.searchsorted(np.cumsum(energy), 0.9 * energy.sum()))
    shows = column >= np.sqrt(energy[min(needed, len(energy)) - 1])
    near = np.concatenate([_from_reversal(r.path)[:, r.counted] for r in problem.recordings], axis=1)[:, shows]
    travel, samples = np.quantile(near, 0.9, axis=1, method="higher")  # between two infinities lies no number
    if samples <= AT_ONCE:
        return (
            f"nine tenths of what it changes fall on {needed} samples, within {1e3 * travel:.2g} mm of where the rod "
            "reverses; sample faster, or let it reverse more often and more slowly"
        )
    if needed < FEW_SAMPLES:
        return f"nine tenths of what it changes fall on {needed} samples only; record more of what makes it show"
    likeness = _likeness(uncertain)[place]
    likeness[place] = 0.0
    other = int(np.argmax(np.abs(likeness)))
    if abs(likeness[other]) > 0.95:
        return (
            f"what it changes, {problem.parameters[other].name} changes too (correlation {likeness[other]:.3f}); "
            f"fix one of them, or {OTHER_RUNS}"
        )
    change, error = (float(np.sqrt(np.mean(of**2))) for of in (column, problem.residuals(theta)))
    return f"from bound to bound it changes the force by about {change:.2g} N rms, beside an error of {error:.2g} N rms"


def _from_reversal(path: Path) -> Array:
    """How far the rod, at each sample, is from where it last turned or will turn: metres and samples, (2, n)."""
    travelled = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(path.position)))))
    turns = np.flatnonzero(path.velocity == 0.0)
    if not turns.size:
        return np.full((2, len(path.samples)), np.inf)
    after = np.searchsorted(turns, path.samples)
    nearest = np.full((2, len(path.samples)), np.inf)
    for neighbour in (after - 1, after):
        turn = turns[np.clip(neighbour, 0, len(turns) - 1)]
        metres = np.abs(travelled[path.samples] - travelled[turn])
        # The first sample after a turn is one away from it, and so is the last before it.
        between = np.abs(np.arange(len(path.samples)) - (np.searchsorted(path.samples, turn) - 0.5)) + 0.5
        nearest = np.minimum(nearest, [metres, between])
    return nearest
