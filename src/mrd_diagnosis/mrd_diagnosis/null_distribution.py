"""Null distribution: the largest improvement that effects seem to make where there is only noise."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.refit import Refit, scaled_inverse
from mrd_diagnosis.weighting import RunScatter, WeightedProblem
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording
from mrd_runs.signals.smoothed_run import remeasure
from mrd_sim.path import run_path

Array = NDArray[np.float64]

LEAST_DRAWS = 6
"""Draws of each run, at least."""

LEAST_TOTAL_DRAWS = 40
"""Draws of all runs together, at least."""

REALISATIONS = 999
"""Realisations of the whole set; in each, every fold takes one of its draws with a random sign."""


def draw_null_errors(
    problem: WeightedProblem, theta: Array, force_noise: Sequence[float], scatter: RunScatter, rng: np.random.Generator
) -> list[Array]:
    """Draw white errors (draws, n) of each run as they were if the model were true.

    The rod is assumed to have moved as the smoothed motion says. The run is then measured again, with new noise on position,
    acceleration, current and force, and with another gain and offset. The error of the same model on these readings is a
    draw.
    """
    draws = max(LEAST_DRAWS, -(-LEAST_TOTAL_DRAWS // len(problem.recordings)))

    def errors_of_run(index: int, rng_of_run: np.random.Generator) -> Array:
        recording = problem.recordings[index]
        true = problem.modelled(theta, index)
        errors = []
        for _ in range(draws):
            remeasured = remeasure(recording.smoothed, rng_of_run)
            again = Recording(remeasured, run_path(remeasured), recording.counted)
            error = again.modelled(problem.model, theta) - true
            error += rng_of_run.normal(0.0, scatter.gain) * true + rng_of_run.normal(0.0, scatter.offset)
            errors.append(problem.whitenings[index](error + rng_of_run.normal(0.0, force_noise[index], len(true))))
        return np.array(errors)

    return in_threads(lambda item: errors_of_run(*item), list(enumerate(rng.spawn(len(problem.recordings)))))


def draw_null_gains(base: Refit, refits: Sequence[Refit], rng: np.random.Generator) -> Array:
    """Draw the largest decrease (REALISATIONS,) of the cost over all refits where there is only noise.

    To first order, the decrease is what the Jacobian of a refit, which includes its effect, can remove of an error.
    """
    folds, draws = base.null_gradients.shape[:2]
    choice = rng.integers(0, draws, (REALISATIONS, folds))
    sign = rng.choice([-1.0, 1.0], (REALISATIONS, folds))

    def explained(fitted: Refit) -> Array:
        gradient = (fitted.null_gradients[np.arange(folds), choice] * sign[:, :, None]).sum(axis=1)
        inverse = scaled_inverse(fitted.information, 1e-9)
        return np.asarray(((gradient @ inverse) * gradient).sum(axis=1))

    explained_by_base = explained(base)
    return np.asarray(np.max([explained(fitted) - explained_by_base for fitted in refits], axis=0))


def p_value(gain: float, null_gains: Array) -> float:
    """Return the probability of so large a gain in noise alone; at least what so many realisations can resolve."""
    return float(1 + np.count_nonzero(null_gains >= gain)) / (1 + len(null_gains))
