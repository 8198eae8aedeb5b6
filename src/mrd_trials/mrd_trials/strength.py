"""How strong an effect is on the runs of a plant: what of it a fitted model cannot take up, against the noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.base_fit import global_fit
from mrd_identification.parallel import in_threads
from mrd_identification.problem import make_problem
from mrd_identification.recording import consecutive_forces, prepare_recording
from mrd_runs import Run
from mrd_sim.models import DamperModel, find_model

Array = NDArray[np.float64]

FITTING_STARTS = 16


@dataclass(frozen=True)
class Yardstick:
    """A model fitted to the runs of a plant without effects.

    Attributes
    ----------
    model : DamperModel
    theta : ndarray (parameters,)
    errors : ndarray (samples,)
        N, modelled minus measured force.
    counted : tuple of slice
        Samples of each run that count.
    nuisance : ndarray (samples, k)
        Orthonormal; spans what the model's parameters, and every run's own offset and gain, can imitate.
    floor : float
        N rms of what the fit leaves.
    """

    model: DamperModel
    theta: Array
    errors: Array
    counted: tuple[slice, ...]
    nuisance: Array
    floor: float

    @classmethod
    def of(cls, model: str, runs: Sequence[Run], rng: np.random.Generator) -> "Yardstick":
        """From the recordings of the plant without effects."""
        recordings = in_threads(prepare_recording, runs)
        found = find_model(model)
        posed, _ = make_problem(found, recordings, fixed={"coil_lag": 0.0})
        theta = global_fit(posed, None, rng, random_starts=FITTING_STARTS)
        forces = consecutive_forces(found, theta, recordings)
        own = np.zeros((len(posed.force), 2 * len(recordings)))
        for place, (block, force) in enumerate(zip(posed.blocks, forces, strict=True)):
            own[block, 2 * place], own[block, 2 * place + 1] = 1.0, force
        columns = np.hstack([posed.jacobian(posed.unit(theta)), own])
        values, vectors = np.linalg.eigh(gram := columns.T @ columns / np.outer(size := _lengths(columns), size))
        kept = values > 1e-10 * len(gram)
        nuisance = (columns / size) @ (vectors[:, kept] / np.sqrt(values[kept]))
        errors = posed.errors(theta)
        left = errors - nuisance @ (nuisance.T @ errors)
        counted = tuple(recording.counted for recording in recordings)
        return cls(found, theta, errors, counted, nuisance, float(np.sqrt(np.mean(left**2))))

    def signal_to_floor(self, runs: Sequence[Run]) -> float:
        """Mean square of what effects add to the errors on the same motions and noise, over that of the floor."""
        prepared = in_threads(prepare_recording, runs)
        recordings = [replace(recording, counted=part) for recording, part in zip(prepared, self.counted, strict=True)]
        forces = consecutive_forces(self.model, self.theta, recordings)
        change = np.concatenate([f - r.force for f, r in zip(forces, recordings, strict=True)]) - self.errors
        left = change - self.nuisance @ (self.nuisance.T @ change)
        return float(np.mean(left**2) / self.floor**2)


def strength_for(target: float, measured: Callable[[float], float], most: float, trials: int = 8) -> tuple[float, float]:
    """Strength, at most ``most``, at which the signal to floor comes within a quarter of a target; and that signal.

    A signal grows about with the square of its cause: a secant on logarithmic scales. Beyond a threshold, like that of a
    void, it grows by far more: where the secant leaves what is known to be too weak and too strong, their middle is next.
    """
    strength, weak, strong = 1.0, 0.0, np.inf
    known: list[tuple[float, float]] = []
    for _ in range(trials):
        found = max(measured(strength), 1e-9)
        known.append((strength, found))
        if abs(np.log(found / target)) < 0.25 or (strength >= most and found < target):
            break
        weak, strong = (max(weak, strength), strong) if found < target else (weak, min(strong, strength))
        slope = 2.0
        if len(known) > 1:
            (a, at_a), (b, at_b) = known[-2:]
            slope = float(np.clip(np.log(at_b / at_a) / np.log(b / a), 0.5, 6.0))
        strength = float(min(strength * np.exp(np.clip(np.log(target / found) / slope, -3.0, 3.0)), most))
        if not weak < strength < strong:
            strength = float(np.sqrt(max(weak, 0.1 * strong) * strong))
    return min(known, key=lambda each: abs(np.log(each[1] / target)))


def _lengths(columns: Array) -> Array:
    return np.asarray(np.maximum(np.linalg.norm(columns, axis=0), 1e-12))
