"""Share of the gap that a corrected model closes, measured against the noise that the ground truth knows exactly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording, consecutive_forces, prepare_recording
from mrd_runs import Run
from mrd_sim.models import DamperModel, find_model
from mrd_trials.bench_session import BenchSession, Effects
from mrd_trials.reference_fit import fit_model
from mrd_trials.size import REFERENCE, Size

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ClosureMeter:
    """A plant with the model fitted to it without effects, against which corrected models are measured.

    Attributes
    ----------
    model_id : str
    recordings : sequence of Recording
        All runs in order at the size of the plant, the fresh ones last; the known gain and offset of each run are taken out
        of its force.
    noise_free : sequence of Recording
        The same runs without noise.
    uncorrected : sequence of ndarray
        Force in N of the model without effects, fitted to the runs that the diagnosis is given, at the counted samples.
    given : int
        Number of those runs.
    """

    model_id: str
    recordings: Sequence[Recording]
    noise_free: Sequence[Recording]
    uncorrected: Sequence[Array]
    given: int

    @classmethod
    def from_session(
        cls,
        session: BenchSession,
        effects: Effects,
        model_id: str,
        given: Sequence[Run],
        fresh: Sequence[Run],
        size: Size = REFERENCE,
    ) -> "ClosureMeter":
        """Fit the model to the given runs of a plant at the reference size, and bring everything to the plant's.

        ``session`` and ``effects`` are those that the plant was made with; ``given`` and ``fresh`` have the plant's size.
        """

        def without_scatter(runs: Sequence[Run]) -> list[Run]:
            pairs = zip(runs, session.scatter, strict=True)
            return [replace(run, force=(run.force - scatter.offset) / scatter.gain) for run, scatter in pairs]

        reduced = without_scatter([size.inverse.scaled(run) for run in [*given, *fresh]])
        silent = without_scatter(session.noise_free_runs(effects))
        of_fit = in_threads(prepare_recording, reduced)
        recordings, noise_free = (
            [
                replace(recording, counted=fitted.counted)
                for recording, fitted in zip(
                    in_threads(prepare_recording, [size.scaled(run) for run in runs]), of_fit, strict=True
                )
            ]
            for runs in (reduced, silent)
        )
        problem, theta = fit_model(model_id, of_fit[: len(given)], np.random.default_rng(session.fit_seed))
        uncorrected = [size.force * force for force in consecutive_forces(problem.model, theta, of_fit)]
        return cls(model_id, recordings, noise_free, uncorrected, len(given))

    def on_given_runs(self, effects: Sequence[str], parameters: Mapping[str, float]) -> float:
        """Return the share of the gap on the given runs that a corrected model closes; nan without a gap."""
        return self._closed_fraction(effects, parameters, slice(0, self.given))

    def on_fresh_runs(self, effects: Sequence[str], parameters: Mapping[str, float]) -> float:
        """Return the share of the gap on the fresh runs that a corrected model closes; nan without a gap."""
        return self._closed_fraction(effects, parameters, slice(self.given, None))

    def _closed_fraction(self, effects: Sequence[str], parameters: Mapping[str, float], runs: slice) -> float:
        """Return 1 - (after² - floor²) / (before² - floor²) of the rms errors on some runs."""
        model, theta = submitted_model(self.model_id, effects, parameters)
        corrected = consecutive_forces(model, theta, self.recordings)
        measured = np.concatenate([recording.force for recording in self.recordings[runs]])
        before = _mean_square_error(measured, np.concatenate(self.uncorrected[runs]))
        after = _mean_square_error(measured, np.concatenate(corrected[runs]))
        floor = float(np.mean(np.concatenate(self._noise(model, theta, corrected)[runs]) ** 2))
        return (before - after) / (before - floor) if before > floor else np.nan

    def _noise(self, model: DamperModel, theta: Array, forces: Sequence[Array]) -> list[Array]:
        """Return what noise contributes to the errors of each run in N.

        It is the difference between the errors on the recordings and those on the same runs without noise: noise of the
        force sensor, and noise of the measured motion and current carried through the model.
        """
        silent_forces = consecutive_forces(model, theta, self.noise_free)
        return [
            (recording.force - force) - (silent.force - silent_force)
            for recording, force, silent, silent_force in zip(
                self.recordings, forces, self.noise_free, silent_forces, strict=True
            )
        ]


def submitted_model(model_id: str, effects: Sequence[str], parameters: Mapping[str, float]) -> tuple[DamperModel, Array]:
    """Return a corrected model and the submitted parameters, which may exceed the bounds for the reference damper."""
    model = find_model(model_id, effects=list(effects))
    return model, np.array([parameters.get(entry.name, entry.default) for entry in model.parameters])


def _mean_square_error(measured: Array, modelled: Array) -> float:
    """Return the mean square in N² of what a gain and an offset of all runs together leave of the errors.

    The runs that a model was fitted to have a mean gain and offset, which its parameters contain.
    """
    columns = np.stack([modelled, np.ones_like(modelled)], axis=1)
    solution, *_ = np.linalg.lstsq(columns, measured, rcond=None)
    return float(np.mean((measured - columns @ solution) ** 2))
