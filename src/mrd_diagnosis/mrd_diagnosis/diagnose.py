"""Diagnosis of the gap between a simulator and recordings: this module calls the steps in their order."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.alternative_models import fit_alternative_models
from mrd_diagnosis.base_fit import fit_base
from mrd_diagnosis.closure import Closure, compute_closure
from mrd_diagnosis.decision import decide
from mrd_diagnosis.diagnosis import (
    Candidate,
    Cause,
    CorrectedSimulator,
    Diagnosis,
    Finding,
    Gap,
    HeldOutBy,
    Interval,
    Region,
)
from mrd_diagnosis.effect_search import search_effects, tolerated_excess
from mrd_diagnosis.explanation import (
    advise_next,
    list_alternative_models,
    list_alternatives,
    list_candidates,
    name_causes,
    probabilities_of_alternatives,
)
from mrd_diagnosis.flexible_remainder import explainable_fraction
from mrd_diagnosis.limitations import limitation_notes, untestable_effects
from mrd_diagnosis.localisation import find_oscillation, localise
from mrd_diagnosis.model_comparison import ModelComparison, compare_models
from mrd_diagnosis.null_distribution import draw_null_gains, p_value
from mrd_diagnosis.partial_explanation import explain_in_part, lacking_effects, rests_on_form
from mrd_diagnosis.preflight import preflight
from mrd_diagnosis.preflight.excitation import has_one_peak_speed
from mrd_diagnosis.refit import Refit
from mrd_diagnosis.sentences import fault_sentence, verdict_sentence
from mrd_diagnosis.weighting import Weighting, error_of_run
from mrd_identification.fit_file import StoredFit
from mrd_identification.metrics import nrmse
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording, prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import DamperModel, find_model
from mrd_trajectory.settings import GeneratorSettings

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


def no_progress(_stage: str, _fraction: float) -> None:
    """Ignore the progress."""


def diagnose(
    runs: Sequence[Run],
    model: str,
    *,
    held_out: Sequence[Run] = (),
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
        Id of the simulator's damper model.
    held_out : sequence of Run
        Runs that judge how far the gap closes. Without them, each run is left out in turn.
    parameters : StoredFit, optional
        Parameters of the simulator as it is (`mrd_identification.read_fit`). Without them, the model is fitted first.
    laws : str or mapping, optional
        Current laws; see `mrd_sim.models.DamperModel.with_laws`.
    effects : sequence of str
        Ids of the candidates; the whole catalogue when empty.
    bench : GeneratorSettings, optional
        Limits of the bench that an advised experiment must not exceed; by default, those of the shipped bench.
    seed : int
        The same seed and input give the same result.
    progress : callable
        Called with the current step and the fraction that is done. An exception that it raises ends the work.

    Raises
    ------
    InputError
        For an unknown model, law or effect, parameters out of their bounds, or no runs.
    """
    began = time.monotonic()
    if not runs:
        raise InputError("no runs to diagnose")
    candidates = [effect.id for effect in find_effects(list(effects) or list(EFFECTS))]
    base = find_model(model, laws if laws is not None else (parameters.laws if parameters else None))
    theta = _theta_as_given(base, parameters)
    progress("checking the recordings", 0.0)
    findings = preflight([*runs, *held_out], base)
    if any(finding.severity == "fault" for finding in findings):
        progress("done", 1.0)
        return Diagnosis(
            base,
            tuple(runs),
            tuple(held_out),
            seed,
            time.monotonic() - began,
            findings,
            "data_fault",
            fault_sentence(findings),
            _held_out_by(runs, held_out),
        )
    recordings = in_threads(prepare_recording, [*runs, *held_out])
    fitted, set_aside = recordings[: len(runs)], recordings[len(runs) :]
    return _diagnose_physics(base, theta, candidates, fitted, set_aside, findings, bench, seed, began, progress)


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


def _held_out_by(runs: Sequence[Run], held_out: Sequence[Run]) -> HeldOutBy:
    return "runs" if held_out else "leave-one-run-out" if len(runs) > 1 else "blocks"


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
    weighting, base, null_errors, notes = fit_base(model, theta_as_given, recordings, rng)
    untestable = untestable_effects(model, theta_as_given, candidates, recordings)
    progress("trying effects", 0.15)
    excluded = {entry.effect for entry in untestable}
    chosen, fits = search_effects(
        weighting,
        base,
        [effect for effect in candidates if effect not in excluded],
        null_errors,
        lambda fraction: progress("trying effects", 0.15 + 0.6 * fraction),
    )
    progress("comparing models", 0.75)
    singles = [fit for fit in fits if len(fit.effects) == 1]
    null_gains = draw_null_gains(base, [fit.refit for fit in singles], rng) if singles else np.zeros(1)
    comparison = compare_models(weighting, base, chosen, fits, rng)
    other_models: dict[str, Refit] = {}
    one_speed = has_one_peak_speed([recording.run for recording in recordings])
    if comparison.effects and one_speed:
        # At a single speed, an effect may imitate what another damper model does.
        progress("trying other damper models", 0.77)
        excess = comparison.best.chi_square - 1.0
        other_models = fit_alternative_models(comparison.weighting, comparison.base, excess, rng)
        comparison = comparison.with_alternative_models(other_models)
    chances = probabilities_of_alternatives(comparison, rng)
    p_value_of = {fit.effects[-1]: p_value(fit.gain, null_gains) for fit in chosen}
    p_values = [p_value_of[effect] for effect in comparison.effects]
    verdict = decide(comparison, base.chi_square, chances, p_values, rng)
    form_fraction = float("nan")
    closed_fractions: Mapping[str, Interval] = {}
    if verdict == "unknown_effect" or (verdict != "no_gap" and rests_on_form(comparison)):
        progress("looking for causes beside a wrong form", 0.8)
        # At a single speed, nothing tells an effect from the form.
        tried = [] if one_speed else [effect for effect in candidates if effect not in excluded]
        partial = explain_in_part(comparison, tried, rng)
        if verdict == "unknown_effect" or set(partial.comparison.effects) != set(comparison.effects):
            verdict = "partly_explained" if partial.comparison.effects else "unknown_effect"
            form_fraction = partial.form_fraction
        if verdict == "partly_explained":
            closed_fractions = {effect: held.closed_fraction for effect, held in partial.causes.items()}
            held = {effect: (held.probabilities, held.p_value) for effect, held in partial.causes.items()}
            known = {effect: (chances[effect], p_value_of[effect]) for effect in lacking_effects(comparison)}
            comparison = partial.comparison
            chances = {effect: chance for effect, (chance, _) in (known | held).items()}
            p_values = [p for _, p in (known | held).values()]
    if verdict == "no_gap":
        comparison, chances = comparison.without_effects(), {}
    listed, without_evidence = list_candidates(comparison, singles, null_gains, chances, rng)
    causes: tuple[Cause, ...] = ()
    if verdict != "unknown_effect":
        causes = name_causes(comparison, p_values, chances, rng, closed_fractions)

    progress("measuring how far the gap closes", 0.85)
    closure = compute_closure(comparison, held_out, rng)
    where: tuple[Region, ...] = ()
    oscillation = None
    explainable = float("nan")
    if verdict != "no_gap":
        progress("locating the gap", 0.9)
        residuals = [of_run.after if verdict == "partly_explained" else of_run.before for of_run in closure.counted]
        where, oscillation, explainable = _locate(closure, residuals, rng)
    nearest = models = None
    if verdict in ("unknown_effect", "partly_explained"):
        progress("trying other damper models", 0.93)
        nearest = _nearest(comparison, listed)
        if not other_models:
            tolerated = tolerated_excess(comparison.base)
            other_models = fit_alternative_models(comparison.weighting, comparison.base, tolerated, rng)
        models = list_alternative_models(comparison, other_models, rng)
    conclusive = verdict in ("explained", "ambiguous")
    if conclusive:
        progress("designing the next experiment", 0.95)
    advice = advise_next(comparison, chances, bench) if conclusive else None
    alternatives = list_alternatives(comparison, chances) if conclusive or verdict == "partly_explained" else ()
    gap = Gap(
        closure.noise_floor,
        closure.before,
        closure.after,
        closure.closed_fraction,
        _error_as_given(model, theta_as_given, weighting),
        explainable,
        closure.extrapolated,
        form_fraction,
    )
    best = comparison.best
    runs, set_aside = (tuple(recording.run for recording in group) for group in (recordings, held_out))
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
        held_out_by=_held_out_by(runs, set_aside),
        gap=gap,
        corrected=CorrectedSimulator(best.effects, best.values),
        where=where,
        oscillation=oscillation,
        causes=causes,
        alternatives=alternatives,
        nearest=nearest,
        candidates=listed,
        untestable=(*without_evidence, *untestable),
        alternative_models=models or (),
        next_experiment=advice,
        residuals=closure.residuals,
        notes=(*notes, *limitation_notes(recordings, weighting.noise)),
    )
    return replace(diagnosis, sentence=verdict_sentence(diagnosis))


def _locate(
    closure: Closure, residuals: Sequence[Array], rng: np.random.Generator
) -> tuple[tuple[Region, ...], Region | None, float]:
    """Return where the gap lies, an oscillation that has most of it, and the share that a flexible function can explain."""
    recordings = [residual.recording for residual in closure.counted]
    noise = [residual.noise for residual in closure.counted]
    where = localise(recordings, noise, residuals, rng)
    oscillation = find_oscillation(recordings, noise, residuals)
    return where, oscillation, explainable_fraction(recordings, residuals, [of_run.sigma for of_run in noise], rng)


def _nearest(comparison: ModelComparison, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate that comes nearest to the gap: the chosen effects, or else the best one that closes anything."""
    chosen = next((candidate for candidate in candidates if candidate.effects == comparison.effects), None)
    if chosen is None and candidates and candidates[0].closed_fraction.value > 0.0:
        return candidates[0]
    return chosen


def _error_as_given(model: DamperModel, theta: Array | None, weighting: Weighting) -> float | None:
    """Return the NRMSE of the simulator with the parameters that were handed in, without the runs' offsets and gain
    errors.
    """
    if theta is None:
        return None
    problem = weighting.problem(model, theta)
    errors = [error_of_run(problem, theta, run)[1] for run in range(len(weighting.recordings))]
    return nrmse(np.concatenate(errors), problem.force)
