"""Diagnosis of the gap between a simulator and recordings: this module calls the steps in their order."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.change import explain_change
from mrd_diagnosis.closure.closure import Closure, compute_closure
from mrd_diagnosis.decision.decision import decide
from mrd_diagnosis.decision.explanation import (
    Explanation,
    advise_next,
    list_alternative_models,
    list_alternatives,
    list_candidates,
    probabilities_of_alternatives,
)
from mrd_diagnosis.decision.judgement import judge, reject_others
from mrd_diagnosis.diagnosis import (
    AlternativeModel,
    Candidate,
    CorrectedSimulator,
    Diagnosis,
    Finding,
    Gap,
    HeldOutBy,
    Region,
)
from mrd_diagnosis.fitting.base_fit import fit_base
from mrd_diagnosis.fitting.null_distribution import NullGains, draw_null_gains
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.fitting.weighting import Weighting, error_of_run
from mrd_diagnosis.localisation.localise import localise
from mrd_diagnosis.localisation.oscillation import find_oscillation
from mrd_diagnosis.recordings.closed_loop import closed_loop_notes
from mrd_diagnosis.recordings.limitations import limitation_notes, untestable_effects
from mrd_diagnosis.report.sentences import fault_sentence, imitation_note, verdict_sentence
from mrd_diagnosis.search.alternative_models import best_model, fit_alternative_models
from mrd_diagnosis.search.effect_search import EffectFit, search_effects, tolerated_excess
from mrd_diagnosis.search.model_comparison import ModelComparison, compare_models, compare_on_all_samples
from mrd_diagnosis.wrong_form.flexible_remainder import explainable_fraction
from mrd_diagnosis.wrong_form.partial_explanation import explain_in_part, rests_on_form
from mrd_identification.fit_file import StoredFit
from mrd_identification.metrics import nrmse
from mrd_identification.parallel import in_threads
from mrd_identification.preflight import preflight
from mrd_identification.preflight.excitation import repeats_one_stroke
from mrd_identification.recording import Recording, prepare_recording, thinned
from mrd_runs import Run
from mrd_runs.scales import scales_of
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import DamperModel, find_model
from mrd_trajectory.settings import GeneratorSettings

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

NOTE_ON_CHANGE = (
    "The gap is the change since the reference runs. What the model lacks in these runs and in those alike is taken up by a "
    "flexible function of motion, current and force; the rest of the error counts as noise."
)

NOTE_ON_SINGLE_RUNS = (
    "An effect is named only if it differs more between the runs before and after than among them, and of a single run on "
    "either side this is not known: record at least two before and two after."
)

BEST_MODEL = "auto"
"""In place of a model's id: the model of the catalogue that predicts the recordings best."""

START_OF_CHOICE = "bouc_wen"
"""Model with which the noise is estimated before the best model is chosen."""

MOST_SAMPLES = 10_000
"""Samples of all runs together on which effects are searched. What was found is then fitted to all samples and judged by
these."""


def no_progress(_stage: str, _fraction: float) -> None:
    """Ignore the progress."""


def diagnose(
    runs: Sequence[Run],
    model: str,
    *,
    held_out: Sequence[Run] = (),
    reference: Sequence[Run] = (),
    parameters: StoredFit | None = None,
    laws: str | Mapping[str, str] | None = None,
    effects: Sequence[str] = (),
    bench: GeneratorSettings | None = None,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Diagnosis:
    """Explain the gap between a simulator and recordings.

    Parameters
    ----------
    runs : sequence of Run
        In the order in which they were recorded.
    model : str
        Id of the simulator's damper model, or "auto" for the one that predicts the recordings best without any effect.
    held_out : sequence of Run
        Runs that judge how far the gap closes. Without them, each run is left out in turn.
    reference : sequence of Run
        Runs of the same rig from before something changed. With them, the gap is the difference between them and ``runs``
        that their own difference in motion and current does not explain. They exclude ``held_out``.
    parameters : StoredFit, optional
        Parameters of the simulator as it is (`mrd_identification.read_fit`). Without them, the model is fitted first.
    laws : str or mapping, optional
        Current laws; see `mrd_sim.models.DamperModel.with_laws`.
    effects : sequence of str
        Ids of the candidates; when empty, all of the catalogue that recordings without or with ``reference`` can show.
    bench : GeneratorSettings, optional
        Limits of the bench that an advised experiment must not exceed; by default, those of the shipped bench.
    seed : int
        The same seed and input give the same result.
    progress : callable
        Called with the current step and the fraction that is done. An exception that it raises ends the work.

    Raises
    ------
    InputError
        For an unknown model, law or effect, parameters out of their bounds, no runs, or both reference and held-out runs.
    """
    began = time.monotonic()
    if not runs:
        raise InputError("no runs to diagnose")
    if reference and held_out:
        raise InputError("found both reference and held-out runs, expected one kind: a change is judged on all runs in turn")
    candidates = candidates_for(effects, is_change=bool(reference))
    if model == BEST_MODEL and parameters:
        model = parameters.model
    laws = laws if laws is not None else (parameters.laws if parameters else None)
    scales = scales_of([*reference, *runs])
    base = find_model(START_OF_CHOICE if model == BEST_MODEL else model, laws, scales=scales)
    theta = _theta_as_given(base, parameters)
    progress("checking the recordings", 0.0)
    expected = None if model == BEST_MODEL else base
    findings = preflight([*runs, *held_out], expected)
    if reference:
        findings = (*preflight(reference, expected), *findings)
    if any(finding.severity == "fault" for finding in findings):
        progress("done", 1.0)
        return _faulty(base, runs, held_out, reference, findings, seed, began)
    before = [replace(recording, without_effects=True) for recording in in_threads(prepare_recording, reference)]
    fitted, set_aside = (in_threads(prepare_recording, group) for group in (runs, held_out))
    if model == BEST_MODEL:
        progress("choosing the damper model", 0.02)
        base = best_model(base, thinned(fitted, MOST_SAMPLES), np.random.default_rng(seed))
    diagnosis = _diagnose_physics(
        base, theta, candidates, [*before, *fitted], set_aside, findings, bench, seed, began, progress
    )
    if model == BEST_MODEL:
        chosen = f"Of the damper models that were tried, {base.id} predicts these recordings best."
        diagnosis = replace(diagnosis, notes=(chosen, *diagnosis.notes))
    return replace(diagnosis, notes=(*diagnosis.notes, *closed_loop_notes(runs)))


def _notes_on_change(runs: int, reference: int) -> tuple[str, ...]:
    """Return what limits a comparison with reference runs."""
    if not reference:
        return ()
    return (NOTE_ON_CHANGE, *([NOTE_ON_SINGLE_RUNS] if min(runs, reference) < 2 else []))


def candidates_for(effects: Sequence[str], *, is_change: bool) -> list[str]:
    """Return the ids of the effects to try: those named, or all that recordings of this kind can show."""
    if not effects:
        return [name for name, effect in EFFECTS.items() if is_change or not effect.only_as_change]
    named = find_effects(list(effects))
    if unseen := [effect.id for effect in named if effect.only_as_change and not is_change]:
        raise InputError(
            f"effect {unseen[0]} shows only as a change since other recordings, and there are none; name them by --reference"
        )
    return [effect.id for effect in named]


def _theta_as_given(base: DamperModel, parameters: StoredFit | None) -> Array | None:
    if parameters is None:
        return None
    if parameters.model != base.id:
        raise InputError(f"--parameters: found a fit of the model {parameters.model}, expected {base.id}")
    if parameters.effects:
        raise InputError(
            f"--parameters: found the effects {', '.join(parameters.effects)} in the fit, expected none; fit the model "
            "without effects"
        )
    if dict(parameters.laws) != {name: law for name, law in base.laws.items() if name in parameters.laws}:
        raise InputError(
            f"--parameters: found the current laws {dict(parameters.laws)}, expected those of the model: {dict(base.laws)}"
        )
    return base.vector({name: value for name, value in parameters.values.items() if "." not in name})


def _held_out_by(runs: Sequence[Run], held_out: Sequence[Run], *, is_change: bool) -> HeldOutBy:
    # What is common to the recordings from before and after predicts parts of a run, not a whole one.
    return "runs" if held_out else "leave-one-run-out" if len(runs) > 1 and not is_change else "blocks"


def _faulty(
    model: DamperModel,
    runs: Sequence[Run],
    held_out: Sequence[Run],
    reference: Sequence[Run],
    findings: tuple[Finding, ...],
    seed: int,
    began: float,
) -> Diagnosis:
    """Return the diagnosis that the recordings are faulty."""
    return Diagnosis(
        model,
        tuple(runs),
        tuple(held_out),
        seed,
        time.monotonic() - began,
        findings,
        "data_fault",
        fault_sentence(findings),
        _held_out_by(runs, held_out, is_change=bool(reference)),
        tuple(reference),
    )


def _diagnose_physics(
    model: DamperModel,
    theta_as_given: Array | None,
    candidates: Sequence[str],
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    findings: tuple[Finding, ...],
    bench: GeneratorSettings | None,
    seed: int,
    began: float,
    progress: Progress,
) -> Diagnosis:
    """Diagnose recordings that have no fault."""
    rng = np.random.default_rng(seed)
    progress("fitting the model", 0.05)
    weighting, base, null_errors, notes = fit_base(model, theta_as_given, thinned(recordings, MOST_SAMPLES), rng)
    untestable = untestable_effects(model, theta_as_given, candidates, recordings)
    excluded = {entry.effect for entry in untestable}
    tried = [effect for effect in candidates if effect not in excluded]
    progress("trying effects", 0.15)
    other_models: dict[str, Refit] = {}
    if recordings[0].without_effects:
        explanation, singles, null_gains = explain_change(
            weighting, base, tried, rng, lambda fraction: progress("trying effects", 0.15 + 0.7 * fraction)
        )
        complete = explanation.comparison
    else:
        explanation, complete, singles, null_gains, other_models = _explain_gap(
            weighting, base, null_errors, tried, rng, progress
        )
    runs = tuple(recording.run for recording in recordings if not recording.without_effects)
    set_aside = tuple(recording.run for recording in held_out)
    reference = tuple(recording.run for recording in recordings if recording.without_effects)
    judgement = judge(explanation, complete, findings, [*reference, *runs], rng)
    if judgement.faults:
        progress("done", 1.0)
        faults = tuple(replace(finding, severity="fault") for finding in judgement.faults)
        others = tuple(finding for finding in findings if finding not in judgement.faults)
        faulty = _faulty(model, runs, set_aside, reference, (*faults, *others), seed, began)
        return replace(faulty, rejected=judgement.rejected, notes=(imitation_note(judgement.rejected),))
    explanation, complete = judgement.explanation, judgement.complete
    verdict, comparison, chances = explanation.verdict, explanation.comparison, explanation.probabilities
    if verdict == "no_gap":
        comparison, complete, chances = comparison.without_effects(), complete.without_effects(), {}
    listed, without_evidence = list_candidates(comparison, singles, null_gains, chances, rng)

    progress("measuring how far the gap closes", 0.9)
    closure = compute_closure(complete, held_out, rng)
    where: tuple[Region, ...] = ()
    oscillation = None
    explainable = float("nan")
    if verdict != "no_gap":
        progress("locating the gap", 0.93)
        residuals = [of_run.after if verdict == "partly_explained" else of_run.before for of_run in closure.counted]
        where, oscillation, explainable = _locate(closure, residuals, rng)
    nearest = None
    models: tuple[AlternativeModel, ...] = ()
    conclusive = verdict == "explained" or (verdict == "ambiguous" and bool(judgement.causes))
    if verdict != "no_gap" and not conclusive:
        nearest = _nearest(comparison, listed)
        models = list_alternative_models(comparison, other_models, rng)
    if conclusive:
        progress("designing the next experiment", 0.96)
    corrected, without_effects = complete.best.values, complete.without_effects().best.values
    if reference:
        without_effects = _damper_before(weighting, base)
        corrected = corrected | without_effects
    gap = Gap(
        closure.noise_floor,
        closure.before,
        closure.after,
        closure.closed_fraction,
        _error_as_given(model, theta_as_given, complete.weighting, closure),
        explainable,
        closure.extrapolated,
        explanation.form_fraction,
    )
    progress("done", 1.0)
    diagnosis = Diagnosis(
        model=model,
        runs=runs,
        held_out=set_aside,
        seed=seed,
        elapsed=time.monotonic() - began,
        findings=findings,
        verdict=verdict,
        sentence="",
        held_out_by=_held_out_by(runs, set_aside, is_change=bool(reference)),
        reference=reference,
        gap=gap,
        corrected=CorrectedSimulator(
            complete.best.effects,
            corrected,
            without_effects,
            {} if theta_as_given is None else dict(zip(model.names, map(float, theta_as_given), strict=True)),
        ),
        where=where,
        oscillation=oscillation,
        causes=judgement.causes,
        rejected=reject_others(judgement, listed, models, findings, [*reference, *runs]),
        weighed=explanation.weighed,
        alternatives=list_alternatives(comparison, chances) if verdict not in ("no_gap", "unknown_effect") else (),
        nearest=nearest,
        candidates=listed,
        untestable=(*without_evidence, *untestable),
        alternative_models=models,
        next_experiment=advise_next(comparison, chances, bench) if conclusive else None,
        residuals=closure.residuals,
        notes=(
            *notes,
            *_notes_on_change(len(runs), len(reference)),
            *limitation_notes(recordings, complete.weighting.noise),
        ),
    )
    return replace(diagnosis, sentence=verdict_sentence(diagnosis))


def _explain_gap(
    weighting: Weighting,
    base: Refit,
    null_errors: Sequence[Array],
    effects: Sequence[str],
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[Explanation, ModelComparison, list[EffectFit], NullGains, dict[str, Refit]]:
    """Explain the gap of a model; return the explanation, its comparison on all samples, each effect by itself, the gains in
    noise alone, and other damper models where they were tried.
    """
    chosen, fits = search_effects(
        weighting, base, effects, null_errors, lambda fraction: progress("trying effects", 0.15 + 0.3 * fraction)
    )
    progress("comparing models", 0.45)
    singles = [fit for fit in fits if len(fit.effects) == 1]
    null_gains = draw_null_gains(base, [fit.refit for fit in singles], rng)
    comparison = compare_models(weighting, base, chosen, fits, rng)
    p_values = {fit.effects[-1]: null_gains.p_value(fit.gain, fit.refit.problem) for fit in chosen}
    complete = compare_on_all_samples(comparison, rng)
    other_models: dict[str, Refit] = {}
    chances = probabilities_of_alternatives(comparison, rng)
    verdict = decide(complete, base.chi_square, chances, p_values, rng)
    if verdict in ("explained", "ambiguous"):
        # Before an effect is named: another damper model may explain as much without any.
        progress("trying other damper models", 0.48)
        excess = comparison.best.chi_square - 1.0
        other_models = fit_alternative_models(comparison.weighting, comparison.base, excess, rng)
        comparison, complete = (compared.with_alternative_models(other_models) for compared in (comparison, complete))
        chances = probabilities_of_alternatives(comparison, rng)
        verdict = decide(complete, base.chi_square, chances, p_values, rng)
    explanation = Explanation(verdict, comparison, chances, p_values)
    runs = [recording.run for recording in weighting.recordings]
    if verdict == "unknown_effect" or (verdict != "no_gap" and rests_on_form(comparison)):
        if not other_models:
            progress("trying other damper models", 0.48)
            tolerated = tolerated_excess(comparison.base)
            other_models = fit_alternative_models(comparison.weighting, comparison.base, tolerated, rng)
        stage = "looking for causes beside a wrong form"
        # Of one stroke, nothing tells an effect from the form.
        explanation = explain_in_part(
            explanation,
            list(other_models.values()),
            [] if repeats_one_stroke(runs) else effects,
            null_gains,
            rng,
            lambda fraction: progress(stage, 0.55 + 0.35 * fraction),
        )
        complete = compare_on_all_samples(explanation.comparison, rng)
    return explanation, complete, singles, null_gains, other_models


def _locate(
    closure: Closure, residuals: Sequence[Array], rng: np.random.Generator
) -> tuple[tuple[Region, ...], Region | None, float]:
    """Return where the gap lies, an oscillation that has most of it, and the share that a flexible function can explain."""
    recordings = [residual.recording for residual in closure.counted]
    noise = [residual.noise for residual in closure.counted]
    where = localise(recordings, noise, residuals)
    oscillation = find_oscillation(recordings, noise, residuals)
    return where, oscillation, explainable_fraction(recordings, residuals, [of_run.sigma for of_run in noise], rng)


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
    errors = [error_of_run(problem, theta, run)[1] for run in counted]
    return nrmse(np.concatenate(errors), np.concatenate([recordings[run].force for run in counted]))
