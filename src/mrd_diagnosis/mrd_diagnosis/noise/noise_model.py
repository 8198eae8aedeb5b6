"""Noise model: how far measured and modelled force may differ although the model is true.

The noise of every sample has two contributions. The force sensor has noise of its own, which is white or has passed a
first-order filter (`force_noise`). The errors of the measured motion and current pass through the model (`input_errors`).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import RunNoise
from mrd_diagnosis.noise.force_noise import force_noise_variance, without_offset_and_gain
from mrd_diagnosis.noise.input_errors import propagated_variance
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording, consecutive_forces
from mrd_runs.signals.mains import without_mains
from mrd_runs.signals.quantisation import quantisation_step
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]

DRAWS = 12
"""Draws of the errors of motion and current of each run; the variance of the force then has a relative error of 40 %."""

BEST_RESOLUTION = 1e-6
"""Share of the largest force below which no noise is assumed to lie: residuals are divided by the noise."""

SAMPLES_OF_GROUP = 50
"""Samples, at least, over which the propagated errors are compared with the residual."""

MOST_GROUPS = 10
"""Groups of samples with similar propagated errors in which they are compared with the residual."""


def estimate_noise(
    recordings: Sequence[Recording], model: DamperModel, theta: Array, rng: np.random.Generator, *, draws: int = DRAWS
) -> list[RunNoise]:
    """Estimate the noise of every run.

    Parameters
    ----------
    recordings : sequence of Recording
        Their paths may hold the measured current or the steady one. Of thinned ones, all samples are used.
    model : DamperModel
    theta : ndarray (parameters,)
        Parameters near enough to the truth that errors of the motion become errors of the force of about the right size.
    rng : numpy Generator
    draws : int
        Draws of the errors of motion and current of each run.
    """
    steps = [recording.step for recording in recordings]
    recordings = [recording.whole for recording in recordings]
    items = list(zip(recordings, rng.spawn(len(recordings)), strict=True))
    # Before and after a change, the same happens within a reading, and is no noise between them.
    within = not any(recording.without_effects for recording in recordings)
    propagated = in_threads(lambda item: propagated_variance(item[0], model, theta, item[1], draws, within), items)
    modelled = consecutive_forces(model, theta, recordings)
    # A hum is no noise: it goes on in phase through the whole run.
    residuals = [
        without_mains(recording.force - force, recording.run.time[recording.counted])
        for recording, force in zip(recordings, modelled, strict=True)
    ]
    noise = []
    for index, recording in enumerate(recordings):
        residual = without_offset_and_gain(residuals[index], recording.force)
        variance, source = force_noise_variance(index, recordings, residuals, propagated)
        # No noise is larger than the residual itself, and none is smaller than the rounding of the readings.
        variance = min(max(variance, _rounding_variance(recording.force)), float(np.mean(residual**2)))
        smallest = BEST_RESOLUTION * float(np.abs(recording.force).max())
        variance = max(variance, smallest**2, np.finfo(float).tiny)
        of_inputs = _limited_by_residual(_without_dips(propagated[index]), residual, variance)
        sigma = np.sqrt(variance + of_inputs)
        noise.append(RunNoise(sigma[:: steps[index]], float(np.sqrt(variance)), float(np.sqrt(of_inputs.mean())), source))
    return noise


def _without_dips(variance: Array) -> Array:
    """Raise variances from a few draws to the mean of their neighbours. A peak is not lowered."""
    return np.maximum(variance, np.convolve(np.pad(variance, 2, mode="edge"), np.full(5, 0.2), "valid"))


def _limited_by_residual(propagated: Array, residual: Array, variance: float) -> Array:
    """Scale the propagated variance down where even the residual is smaller, in groups of samples with similar variance."""
    limited = propagated.copy()
    order = np.argsort(propagated, kind="stable")
    for group in np.array_split(order, min(MOST_GROUPS, max(len(order) // SAMPLES_OF_GROUP, 1))):
        available = max(float(np.mean(residual[group] ** 2)) - variance, 0.0)
        limited[group] *= min(1.0, available / max(float(propagated[group].mean()), 1e-300))
    return limited


def _rounding_variance(force: Array) -> float:
    """Return the variance in N² of the rounding of a quantised force; steps after a calibration are not quite equal."""
    step = quantisation_step(force, 1e-9 * float(np.abs(force).max()), tolerance=0.05, multiples=0.95)
    return step**2 / 12
