"""Description of a conclusion: how far the gap closes, where it lies, everything that was tried, and what to record next."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.closure.closure import Closure, compute_closure
from mrd_diagnosis.decision.candidates import list_alternative_models, list_alternatives, list_candidates
from mrd_diagnosis.decision.conclusion import Conclusion, reject_others
from mrd_diagnosis.decision.explanation import FittedExplanation
from mrd_diagnosis.decision.rejection_rules import leaves_open
from mrd_diagnosis.diagnosis import Advice, Candidate, CorrectedSimulator, Diagnosis, Finding, Gap, Region, Verdict
from mrd_diagnosis.experiment_design.open_explanations import advise_next
from mrd_diagnosis.fitting.base_fit import FittedBase
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.fitting.residual_regression import explainable_fraction
from mrd_diagnosis.fitting.weighting import Weighting, error_of_run
from mrd_diagnosis.localisation.localise import localise
from mrd_diagnosis.localisation.oscillation import find_oscillation
from mrd_diagnosis.recordings.imitating_limitations import clock_finding
from mrd_diagnosis.recordings.limitations import limitation_notes
from mrd_diagnosis.search.model_comparison import ModelComparison
from mrd_diagnosis.start import Request, Start
from mrd_identification.metrics import nrmse
from mrd_sim.models import DamperModel
from mrd_trajectory.settings import GeneratorSettings

Array = NDArray[np.float64]

NOTE_ON_CHANGE = (
    "The gap is the change since the reference runs. What the model lacks in both sets alike is described by a free "
    "correction (a flexible function of motion, current and force); the rest of the error counts as noise."
)

NOTE_ON_SINGLE_RUNS = (
    "An effect is named only if it differs more between the runs before and after than among them, and of a single run on "
    "either side this is not known: record at least two before and two after."
)


@dataclass(frozen=True)
class _Location:
    """Where the gap lies, an oscillation that has most of it, and the share that a flexible function can explain."""

    where: tuple[Region, ...] = ()
    oscillation: Region | None = None
    explainable: float = float("nan")


def describe(
    start: Start,
    request: Request,
    findings: tuple[Finding, ...],
    fit: FittedBase,
    fitted: FittedExplanation,
    conclusion: Conclusion,
    rng: np.random.Generator,
) -> Diagnosis:
    """Describe a conclusion: measure how far the gap closes, locate it, list what was tried, and advise."""
    progress, explanation, complete = request.progress, conclusion.explanation, conclusion.complete
    verdict, has_gap = explanation.verdict, explanation.verdict != "no_gap"
    comparison, probabilities = start.in_loop(explanation.comparison), explanation.probabilities
    if not has_gap:
        comparison, complete, probabilities = comparison.without_effects(), complete.without_effects(), {}
    listed, without_evidence = list_candidates(comparison, fitted.singles, fitted.null_gains, probabilities, rng)
    progress("measuring how far the gap closes", 0.9)
    closure = _closure(start, complete, rng)
    if has_gap:
        progress("locating the gap", 0.93)
    location = _locate(closure, verdict, rng)
    is_open = has_gap and not (verdict == "explained" or (verdict == "ambiguous" and bool(conclusion.causes)))
    harmful = {entry.effect for entry in conclusion.rejected if entry.rule == "worse"}
    models = list_alternative_models(comparison, fitted.other_models, rng) if is_open else ()

    def designing(fraction: float) -> None:
        progress("designing the next experiment", 0.96 + 0.03 * fraction)

    advice = _advice(fitted, conclusion, rng, request.bench, designing) if has_gap else None
    progress("done", 1.0)
    return Diagnosis(
        model=start.model,
        runs=request.runs,
        held_out=request.held_out,
        seed=request.seed,
        elapsed=time.monotonic() - request.began,
        findings=findings,
        verdict=verdict,
        sentence="",
        held_out_by=request.held_out_by,
        reference=request.reference,
        gap=_gap(start, complete.weighting, closure, location, explanation.form_fraction),
        corrected=_corrected(start, complete, _damper_before(fit.weighting, fit.base) if request.reference else {}),
        where=location.where,
        oscillation=location.oscillation,
        causes=conclusion.causes,
        rejected=reject_others(conclusion, listed, models, findings, clock_finding(request.runs, request.reference)),
        weighed=explanation.weighed,
        alternatives=list_alternatives(comparison, probabilities) if verdict not in ("no_gap", "unknown_effect") else (),
        nearest=_nearest(comparison, [c for c in listed if harmful.isdisjoint(c.effects)]) if is_open else None,
        candidates=listed,
        untestable=without_evidence,
        alternative_models=models,
        next_experiment=advice,
        residuals=closure.residuals,
        notes=(*fit.notes, *_notes(start, request, complete)),
    )


def _notes(start: Start, request: Request, complete: ModelComparison) -> list[str]:
    """Return what limits a diagnosis."""
    return [
        *([start.loop.note(complete)] if start.loop else []),
        *_notes_on_change(len(request.runs), len(request.reference)),
        *limitation_notes(start.recordings.fitted, complete.weighting.noise),
    ]


def _closure(start: Start, complete: ModelComparison, rng: np.random.Generator) -> Closure:
    """Measure how far the gap closes, with a user's simulator in the loop where there is one."""
    held_out = start.recordings.held_out
    return compute_closure(complete, held_out, rng, start.loop.prepared(complete.best, held_out) if start.loop else held_out)


def _gap(start: Start, weighting: Weighting, closure: Closure, location: _Location, form_fraction: float) -> Gap:
    return Gap(
        closure.noise_floor,
        closure.before,
        closure.after,
        closure.closed_fraction,
        _error_as_given(start.model, start.theta_as_given, weighting, closure),
        location.explainable,
        closure.extrapolated,
        form_fraction,
        closure.is_worse,
    )


def _advice(
    fitted: FittedExplanation,
    conclusion: Conclusion,
    rng: np.random.Generator,
    bench: GeneratorSettings | None,
    progress: Callable[[float], None],
) -> Advice | None:
    """Advise what to record next; what a rule rejected may be there all the same, if the rule leaves that open."""
    rejected = {entry.effect: leaves_open(entry.rule) for entry in conclusion.rejected}
    return advise_next(fitted.explanation, rejected, fitted.singles, rng, bench, progress)


def _corrected(start: Start, complete: ModelComparison, before: Mapping[str, float]) -> CorrectedSimulator:
    """Return the simulator with the effects; where a change was explained, with the damper as it was ``before``."""
    theta = start.theta_as_given
    as_given = {} if theta is None else dict(zip(start.model.names, map(float, theta), strict=True))
    without_effects = before or complete.without_effects().best.values
    return CorrectedSimulator(complete.best.effects, {**complete.best.values, **before}, without_effects, as_given)


def _locate(closure: Closure, verdict: Verdict, rng: np.random.Generator) -> _Location:
    """Locate the gap; of a partly explained one, what remains."""
    if verdict == "no_gap":
        return _Location()
    residuals = [of_run.after if verdict == "partly_explained" else of_run.before for of_run in closure.counted]
    recordings = [residual.recording for residual in closure.counted]
    noise = [residual.noise for residual in closure.counted]
    return _Location(
        localise(recordings, noise, residuals),
        find_oscillation(recordings, noise, residuals),
        explainable_fraction(recordings, residuals, [of_run.sigma for of_run in noise], rng),
    )


def _nearest(comparison: ModelComparison, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate that comes nearest to the gap: the chosen effects, or else the best one that closes anything."""
    chosen = next((candidate for candidate in candidates if candidate.effects == comparison.effects), None)
    if chosen is None and candidates and candidates[0].closed_fraction.value > 0.0:
        return candidates[0]
    return chosen


def _damper_before(weighting: Weighting, base: Refit) -> dict[str, float]:
    """Return the parameters of the model by name, refitted to the recordings from before a change alone."""
    runs = [run for run, recording in enumerate(weighting.recordings) if recording.without_effects]
    before = replace(
        weighting, recordings=[weighting.recordings[run] for run in runs], noise=[weighting.noise[run] for run in runs]
    )
    return refit_on(before, base).values


def _error_as_given(model: DamperModel, theta: Array | None, weighting: Weighting, closure: Closure) -> float | None:
    """Return the NRMSE of the simulator with the parameters that were handed in, without the runs' offsets and gain
    errors: on the runs on which the other errors of the closure were measured.
    """
    if theta is None:
        return None
    residuals = closure.residuals
    recordings, noise = [residual.recording for residual in residuals], [residual.noise for residual in residuals]
    problem = replace(weighting, recordings=recordings, noise=noise).problem(model, theta)
    counted = [run for run, residual in enumerate(residuals) if residual.held_out == closure.counted[0].held_out]
    errors = [error_of_run(problem, theta, run).newtons for run in counted]
    return nrmse(np.concatenate(errors), np.concatenate([recordings[run].force for run in counted]))


def _notes_on_change(runs: int, reference: int) -> tuple[str, ...]:
    """Return what limits a comparison with reference runs."""
    if not reference:
        return ()
    return (NOTE_ON_CHANGE, *([NOTE_ON_SINGLE_RUNS] if min(runs, reference) < 2 else []))
