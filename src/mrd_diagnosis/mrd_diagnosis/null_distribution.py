"""What effects seem to explain where there is none: the null distribution of the largest improvement."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.refit import GapProblem, Refit, Scatter, scaled_inverse
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording
from mrd_runs.signals.smoothed_run import remeasure
from mrd_sim.path import path_of

Array = NDArray[np.float64]

DRAWS = 6
"""Of each run measured again, at least."""

FEWEST = 40
"""Runs measured again, all in all."""

REALISATIONS = 999
"""Of all runs together: the draw of each part of a run, and its sign, are chosen anew."""


def null_errors(
    problem: GapProblem, theta: Array, force_noise: Sequence[float], scatter: Scatter, rng: np.random.Generator
) -> list[Array]:
    """White errors (draws, n) of each run if the model were true.

    The rod is taken to have moved as it seems to have; measured again, with new noise on position, acceleration, current and
    force, and with another gain and offset of the run, the same model errs by what is drawn here.
    """
    draws = max(DRAWS, -(-FEWEST // len(problem.recordings)))

    def of_run(each: tuple[int, np.random.Generator]) -> Array:
        index, own = each
        recording = problem.recordings[index]
        true = problem.modelled(theta, index)
        found = []
        for _ in range(draws):
            remeasured = remeasure(recording.smoothed, own)
            again = Recording(remeasured, path_of(remeasured), recording.counted)
            error = again.modelled(problem.model, theta) - true
            error += own.normal(0.0, scatter.gain) * true + own.normal(0.0, scatter.offset)
            found.append(problem.whitenings[index](error + own.normal(0.0, force_noise[index], len(true))))
        return np.array(found)

    return in_threads(of_run, list(enumerate(rng.spawn(len(problem.recordings)))))


def null_gains(base: Refit, trials: Sequence[Refit], rng: np.random.Generator) -> Array:
    """Largest improvement (REALISATIONS,) of the squared white error over all trials where there is only noise.

    To first order: the improvement is what the derivatives of a trial, its effect's among them, can take away of an error.
    """
    parts, draws = base.nulls.shape[:2]
    choice = rng.integers(0, draws, (REALISATIONS, parts))
    sign = rng.choice([-1.0, 1.0], (REALISATIONS, parts))

    def explained(refit: Refit) -> Array:
        slope = (refit.nulls[np.arange(parts), choice] * sign[:, :, None]).sum(axis=1)
        return np.asarray(((slope @ scaled_inverse(refit.grams.sum(axis=0), 1e-9)) * slope).sum(axis=1))

    without = explained(base)
    return np.asarray(np.max([explained(trial) - without for trial in trials], axis=0))


def p_value(gain: float, nulls: Array) -> float:
    """Probability of so large an improvement in noise alone; no smaller than what so many realisations can tell."""
    return float(1 + np.count_nonzero(nulls >= gain)) / (1 + len(nulls))
