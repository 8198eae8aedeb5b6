"""Warnings about a fit: what limits the trust in its parameters, and what to do about it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from mrd_base.quantities import quantity
from mrd_identification.problem import Problem
from mrd_identification.uncertainty import LEAST_DEGREES_OF_FREEDOM, Uncertainty, normal_inverse
from mrd_sim.models import Parameter
from mrd_sim.path import Path

Array = NDArray[np.float64]

FEW_SAMPLES = 60
"""Samples; an estimate that depends on fewer of them is easily dominated by a few errors."""

LEAST_TRANSIENT = 3
"""Samples; a transient that is over in fewer of them has no shape that could be fitted."""

UNKNOWN = 0.5
"""Share of the distance between a parameter's bounds; a wider interval tells almost nothing that the bounds do not."""

DECADE = 10.0
"""Ratio of an interval's ends; of a parameter on a logarithmic scale, not even the order of magnitude is known."""

WIDE = 0.1
"""Share of the distance between a parameter's bounds; a narrower interval is precise enough to need no warning."""

CONFOUNDED = 0.98
"""Magnitude of the correlation, by the sensitivities alone, from which two parameters are hard to tell apart."""

CORRELATED = 0.95
"""Magnitude of the correlation from which it explains why a parameter is not identifiable."""

FAR_BEYOND = 2.0
"""Standard deviations; an optimum this far beyond a bound is not explained by noise."""

WORSE_COST = 1.02
"""Ratio of two objectives above which they are different optima, not the same one reached imprecisely."""

EXACT_FIT = 0.5e-6
"""Share of the squared force, a thousandth of the force in amplitude; differences below it do not matter in any fit."""

OTHER_RUNS = "add runs that differ in speed, stroke and current"


def fit_warnings(
    problem: Problem, theta: Array, uncertain: Uncertainty, seed_thetas: Sequence[Array], held_out_by: str
) -> list[str]:
    """Return sentences about intervals, bounds, confounded parameters, seeds and held-out runs.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (parameters,)
    uncertain : Uncertainty
    seed_thetas : sequence of ndarray (parameters,)
        Result of each seed of the search.
    held_out_by : str
        See `mrd_identification.fit.Fit`.
    """
    warnings = _too_few_segments(problem, uncertain)
    unidentifiable = set()
    for place, parameter in enumerate(problem.parameters):
        if uncertain.on_bound[place]:
            warnings.append(_on_bound(problem, theta, uncertain, place))
        elif reason := _unidentifiable(problem, theta, uncertain, place):
            unidentifiable.add(place)
            warnings.append(f"{parameter.name} is not identifiable from these runs: {reason}")
        elif sentence := _wide_interval(parameter, *_interval(uncertain, place)):
            warnings.append(sentence)
    warnings += _confounded(problem, uncertain, unidentifiable)
    warnings += _disagreeing_seeds(problem, seed_thetas)
    if held_out_by == "none":
        reason = (
            "there is one run only" if len(problem.recordings) == 1 else "runs are left out in turn only by least squares"
        )
        warnings.append(f"The prediction error is unknown, because {reason}: give --held-out runs")
    return warnings


def _too_few_segments(problem: Problem, uncertain: Uncertainty) -> list[str]:
    seen = uncertain.sensitivity.any(axis=0)  # what does not change the force has no interval in any case
    parameters = int(np.sum(seen & ~uncertain.on_bound)) + problem.run_offsets
    needed = parameters + LEAST_DEGREES_OF_FREEDOM
    if not 0 < uncertain.segments < needed:
        return []
    return [
        "There are no confidence intervals: the residuals are correlated for so long that these runs have only "
        f"{uncertain.segments} independent segments, and {parameters} parameters need {needed}; record longer or more runs"
    ]


def _disagreeing_seeds(problem: Problem, seed_thetas: Sequence[Array]) -> list[str]:
    costs = np.array([problem.cost(theta) for theta in seed_thetas])
    worse = costs > WORSE_COST * costs.min() + EXACT_FIT * np.sum((problem.force - problem.force.mean()) ** 2)
    if not worse.any():
        return []
    return [
        f"{worse.sum()} of {len(seed_thetas)} searches from different seeds ended in a worse local optimum, so there may be "
        "a better one than the best of them; search with more generations or a larger population"
    ]


def _interval(uncertain: Uncertainty, place: int) -> tuple[float, float]:
    """Return the 95 % interval: from the profile, which includes curvature and bounds, where it was computed."""
    lower, upper = uncertain.profile_lower[place], uncertain.profile_upper[place]
    if np.isfinite(lower) and np.isfinite(upper):
        return float(lower), float(upper)
    return float(uncertain.lower[place]), float(uncertain.upper[place])


def _share(parameter: Parameter, lower: float, upper: float) -> float:
    """Return the width of an interval as a share of the distance between the bounds; nan without an interval."""
    lower, upper = max(lower, parameter.lower), min(upper, parameter.upper)
    if parameter.log:
        return float(np.log(upper / lower) / np.log(parameter.upper / parameter.lower))
    return (upper - lower) / (parameter.upper - parameter.lower)


def _with_unit(value: float, parameter: Parameter) -> str:
    return quantity(float(f"{value:.3g}"), parameter.unit)


def _on_bound(problem: Problem, theta: Array, uncertain: Uncertainty, place: int) -> str:
    """Return a sentence about a parameter on its bound."""
    parameter = problem.parameters[place]
    at_lower = problem.unit(theta)[place] < 0.5
    bound = parameter.lower if at_lower else parameter.upper
    text = f"{parameter.name} is on its {'lower' if at_lower else 'upper'} bound, {_with_unit(bound, parameter)}"
    if not uncertain.sensitivity[:, place].any():
        return f"{text}. Near it the parameter does not change the modelled force, so these runs cannot determine it"
    end = float((uncertain.profile_upper if at_lower else uncertain.profile_lower)[place])
    equally_well = f"the runs are fitted equally well by every value from the bound to {_with_unit(end, parameter)}"
    if np.isfinite(end) and _share(parameter, min(bound, end), max(bound, end)) > UNKNOWN:
        return f"{text}. It is hardly determined: {equally_well}"
    if uncertain.beyond[place] > FAR_BEYOND:
        return f"{text}. The best fit lies outside this bound; the parameter may compensate for missing physics"
    if np.isfinite(end):
        return f"{text}; {equally_well}"
    return f"{text}. Either its value is near the bound, or the runs do not determine it"


def _unidentifiable(problem: Problem, theta: Array, uncertain: Uncertainty, place: int) -> str:
    """Return why a parameter is not identifiable; empty if it is, or if there are no intervals to decide by."""
    parameter = problem.parameters[place]
    if not uncertain.sensitivity[:, place].any():
        return "it does not change the modelled force at all"
    lower, upper = _interval(uncertain, place)
    lower, upper = max(lower, parameter.lower), min(upper, parameter.upper)
    if _share(parameter, lower, upper) > UNKNOWN or (parameter.log and upper > DECADE * lower):
        return _lacking_information(problem, theta, uncertain, place)
    return ""


def _wide_interval(parameter: Parameter, lower: float, upper: float) -> str:
    """Return a sentence about a wide interval that includes 0 or reaches to a bound; empty for any other interval."""
    if not _share(parameter, lower, upper) > WIDE:
        return ""
    lower, upper = max(lower, parameter.lower), min(upper, parameter.upper)
    if lower <= 0.0 <= upper:
        least = _with_unit(lower, parameter) if lower < 0.0 else "0"
        return (
            f"{parameter.name} may be 0: the runs are fitted equally well by every value from {least} to "
            f"{_with_unit(upper, parameter)}"
        )
    open_below, open_above = np.isclose([lower, upper], [parameter.lower, parameter.upper], rtol=1e-4, atol=0)
    if open_below or open_above:
        from_ = f"{'its lower bound, ' if open_below else ''}{_with_unit(lower, parameter)}"
        to = f"{'its upper bound, ' if open_above else ''}{_with_unit(upper, parameter)}"
        return (
            f"The runs limit {parameter.name} on one side only: they are fitted equally well by every value from {from_} "
            f"to {to}"
        )
    return ""


def _sensitivity_correlation(uncertain: Uncertainty) -> Array:
    """Return the correlation (free, free) of the parameters for white errors, that is by the sensitivities alone.

    Only this part of the correlation can be reduced by other runs; the part from the errors at hand cannot.
    """
    norm = np.linalg.norm(uncertain.sensitivity, axis=0)
    places = np.flatnonzero((norm > 0) & ~uncertain.on_bound)
    correlation = np.eye(len(norm))
    if places.size:
        scaled = uncertain.sensitivity[:, places] / norm[places]
        inverse = normal_inverse(scaled.T @ scaled)
        deviation = np.sqrt(np.diag(inverse))
        correlation[np.ix_(places, places)] = inverse / np.outer(deviation, deviation)
    return correlation


def _confounded(problem: Problem, uncertain: Uncertainty, unidentifiable: set[int]) -> list[str]:
    """Return a sentence about each group of parameters that change the force in the same way and have wide intervals."""
    correlation = _sensitivity_correlation(uncertain)
    # A missing interval counts as wide: nothing shows that the parameter is known precisely.
    wide = np.array(
        [not _share(parameter, *_interval(uncertain, place)) <= WIDE for place, parameter in enumerate(problem.parameters)]
    )
    confounded = np.triu(np.abs(correlation) > CONFOUNDED, 1) & (wide[:, None] | wide)
    count, group_numbers = connected_components(confounded, directed=False)
    warnings = []
    for group in range(count):
        members = np.flatnonzero(group_numbers == group)
        if len(members) < 2 or set(members) <= unidentifiable:
            continue
        names = [problem.parameters[member].name for member in members]
        pairs = np.ix_(members, members)
        strongest = max(correlation[pairs][confounded[pairs]], key=abs)
        up_to, which = ("", "one") if len(names) == 2 else ("up to ", "some")
        warnings.append(
            f"{', '.join(names[:-1])} and {names[-1]} change the force in nearly the same way (correlation "
            f"{up_to}{strongest:.3f}), so their separate values are uncertain; fix {which} of them, or {OTHER_RUNS}"
        )
    return warnings


def _lacking_information(problem: Problem, theta: Array, uncertain: Uncertainty, place: int) -> str:
    """Return what the recordings lack for the estimation of a parameter."""
    column = np.abs(uncertain.sensitivity[:, place])
    energy = np.sort(column**2)[::-1]
    needed = 1 + int(np.searchsorted(np.cumsum(energy), 0.9 * energy.sum()))
    largest = column >= np.sqrt(energy[min(needed, len(energy)) - 1])
    near = np.concatenate([_from_reversal(r.path)[:, r.counted] for r in problem.recordings], axis=1)[:, largest]
    travel, samples = np.quantile(near, 0.9, axis=1, method="higher")  # Interpolation between two infinities is nan.
    if samples <= LEAST_TRANSIENT:
        return (
            f"90 % of its influence on the force is in {needed} samples, within {1e3 * travel:.2g} mm of reversals of the "
            "rod; sample faster, or let the rod reverse more often and more slowly"
        )
    if needed < FEW_SAMPLES:
        return f"90 % of its influence on the force is in {needed} samples only; record more of the motion or current there"
    correlation = _sensitivity_correlation(uncertain)[place]
    correlation[place] = 0.0
    similar = int(np.argmax(np.abs(correlation)))
    if abs(correlation[similar]) > CORRELATED:
        return (
            f"it changes the force in nearly the same way as {problem.parameters[similar].name} (correlation "
            f"{correlation[similar]:.3f}); fix one of them, or {OTHER_RUNS}"
        )
    change, error = (float(np.sqrt(np.mean(series**2))) for series in (column, problem.residuals(theta)))
    return f"between its bounds it changes the force by about {change:.2g} N rms only, and the error is {error:.2g} N rms"


def _from_reversal(path: Path) -> Array:
    """Return the distance of every sample from the nearest reversal of the rod, in m and in samples (2, n)."""
    travelled = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(path.position)))))
    reversals = np.flatnonzero(path.velocity == 0.0)
    if not reversals.size:
        return np.full((2, len(path.samples)), np.inf)
    after = np.searchsorted(reversals, path.samples)
    nearest = np.full((2, len(path.samples)), np.inf)
    for neighbour in (after - 1, after):
        reversal = reversals[np.clip(neighbour, 0, len(reversals) - 1)]
        metres = np.abs(travelled[path.samples] - travelled[reversal])
        # The samples directly before and after a reversal both have the distance 1.
        samples = np.abs(np.arange(len(path.samples)) - (np.searchsorted(path.samples, reversal) - 0.5)) + 0.5
        nearest = np.minimum(nearest, [metres, samples])
    return nearest
