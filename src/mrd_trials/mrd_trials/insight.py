"""What one who knows the answer finds: how far the gap can close, where it lies, what the next experiment was worth.

And what simpler methods say, which the diagnosis is compared with.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis import diagnose
from mrd_diagnosis.diagnose import fit_base
from mrd_diagnosis.diagnosis import Diagnosis
from mrd_diagnosis.experiment_design.candidates import library
from mrd_diagnosis.localisation import where
from mrd_diagnosis.model_comparison import INITIAL_RUN_SCATTER
from mrd_diagnosis.noise_model import run_noise
from mrd_diagnosis.refit import run_errors
from mrd_diagnosis.weighting import Weighting
from mrd_identification.parallel import in_threads
from mrd_identification.recording import prepare_recording
from mrd_runs import Run, read_runs
from mrd_sim.models import DamperModel, find_model
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import read_settings
from mrd_trials.case import DETECTABLE
from mrd_trials.excitation import commanded
from mrd_trials.make import Exhibit, Order, Recipe, Session, as_run, plan_trial, read_trial
from mrd_trials.pool import every
from mrd_trials.records import Answer, Bin, Insight, Submission, completed
from mrd_trials.run import read_given
from mrd_trials.survey import survey

Array = NDArray[np.float64]

MIMICRY = 0.9
"""Share of what the cause closes from which another effect is as good an answer on these runs."""

INSIGHTS = "insights.jsonl"


def insights(
    folder: Path,
    answers: Mapping[str, Answer],
    submissions: Mapping[str, Submission],
    output: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _n, _of: None,
) -> dict[str, Insight]:
    """Of every plant that was judged; those that stand in ``output`` already are kept.

    Parameters
    ----------
    folder : Path
        Of the trial.
    answers, submissions : mapping
        By plant.
    output : Path
        Folder that gets `INSIGHTS`.
    workers : int
        Processes.
    progress : callable
        Called with the number of plants that are done, and of all.
    """
    trial = read_trial(folder)
    orders = {order.plant: order for order in plan_trial(trial.recipe)[0]}
    judged = {exhibit.plant: exhibit for exhibit in trial.exhibits if exhibit.plant in submissions}

    def work(plants: Sequence[str]) -> Iterator[Insight]:
        return every(
            insight, [(folder, trial.recipe, orders[p], judged[p], answers[p], submissions[p]) for p in plants], workers
        )

    return completed(Insight, output / INSIGHTS, list(judged), work, progress)


def insight(folder: Path, recipe: Recipe, order: Order, exhibit: Exhibit, answer: Answer, said: Submission) -> Insight:
    """Of one plant; nothing where the diagnosis failed, which would fail again.

    Parameters
    ----------
    folder : Path
        Of the trial.
    recipe, order
        By which the plant was made.
    exhibit, answer, said
        What everybody sees of it, what it is, what the diagnosis says.
    """
    found = Insight(answer.plant, alike={cause: (cause,) for cause in answer.causes})
    if said.verdict == "failed":
        return found
    runs = read_given(folder, exhibit)
    detectable = answer.kind == "single" and answer.signal_to_floor > DETECTABLE
    if (detectable or (answer.kind == "null" and answer.excitation == "rich")) and said.verdict != "data_fault":
        peers = survey(runs, answer.model)
        alike = {cause: _alike(cause, peers.closed) for cause in answer.causes}
        found = replace(found, rankings=peers.rankings, alike=alike)
    if answer.causes and answer.kind != "absent":
        knowing = diagnose(runs, answer.model, effects=answer.causes)
        if knowing.causes or knowing.nearest:
            found = replace(found, closed=knowing.closed.value, where=_true_map(knowing))
    if said.causes:
        fresh = sorted((folder / "fresh" / answer.plant).glob("*.csv"))
        found = replace(found, fresh=_closed_on(runs, read_runs([str(file) for file in fresh]), answer.model, said))
    if said.verdict == "ambiguous" and said.advice:
        session = Session.of(order, recipe.recorded)
        safe = library(read_settings(None))
        lot = safe[int(np.random.default_rng([*order.seed, 7]).integers(len(safe)))]
        found = replace(
            found, advised=_resolved(session, answer, runs, _plan(said.advice)), random=_resolved(session, answer, runs, lot)
        )
    return found


def _alike(cause: str, closed: Mapping[str, float]) -> tuple[str, ...]:
    """Effects that close nearly as much as a cause does."""
    if not closed.get(cause, 0.0) > 0.0:
        return (cause,)
    return tuple(name for name, share in closed.items() if name == cause or share >= MIMICRY * closed[cause])


def _true_map(knowing: Diagnosis) -> tuple[Bin, ...]:
    """Where what the true causes change lies, on the bins of every axis."""
    recordings = [trace.recording for trace in knowing.residuals]
    nothing = 1e-9  # N: where nothing may be, no sample counts
    noises = [trace.noise for trace in knowing.residuals]
    silent = [replace(noise, sigma=np.full_like(noise.sigma, nothing), force=nothing, motion=0.0) for noise in noises]
    changes = [trace.before - trace.after for trace in knowing.residuals]
    if not any(change.any() for change in changes):
        return ()
    regions = where(recordings, silent, changes, np.random.default_rng(0))
    return tuple(Bin(region.axis, region.lower, region.upper, region.share.value) for region in regions)


def _closed_on(runs: Sequence[Run], fresh: Sequence[Run], name: str, said: Submission) -> float:
    """Share of the gap on fresh runs that the submitted parameters close, those runs' own offset and gain taken out."""
    model, corrected = find_model(name), find_model(name, effects=said.effects)
    recordings = in_threads(prepare_recording, [*runs, *fresh])
    alone = fit_base(model, None, recordings[: len(runs)], np.random.default_rng(0))[1].theta
    theta = corrected.vector(said.parameters)
    noises = run_noise(recordings, corrected, theta, np.random.default_rng(0))
    weighting = Weighting(recordings, noises, INITIAL_RUN_SCATTER, {})

    def squares(of: DamperModel, at: Array) -> float:
        problem = weighting.problem(of, at)
        errors = [run_errors(problem, at, run)[1] for run in range(len(runs), len(recordings))]
        return float(sum(error @ error for error in errors))

    before, after = squares(model, alone), squares(corrected, theta)
    floor = float(sum(noise.sigma @ noise.sigma for noise in noises[len(runs) :]))
    return (before - after) / (before - floor) if before > floor else np.nan


def _resolved(session: Session, answer: Answer, runs: Sequence[Run], planned: Plan) -> bool:
    """Whether a diagnosis with one more run names the causes and nothing else."""
    more = session.record(answer.effects, [commanded(planned)])[-1]
    try:
        found = diagnose([*runs, as_run("next", more)], answer.model)
    except InputError:
        return False
    return found.verdict == "explained" and {cause.effect for cause in found.causes} == set(answer.causes)


def _plan(text: str) -> Plan:
    bench = read_settings(None)
    return plan(parse_experiment(text, "advice"), bench.limits, bench.force_envelope)
