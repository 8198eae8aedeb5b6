"""Recordings as identification uses them: smoothed, laid out for integration, weighted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interp1d

from mrd_base import InputError
from mrd_identification.low_pass import known_force_filter
from mrd_runs import Run
from mrd_runs.scales import SMALLEST
from mrd_runs.signals.current import current_noise
from mrd_runs.signals.motion import Motion
from mrd_runs.signals.smoothed_run import SmoothedRun, smooth_run
from mrd_sim.dual_type import columns_of, like
from mrd_sim.lead_in import usual_lead_in
from mrd_sim.models import DamperModel
from mrd_sim.path import Path, run_path

Array = NDArray[np.float64]
Weights = Literal["samples", "runs", "force"]

FORGETTING_STROKE = 0.05
"""Share of a run's stroke. The state of the damper at the start of a recording is known least. After this travel most of
its influence on the force has decayed."""

CURRENT_DEVIATION = 0.025
"""A. Hum and filtered noise of a current sensor are smaller (an unfiltered ACS714-05B has 19 mA). A larger standard
deviation that is no white noise either is a change of the current itself."""

CURRENT_SHARE = 0.2
"""The same as a share of the largest current, which counts where it is smaller: for coils of small currents. A current about
zero is not judged by it, because its largest one may be noise."""

OVER_NOISE = 1.5
"""Standard deviation of a current over that of its white noise, from which it changes."""

LEAST_CURRENT_CHANGE = 0.02
"""Share of the largest current, up to which two currents are one: a supply is not more exact, and no force changes by more
than that. A current below the smallest one of any damper counts as zero."""

NOISE_WINDOW = 0.05
"""s, the length of the moving average that suppresses the noise of the current sensor."""


@dataclass(frozen=True)
class Recording:
    """A run, prepared for the integration of models.

    Attributes
    ----------
    smoothed : SmoothedRun
        The run, its smoothed motion and its current without sensor noise.
    path : Path
        The smoothed signals with the vertices at reversals, along which models are integrated.
    counted : slice
        Samples whose residuals enter the objective.
    weight : float
        Factor of the squared residuals of the run.
    without_effects : bool
        Whether the effects of a model do not act in the run: it was recorded before something changed.
    other_starts : ndarray (counted samples, k) or None
        Changes in N of the modelled force if the damper had been through something else before the first sample; None
        before the start is estimated (`mrd_identification.run_start`).
    """

    smoothed: SmoothedRun
    path: Path
    counted: slice
    weight: float = 1.0
    without_effects: bool = False
    other_starts: Array | None = None

    @property
    def run(self) -> Run:
        """The run itself."""
        return self.smoothed.run

    @property
    def motion(self) -> Motion:
        """Smoothed motion of the run."""
        return self.smoothed.motion

    @property
    def force(self) -> Array:
        """Measured force in N at the counted samples."""
        return self.run.force[self.counted]

    @property
    def step(self) -> int:
        """Every how many samples one is counted."""
        return int(self.counted.step or 1)

    @property
    def rate(self) -> float:
        """Rate in Hz of the counted samples."""
        return self.run.rate / self.step

    @cached_property
    def whole(self) -> "Recording":
        """The same recording with all samples counted, see `thinned`."""
        if self.step == 1:
            return self
        return replace(
            self,
            counted=slice(self.counted.start, self.counted.stop),
            path=run_path(self.smoothed, self.path.mains).led_in(self.path.lead_in),
            other_starts=None,
        )

    def as_recorded(self, force: NDArray[Any]) -> NDArray[Any]:
        """Return a modelled force (n, ...) at every sample behind the filter that the force of the run has passed.

        See `mrd_identification.low_pass.with_force_filter`.
        """
        low_pass = known_force_filter(self.run)
        if low_pass is None:
            return force
        if self.step > 1:
            # Samples that are no vertices have the force of the vertex before; a straight line between vertices is nearer.
            vertices = np.flatnonzero(np.diff(self.path.samples, prepend=-1))
            force = interp1d(vertices, force[vertices], axis=0, assume_sorted=True)(np.arange(len(force)))
        return low_pass.filtered(force, self.run.rate)

    def regressors(self, model: DamperModel, thetas: Array) -> list[tuple[Array, Array]]:
        """Return `DamperModel.regressors` at the counted samples, behind the filter that the force of the run has passed."""
        if known_force_filter(self.run) is None:
            return model.regressors(thetas, self.path, self.counted)
        found = model.regressors(thetas, self.path)
        return [(self.as_recorded(part)[self.counted], self.as_recorded(rest)[self.counted]) for part, rest in found]

    def modelled(self, model: DamperModel, theta: Array) -> Array:
        """Return the modelled force in N at the counted samples."""
        return consecutive_forces(model, theta, [self])[0]


def prepare_recording(run: Run, weight: float = 1.0) -> Recording:
    """Smooth the motion of a run and lay out the path of integration."""
    smoothed = smooth_run(run)
    position = smoothed.motion.position
    stroke = np.maximum.accumulate(position) - np.minimum.accumulate(position)
    start = int(np.argmax(stroke >= FORGETTING_STROKE * stroke[-1]))
    return Recording(smoothed, run_path(smoothed).led_in(usual_lead_in(smoothed.motion)), slice(start, len(run)), weight)


def thinned(recordings: Sequence[Recording], most_samples: int) -> list[Recording]:
    """Count fewer samples, so that about ``most_samples`` of all recordings remain at most, and coarsen the paths likewise.

    Recordings with more samples per second than the others are thinned first: neighbouring samples tell least there.
    """
    durations = np.array([recording.run.duration for recording in recordings])
    rates = np.array([recording.run.rate for recording in recordings])
    rate = float(rates.max())
    while durations @ np.minimum(rates, rate) > most_samples:
        rate *= 0.98
    steps = np.maximum(1, np.ceil(rates / rate - 0.1)).astype(int)
    return [_every(recording, int(step)) for recording, step in zip(recordings, steps, strict=True)]


def _every(recording: Recording, step: int) -> Recording:
    if step == 1:
        return recording
    counted = slice(recording.counted.start, recording.counted.stop, step)
    return replace(recording, counted=counted, path=recording.path.coarse(counted), other_starts=None)


def consecutive_modelled_forces(
    model: DamperModel, theta: Array, recordings: Sequence[Recording], only_counted: bool = False
) -> list[Array]:
    """Return the modelled force (n,) in N at every sample of runs that were recorded one after the other.

    A state that outlasts a run, such as heat, is carried over to the next one, but not from runs without effects. Where
    ``theta`` is of dual numbers, the derivatives stand in columns beside the force: (n, 1 + lanes).
    """
    forces: list[Array] = []
    state: Array | None = None
    for recording in recordings:
        unfiltered = known_force_filter(recording.run) is None
        samples = recording.counted if only_counted and unfiltered else slice(None)
        if recording.without_effects and model.effects:
            force = model.force(model.without_effects(theta), recording.path, samples=samples)
        else:
            state = like(
                theta, model.initial_state(recording.path) if state is None else model.next_state(state, recording.path)
            )
            force = model.force(theta, recording.path, state, samples)
        force = columns_of(force)
        if not unfiltered:
            force = recording.as_recorded(force)[recording.counted if only_counted else slice(None)]
        forces.append(force)
    return forces


def consecutive_forces(model: DamperModel, theta: Array, recordings: Sequence[Recording]) -> list[Array]:
    """Return the forces of `consecutive_modelled_forces` at the counted samples only."""
    return consecutive_modelled_forces(model, theta, recordings, only_counted=True)


def run_weights(runs: Sequence[Run], weights: Weights | Sequence[float]) -> list[float]:
    """Return the factor of each run's squared residuals; its mean over all samples is 1.

    Parameters
    ----------
    runs : sequence of Run
    weights : {"samples", "runs", "force"} or sequence of float
        ``"samples"`` weights every sample equally, ``"runs"`` every run equally, however long it is, and ``"force"`` every
        run by the inverse variance of its force. Numbers are relative weights, one positive number for each run.

    Raises
    ------
    InputError
        For numbers that are not positive, or not as many as there are runs.
    """
    samples = np.array([len(run) for run in runs])
    if weights == "samples":
        factors = np.ones(len(runs))
    elif weights == "runs":
        factors = 1.0 / samples
    elif weights == "force":
        factors = np.array([1.0 / np.var(run.force) for run in runs])
    else:
        try:
            factors = np.asarray(weights, dtype=float)
        except ValueError:
            raise InputError(f"weights {weights!r}: expected samples, runs, force, or a number for each run") from None
        if factors.shape != samples.shape or not (np.isfinite(factors) & (factors > 0)).all():
            raise InputError(f"weights {weights!r}: expected {len(runs)} positive numbers, one for each fitted run")
    return list(map(float, factors * samples.sum() / (factors @ samples)))


def current_levels(runs: Sequence[Run]) -> tuple[int, bool]:
    """Return how many coil currents the runs have (3 for three or more), and whether the current changes within a run."""
    if any(current_varies(run) for run in runs):
        return 3, True
    least = LEAST_CURRENT_CHANGE * max(float(np.abs(run.current).max()) for run in runs)
    means = np.array([float(run.current.mean()) for run in runs])
    means = np.sort(np.where(np.abs(means) < SMALLEST.current, 0.0, means))
    deviation_of_mean = max(float(np.std(run.current)) / np.sqrt(len(run)) for run in runs)
    return min(3, 1 + int(np.sum(np.diff(means) > max(least, 10 * deviation_of_mean)))), False


def current_varies(run: Run) -> bool:
    """Whether the coil current of a run changes by more than the noise of its sensor."""
    largest = float(np.abs(run.current).max())
    least = LEAST_CURRENT_CHANGE * largest
    about_zero = abs(run.current.mean()) < SMALLEST.current
    usual = CURRENT_DEVIATION if about_zero else min(CURRENT_DEVIATION, CURRENT_SHARE * largest)
    if np.std(run.current) > max(usual, least, OVER_NOISE * current_noise(run.current)):
        return True
    window = max(5, int(NOISE_WINDOW * run.rate))
    # Of white noise with standard deviation sigma, the lower quartile of the absolute differences is 0.32 sqrt(2) sigma.
    noise = float(np.quantile(np.abs(np.diff(run.current)), 0.25)) / 0.45
    smooth = np.convolve(run.current, np.full(window, 1 / window), "valid")
    is_zero = np.abs(smooth).max() < SMALLEST.current
    return bool(not is_zero and np.ptp(smooth) > max(least, 12 * noise / np.sqrt(window)))
