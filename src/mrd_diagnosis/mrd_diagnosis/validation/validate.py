"""Validation: how well a damper as it is predicts runs to which it was not fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.closure.closure import exceeded_ranges
from mrd_diagnosis.diagnosis import Region, RunNoise
from mrd_diagnosis.localisation.localise import localise
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_diagnosis.recordings.recording_set import RecordingSet
from mrd_diagnosis.simulator.in_the_loop import SimulatorInLoop
from mrd_diagnosis.simulator.stand_in import beside_model, represent, simulated_forces
from mrd_identification.export import corrected_simulator, load_damper
from mrd_identification.fit import Fit, RunResult, evaluate_model, pooled_metrics
from mrd_identification.metrics import metrics, nrmse
from mrd_identification.parallel import in_threads
from mrd_identification.preflight.finding import Finding
from mrd_identification.recording import Recording, prepare_recording
from mrd_identification.run_start import estimate_starts
from mrd_runs import Run
from mrd_runs.run import checked_runs, same_samples
from mrd_runs.scales import scales_of
from mrd_sim.damper import Damper
from mrd_sim.simulators.simulator import Simulator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ValidatedRun:
    """A run as it is predicted.

    Attributes
    ----------
    result : RunResult
        Measured and predicted force, the latter with offset and gain where these were asked for.
    noise_floor : float
        NRMSE that a perfect model would still have.
    offset : float
        Force offset in N that was taken out; 0 where none was asked for.
    gain : float
        Relative excess of the measured force that was taken out; 0 where none was asked for.
    exceeds : str
        In what the run exceeds those to which the damper was fitted, such as "stroke and speed"; empty where it does not,
        or where these runs are not known.
    was_fitted : bool
        Whether the damper was fitted to this very run, so that its error proves nothing.
    """

    result: RunResult
    noise_floor: float
    offset: float
    gain: float
    exceeds: str
    was_fitted: bool


@dataclass(frozen=True)
class Validation:
    """Prediction of runs by a damper whose parameters are kept.

    Attributes
    ----------
    damper : Damper
    runs : tuple of ValidatedRun
    nrmse, rmse, noise_floor : float
        Over all counted samples of the runs; the rms error in N, the others over the standard deviation of the force.
    where : tuple of Region
        Where the error beyond noise lies, most significant first.
    fitted_known : bool
        Whether the runs to which the damper was fitted are known, so that `ValidatedRun.exceeds` says something.
    limitations : tuple of Finding
        Weaknesses of a user's simulator that is validated; see `mrd_diagnosis.simulator.self_check`.
    """

    damper: Damper
    runs: tuple[ValidatedRun, ...]
    nrmse: float
    rmse: float
    noise_floor: float
    where: tuple[Region, ...]
    fitted_known: bool
    limitations: tuple[Finding, ...] = ()

    @property
    def new_nrmse(self) -> float:
        """Error over the runs to which the damper was not fitted; nan where it was fitted to all of them."""
        new = [run.result for run in self.runs if not run.was_fitted]
        return pooled_metrics(new).nrmse if new else float("nan")


def validate(
    damper: Damper | Fit | Simulator | str | Path,
    runs: Sequence[Run],
    *,
    simulator: Simulator | None = None,
    fitted: Sequence[Run] = (),
    offsets: bool = False,
    gains: bool = False,
    seed: int = 0,
) -> Validation:
    """Predict runs without fitting anything but the state before their first sample.

    Parameters
    ----------
    damper : Damper, Fit, Simulator or path
        A path as of `mrd_identification.export.load_damper`: a fit.json, a gap_report.json or a plant.yaml.
    runs : sequence of Run
        In the order in which they were recorded.
    simulator : Simulator, optional
        The simulator that the damper corrects, where it is that of a diagnosis with a simulator of the user's own.
    fitted : sequence of Run
        Runs to which the damper was fitted, to tell what exceeds them. Those of a `Fit` are known.
    offsets, gains : bool
        Take out the force offset, or the gain error, of each run.
    seed : int
        Of the noise model's draws.

    Raises
    ------
    InputError
        For no runs, a file that does not describe a damper, or a simulator that fails or is missing.
    """
    runs = checked_runs(runs)
    if isinstance(damper, Fit):
        fitted = fitted or [result.run for result in damper.fitted]
        values = dict(zip(damper.model.names, map(float, damper.theta), strict=True))
        damper = Damper(damper.model.id, values, damper.model.laws, {effect.id: {} for effect in damper.model.effects})
    recordings: Sequence[Recording] = in_threads(prepare_recording, runs)
    limitations: tuple[Finding, ...] = ()
    if isinstance(damper, Simulator):
        damper, recordings, limitations = _represented(damper, recordings, seed)
    elif not isinstance(damper, Damper):
        damper = load_damper(damper)
    if recordings[0].smoothed.excess is None:
        recordings = _corrected(damper, recordings, simulator)
    model, theta = damper.model, damper.theta
    recordings = estimate_starts(model, theta, recordings)
    noise = estimate_noise(recordings, model, theta, np.random.default_rng(seed))
    before = in_threads(prepare_recording, fitted)
    results = evaluate_model(model, theta, recordings)
    validated = tuple(
        _validated(
            result,
            of_run,
            exceeded_ranges(recording, before),
            any(is_same(recording.run, run) for run in fitted),
            offsets,
            gains,
        )
        for result, of_run, recording in zip(results, noise, recordings, strict=True)
    )
    validation = _validation(damper, validated, recordings, noise, fitted_known=bool(fitted))
    return replace(validation, limitations=limitations)


def is_same(run: Run, other: Run) -> bool:
    """Return whether two runs are of one recording; a part may have been left out at the start of either."""
    mine, its = run.info.get("checksum"), other.info.get("checksum")
    return (mine is not None and mine == its) or same_samples(run, other)


def _represented(
    simulator: Simulator, recordings: Sequence[Recording], seed: int
) -> tuple[Damper, Sequence[Recording], tuple[Finding, ...]]:
    """Return the damper model that stands for a simulator, the recordings with what it has beyond it, and what limits it."""
    given = RecordingSet((), tuple(recordings), ())
    scales = scales_of([recording.run for recording in recordings])
    stand_in, represented, limitations = represent(simulator, given, scales, np.random.default_rng(seed))
    values = stand_in.values
    damper = Damper(stand_in.model.id, values, stand_in.model.laws, None, simulator.name, values)
    return damper, represented.after, limitations


def _corrected(damper: Damper, recordings: Sequence[Recording], simulator: Simulator | None) -> Sequence[Recording]:
    """Return the recordings; where a damper corrects a simulator, with what this has beyond the model that stands for it.

    It answers to the motion and the current that the effects leave. What a play or a compliance leaves depends on the force
    in it, for which the measured one counts (`mrd_diagnosis.simulator.in_the_loop.forces_in_series`).
    """
    if simulator is not None:
        simulator = corrected_simulator(simulator, damper)
    elif damper.model.stands_for:
        raise InputError(
            f"the diagnosis corrects the simulator {damper.model.stands_for}; give it as well, with --simulator"
        )
    else:
        return recordings
    plain = damper.model.alone.vector(damper.plain)
    represented = beside_model(damper.model, plain, recordings, simulated_forces(simulator, recordings))
    if not simulator.answers_anew:
        return represented
    return SimulatorInLoop(simulator, damper.model, plain).corrected(damper.model, damper.theta, represented)


def _validated(
    result: RunResult, noise: RunNoise, exceeds: str, was_fitted: bool, offsets: bool, gains: bool
) -> ValidatedRun:
    """Take out offset and gain of a run where they were asked for."""
    measured, modelled = result.measured_counted, result.modelled_counted
    columns = [np.ones_like(modelled)] * offsets + [modelled] * gains
    found = np.linalg.lstsq(np.stack(columns, axis=1), measured - modelled, rcond=None)[0] if columns else np.empty(0)
    offset, gain = (float(found[0]) if offsets else 0.0), (float(found[-1]) if gains else 0.0)
    modelled = (1.0 + gain) * result.modelled + offset
    corrected = replace(result, modelled=modelled, metrics=metrics(measured, modelled[result.counted]))
    return ValidatedRun(corrected, nrmse(noise.sigma, measured), offset, gain, exceeds, was_fitted)


def _validation(
    damper: Damper,
    runs: tuple[ValidatedRun, ...],
    recordings: Sequence[Recording],
    noise: Sequence[RunNoise],
    fitted_known: bool,
) -> Validation:
    """Join the runs, and locate their error."""
    residuals = [run.result.measured_counted - run.result.modelled_counted for run in runs]
    joined, force = np.concatenate(residuals), np.concatenate([recording.force for recording in recordings])
    return Validation(
        damper,
        runs,
        nrmse(joined, force),
        float(np.sqrt(np.mean(joined**2))),
        nrmse(np.concatenate([of_run.sigma for of_run in noise]), force),
        localise(recordings, noise, residuals),
        fitted_known,
    )
