"""What explains the difference between a hybrid test and its offline twin: the twin runs again with each cause.

In a closed loop the motion of the rod is no input: road, emulated system and law are, and a cause in the damper changes
force, current and motion together. So the share of a cause in the ride is not read from the recorded motion. The cause is
put into the damper of the twin, and the twin runs again along the same road.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_control.experiment import ControlExperiment, damper_entry
from mrd_control.loop import LoopResult
from mrd_control.prediction import MODEL
from mrd_control.recording import HybridRun
from mrd_control.ride import ride_metrics
from mrd_control.twin import run_twin
from mrd_runs.signals.motion import smooth_motion
from mrd_sim.damper import Damper

Array = NDArray[np.float64]

PARAMETERS = "parameters"
"""The cause that the damper is another one: its model and parameters, as a diagnosis has refitted them."""
TRACKING = "tracking"
"""The cause that the rod does not follow the emulated motion exactly, as recorded."""
MOST_CAUSES = 6
"""Causes for which all subsets are tried, 64 twins."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Which part of each ride metric's difference, bench minus twin, each cause makes.

    Attributes
    ----------
    causes : tuple of str
        Ids of effects, `PARAMETERS` and `TRACKING`.
    parts : dict
        Change of each metric (`mrd_control.ride.Ride`) by each cause, in its unit; with ``rest`` they sum to the difference.
    rest : dict
        What no cause explains.
    twin : LoopResult
        Twin with all causes.
    """

    causes: tuple[str, ...]
    parts: dict[str, dict[str, float]]
    rest: dict[str, float]
    twin: LoopResult


def explain_difference(run: HybridRun, damper: Damper) -> Explanation:
    """Explain the difference between a recorded hybrid test and its twin.

    The part of a cause is the mean change of the metric over all orders in which the causes can be put into the twin one
    after the other (Shapley, Contrib. Theory Games 2 (1953) 307), because the change by one may depend on the others.

    Parameters
    ----------
    run : HybridRun
    damper : Damper
        As a diagnosis of the recording found it; each of its effects is a cause.

    Raises
    ------
    InputError
        For more causes than all subsets can be tried of, or a twin that diverges with some of them.
    """
    experiment, system = run.experiment, run.experiment.system.linear()
    causes = (*(effect.id for effect in damper.model.effects), PARAMETERS)
    error = None
    if experiment.predictor == MODEL:
        causes, error = (*causes, TRACKING), _tracking_error(run)
    if len(causes) > MOST_CAUSES:
        raise InputError(f"damper {damper.description}: {len(causes)} causes, expected at most {MOST_CAUSES}")
    kept = slice(experiment.counted.start, min(experiment.counted.stop, len(run.bench.time)))
    bench = asdict(ride_metrics(system, run.bench.part(kept), experiment.data_sheet, 0.0))
    rides: dict[frozenset[str], dict[str, float]] = {}
    for count in range(len(causes) + 1):
        for chosen in itertools.combinations(causes, count):
            twin = run_twin(_with_causes(experiment, damper, chosen), error if TRACKING in chosen else None)
            if twin.diverged:
                raise InputError(f"the offline twin with {', '.join(chosen)} diverges at {twin.time[-1]:.2f} s")
            rides[frozenset(chosen)] = asdict(ride_metrics(system, twin.part(kept), experiment.data_sheet, 0.0))
    parts = {
        metric: {cause: _mean_change(rides, causes, cause, metric) for cause in causes}
        for metric, value in bench.items()
        if math.isfinite(value)
    }
    rest = {metric: bench[metric] - rides[frozenset(causes)][metric] for metric in parts}
    return Explanation(causes, parts, rest, twin)


def _with_causes(experiment: ControlExperiment, damper: Damper, causes: Sequence[str]) -> ControlExperiment:
    """Return the experiment whose damper has the effects among the causes, and the parameters found if these are one."""
    found = damper_entry(damper)
    entry = found if PARAMETERS in causes else damper_entry(experiment.damper)
    own = {} if PARAMETERS in causes else entry["effects"]
    effects = own | {effect: values for effect, values in found["effects"].items() if effect in causes}
    return replace(experiment, damper=Damper(entry["model"], entry["parameters"], entry["laws"], effects))


def _tracking_error(run: HybridRun) -> Array:
    """Return what the rod had more than the emulated motion: m, m/s and m/s², one row for each sample of the experiment."""
    motion = smooth_motion(run.bench.time, run.bench.rod - run.bench.travel)
    error = np.stack([motion.position, motion.velocity, motion.acceleration], axis=1)
    return np.vstack([error, np.zeros((run.experiment.samples - len(error), 3))])


def _mean_change(rides: dict[frozenset[str], dict[str, float]], causes: Sequence[str], cause: str, metric: str) -> float:
    """Return the mean change of a metric by a cause over all orders, from the metrics with each subset of the causes."""
    orders, total = math.factorial(len(causes)), 0.0
    for others, ride in rides.items():
        if cause not in others:
            ways = math.factorial(len(others)) * math.factorial(len(causes) - len(others) - 1)
            total += ways / orders * (rides[others | {cause}][metric] - ride[metric])
    return total
