"""Stand-in: the damper model of the catalogue that comes nearest to a simulator of the user's own.

A simulator answers to a motion, but it cannot be told to have an effect. So the model of the catalogue that reproduces it
best stands for it: effects act in that model, and what the simulator has beyond the model is added as it is. Without effects
the sum is the simulator to the last digit. An effect that changes the motion of the damper or its current is as right as the
model reproduces the simulator, and this error is stated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import StandIn
from mrd_diagnosis.fitting.base_fit import global_fit
from mrd_diagnosis.recordings.recording_set import RecordingSet
from mrd_diagnosis.search.alternative_models import OTHER_MODELS
from mrd_diagnosis.simulator.in_the_loop import with_excess
from mrd_diagnosis.simulator.self_check import check_simulator
from mrd_diagnosis.wording.quantities import format_share
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.parallel import in_threads
from mrd_identification.preflight.finding import Finding
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, thinned
from mrd_runs.scales import Scales
from mrd_runs.signals.smoothed_run import Excess
from mrd_sim.models import DamperModel, find_model
from mrd_sim.path import run_path
from mrd_sim.simulators.simulator import Simulator, signals_of

Array = NDArray[np.float64]

EXACT = 1e-4
"""Error (NRMSE) below which a model reproduces a simulator exactly."""

MOST_SAMPLES = 4000
"""Samples of all runs together on which models are tried: a simulator has no noise."""

RANDOM_STARTS = 30
"""Random points from whose best a model is fitted to a simulator."""

EVALUATIONS = 40
"""Evaluations of a model in its fit to a simulator."""

CLOSE = 1e-3
"""Share of the simulator's force that a model may leave to be taken without trying the others."""

LAGS = 0.7
"""Share of its error that a model with a lag behind the current may leave to show that the simulator has one."""

SIMPLER_MODELS = ("bingham", "biviscous", "hysteretic_biviscous", "polynomial")
"""Models whose loop has no width of its own, which simulators often have as well."""


def note_on(stand_in: StandIn, *, asked_anew: bool = True) -> str:
    """Return what stands for a simulator, and how well; also for one that cannot be ``asked_anew`` about another motion."""
    text = f"The model {stand_in.model.id} stands for the simulator {stand_in.name}"
    if stand_in.error < EXACT:
        return f"{text}, whose force it reproduces exactly."
    alone = "" if asked_anew else " Recordings cannot be asked about effects before the damper: there the model answers."
    return (
        f"{text}. Alone, it reproduces the simulator's force with an error of {format_share(stand_in.error)} (NRMSE); what "
        f"the simulator has beyond it is kept as it is.{alone}"
    )


def simulated_forces(simulator: Simulator, recordings: Sequence[Recording]) -> list[Array]:
    """Return the force (n,) in N of a simulator at the samples of each recording.

    Raises
    ------
    InputError
        As of `mrd_sim.simulators.simulator.Simulator.force`.
    """
    return [simulator.force(signals_of(recording.smoothed)) for recording in recordings]


def find_stand_in(
    simulator: Simulator,
    recordings: Sequence[Recording],
    forces: Sequence[Array],
    scales: Scales,
    rng: np.random.Generator,
    model: str = "",
) -> StandIn:
    """Return the model of the catalogue that reproduces a simulator best.

    Parameters
    ----------
    simulator : Simulator
    recordings : sequence of Recording
    forces : sequence of ndarray (n,)
        What it has answered to the motion of each, in N.
    scales : Scales
        Of the damper.
    rng : numpy Generator
    model : str
        Id of the model, where it is chosen by the user.
    """
    simulated = [_with_force(recording, force) for recording, force in zip(recordings, forces, strict=True)]
    few = thinned(simulated, MOST_SAMPLES)
    best, least = None, np.inf
    for candidate in [model] if model else ["bouc_wen", *SIMPLER_MODELS, *(n for n in OTHER_MODELS if n != "bouc_wen")]:
        found = find_model(candidate, scales=scales)
        problem, _ = make_problem(found, few, fixed={"coil_lag": 0.0})
        theta = global_fit(problem, None, rng, RANDOM_STARTS, EVALUATIONS)
        error = _rms_error(problem, theta)
        if error < least:
            best, least = (problem, theta), error
        if least <= CLOSE * float(np.std(problem.force)):
            break
    assert best is not None
    problem, theta = best
    many = thinned(simulated, 4 * MOST_SAMPLES)
    problem = replace(problem, recordings=many)
    theta = fit_least_squares(problem, theta, EVALUATIONS)[0]
    error = _rms_error(problem, theta)
    # A lag that the simulator hardly shows would be free in the diagnosis, and hide the one that it lacks.
    lagging, _ = make_problem(problem.model, many)
    lagged = fit_least_squares(lagging, theta, EVALUATIONS)[0]
    if _rms_error(lagging, lagged) < LAGS * error and error > EXACT * float(np.std(problem.force)):
        theta, error = lagged, _rms_error(lagging, lagged)
    error /= max(float(np.std(problem.force)), np.finfo(float).tiny)
    standing = replace(problem.model, stands_for=simulator.name)
    return StandIn(simulator.name, simulator.source, standing, theta, error, simulator.values)


def _rms_error(problem: Problem, theta: Array) -> float:
    """Return the rms error of a model in N."""
    return float(np.sqrt(np.mean(problem.errors(theta) ** 2)))


def represent(
    simulator: Simulator, recordings: RecordingSet, scales: Scales, rng: np.random.Generator, model: str = ""
) -> tuple[StandIn, RecordingSet, tuple[Finding, ...]]:
    """Return what stands for a simulator, the recordings with what the simulator has beyond it, and what limits both.

    Raises
    ------
    InputError
        When the simulator fails, or has another sign or unit than the measured force.
    """
    fitted, held_out = simulated_forces(simulator, recordings.fitted), simulated_forces(simulator, recordings.held_out)
    findings = check_simulator(simulator, recordings.fitted, fitted)
    stand_in = find_stand_in(simulator, recordings.fitted, fitted, scales, rng, model)
    before = len(recordings.before)
    with_all = beside_model(stand_in.model, stand_in.theta, recordings.fitted, fitted)
    represented = RecordingSet(
        with_all[:before], with_all[before:], beside_model(stand_in.model, stand_in.theta, recordings.held_out, held_out)
    )
    return stand_in, represented, findings


def beside_model(
    model: DamperModel, theta: Array, recordings: Sequence[Recording], forces: Sequence[Array]
) -> tuple[Recording, ...]:
    """Return the recordings with what a simulator has beyond the model that stands for it, without effects.

    Parameters
    ----------
    model : DamperModel
    theta : ndarray (parameters,)
        With which the model reproduces the simulator.
    recordings : sequence of Recording
    forces : sequence of ndarray (n,)
        Force in N of the simulator at the samples of each.
    """

    def of_one(recording: Recording, force: Array) -> Recording:
        return with_excess(recording, Excess(force - model.alone.force(theta, recording.path.recorded)))

    return tuple(in_threads(lambda pair: of_one(*pair), list(zip(recordings, forces, strict=True))))


def _with_force(recording: Recording, force: Array) -> Recording:
    """Return a recording with another force, from rest."""
    smoothed = replace(recording.smoothed, run=replace(recording.run, force=force, info={}))
    return replace(recording, smoothed=smoothed, path=run_path(smoothed))
