"""What is fitted: a model, the recordings, the free parameters on their scales."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_identification.metrics import error_norms
from mrd_runs import Run
from mrd_runs.motion import motion
from mrd_sim.models import DamperModel, Parameter
from mrd_sim.path import Path, path_of

Array = NDArray[np.float64]

FORGETTING_STROKE = 1e-3
"""m; the hysteretic state at the start of a recording is not known. Once the rod moved this far, several usual yield
travels, little of it is left."""

_WORKERS = ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="candidates")
"""The compiled models release the interpreter, so threads use all cores and share the data without a copy."""


@dataclass(frozen=True)
class Recording:
    """A run as identification sees it.

    Attributes
    ----------
    run : Run
    path : Path
        Smoothed motion with its reversal vertices, and the measured current.
    counted : slice
        Samples whose residual counts.
    """

    run: Run
    path: Path
    counted: slice

    @property
    def force(self) -> Array:
        """Measured force in N at the counted samples."""
        return self.run.force[self.counted]

    def modelled(self, model: DamperModel, theta: Array) -> Array:
        """Model's force in N at the counted samples."""
        return model.force(theta, self.path)[self.counted]


def prepare(run: Run) -> Recording:
    """Smooth the motion of a run and lay out the path of integration."""
    position = motion(run).position
    reached = np.maximum.accumulate(position) - np.minimum.accumulate(position)
    start = int(np.argmax(reached >= min(FORGETTING_STROKE, 0.25 * reached[-1])))
    return Recording(run, path_of(run), slice(start, len(run)))


@dataclass(frozen=True)
class Problem:
    """Free parameters of a model over recordings, scaled to the unit box.

    Attributes
    ----------
    model : DamperModel
    recordings : sequence of Recording
    free : tuple of int
        Indices of the parameters that are searched.
    base : ndarray (parameters,)
        Values of all others.
    """

    model: DamperModel
    recordings: Sequence[Recording]
    free: tuple[int, ...]
    base: Array

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters."""
        return tuple(self.model.parameters[index] for index in self.free)

    def theta(self, unit: Array) -> Array:
        """Parameter vectors (..., parameters) of points (..., free) of the unit box."""
        unit = np.asarray(unit)
        theta = np.broadcast_to(self.base, (*unit.shape[:-1], len(self.base))).copy()
        for column, (index, p) in enumerate(zip(self.free, self.parameters, strict=True)):
            u = unit[..., column]
            theta[..., index] = p.lower * (p.upper / p.lower) ** u if p.log else p.lower + (p.upper - p.lower) * u
        return theta

    def unit(self, theta: Array) -> Array:
        """Point of the unit box of a parameter vector; outside values come to the border."""
        values = [
            np.log(theta[index] / p.lower) / np.log(p.upper / p.lower)
            if p.log
            else (theta[index] - p.lower) / (p.upper - p.lower)
            for index, p in zip(self.free, self.parameters, strict=True)
        ]
        return np.asarray(np.clip(values, 0.0, 1.0))

    def scale(self, theta: Array) -> Array:
        """Derivative of each free parameter to its unit coordinate."""
        return np.array(
            [
                theta[index] * np.log(p.upper / p.lower) if p.log else p.upper - p.lower
                for index, p in zip(self.free, self.parameters, strict=True)
            ]
        )

    def residuals(self, theta: Array) -> Array:
        """Modelled minus measured force in N over all counted samples."""
        return np.concatenate([r.modelled(self.model, theta) - r.force for r in self.recordings])

    def jacobian(self, unit: Array, residuals: Array, step: float = 1e-6) -> Array:
        """Derivatives (samples, free) of the residuals to the unit coordinates, by one-sided differences."""
        # Step inwards from the upper border.
        steps = np.where(unit + step <= 1.0, step, -step)
        points = unit + np.diag(steps)
        columns = list(_WORKERS.map(self.residuals, self.theta(points)))
        return (np.stack(columns, axis=1) - residuals[:, None]) / steps

    def norms(self, thetas: Array) -> Array:
        """The two norms e2 and einf in N, (candidates, 2), of a whole population; inf for a force that is not finite."""

        def of(theta: Array) -> tuple[float, float]:
            found = error_norms(self.residuals(theta))
            return found if np.isfinite(found[0]) else (np.inf, np.inf)

        return np.array(list(_WORKERS.map(of, thetas)))


def free_parameters(model: DamperModel, runs: Sequence[Run]) -> tuple[tuple[int, ...], list[str]]:
    """Which parameters these runs can tell anything about, and a sentence for each group that they cannot."""
    varies_within = any(_current_varies(run) for run in runs)
    means = [float(run.current.mean()) for run in runs]
    blur = max(float(np.std(run.current)) / np.sqrt(len(run)) for run in runs)
    varies = varies_within or max(means) - min(means) > max(1e-3, 10 * blur)
    frozen: set[str] = set()
    notes: list[str] = []
    if not varies_within:
        frozen.add("coil_lag")
        notes.append("coil_lag is fixed: the current never changes within a run, so its lag cannot be seen")
    if not varies:
        slopes = {name for name in model.names if name.endswith("_per_A")}
        frozen |= slopes
        notes.append(
            "slopes over current are fixed at 0: all runs have the same current, so each coefficient is the one at "
            f"{runs[0].current.mean():.3g} A"
        )
    return tuple(i for i, p in enumerate(model.parameters) if p.free and p.name not in frozen), notes


def _current_varies(run: Run) -> bool:
    """Whether the current of a run changes by more than its sensor's noise."""
    # No sensor of a bench is noisier than this; an unfiltered ACS714-05B has 19 mA.
    if np.std(run.current) > 0.025:
        return True
    window = max(5, int(0.05 * run.rate))
    noise = float(np.quantile(np.abs(np.diff(run.current)), 0.25)) / 0.45  # of white noise: 0.32 sqrt(2) sigma
    smooth = np.convolve(run.current, np.full(window, 1 / window), "valid")
    return bool(np.ptp(smooth) > max(1e-3, 12 * noise / np.sqrt(window)))
