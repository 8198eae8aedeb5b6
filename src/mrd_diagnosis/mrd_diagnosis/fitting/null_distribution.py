"""Null distribution: the largest improvement that effects seem to make where there is only noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.fitting.refit import Refit, scaled_inverse
from mrd_diagnosis.fitting.weighting import RunScatter, WeightedProblem
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


@dataclass(frozen=True)
class NullGains:
    """Decreases of the cost that effects seem to make where there is only noise.

    Attributes
    ----------
    gains : ndarray (REALISATIONS,)
        Largest decrease over all effects that were tried by themselves, in squares of white errors.
    noise_cost : float
        What noise alone contributes to the cost, with the weighting in which they were drawn.
    """

    gains: Array
    noise_cost: float

    def p_value(self, gain: float, problem: WeightedProblem) -> float:
        """Return the probability that noise alone gives so large a decrease of the cost of a problem.

        Once an effect is known, less error is left and noise weighs more than when the decreases were drawn; they grow as
        its part of the cost does. The result is at least what so many realisations can resolve.
        """
        gains = self.gains * problem.noise_cost / self.noise_cost
        return float(1 + np.count_nonzero(gains >= gain)) / (1 + len(gains))


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
            path = run_path(remeasured, recording.path.mains)  # the force, and so its hum, is the same
            again = Recording(remeasured, path.led_in(recording.path.lead_in), recording.counted)
            error = again.modelled(problem.model, theta) - true
            error += rng_of_run.normal(0.0, scatter.gain) * true + rng_of_run.normal(0.0, scatter.offset)
            errors.append(problem.whitenings[index](error + rng_of_run.normal(0.0, force_noise[index], len(true))))
        return np.array(errors)

    return in_threads(lambda item: errors_of_run(*item), list(enumerate(rng.spawn(len(problem.recordings)))))


def draw_null_gains(base: Refit, refits: Sequence[Refit], rng: np.random.Generator) -> NullGains:
    """Draw the largest decrease of the cost over all refits where there is only noise.

    To first order, the decrease is what the Jacobian of a refit, which includes its effect, can remove of an error.
    """
    if not refits:
        return NullGains(np.zeros(1), base.problem.noise_cost)
    folds, draws = base.null_gradients.shape[:2]
    choice = rng.integers(0, draws, (REALISATIONS, folds))
    sign = rng.choice([-1.0, 1.0], (REALISATIONS, folds))

    def explained(fitted: Refit) -> Array:
        gradient = (fitted.null_gradients[np.arange(folds), choice] * sign[:, :, None]).sum(axis=1)
        inverse = scaled_inverse(fitted.information, 1e-9)
        return np.asarray(((gradient @ inverse) * gradient).sum(axis=1))

    explained_by_base = explained(base)
    gains = np.max([explained(fitted) - explained_by_base for fitted in refits], axis=0)
    return NullGains(np.asarray(gains), base.problem.noise_cost)
