"""Diagnosis of the gap between a simulator and recordings: this module calls the steps in their order."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_diagnosis.closure.closure import Closure, compute_closure
from mrd_diagnosis.decision.candidates import list_alternative_models, list_alternatives, list_candidates
from mrd_diagnosis.decision.conclusion import Conclusion, conclude, reject_others
from mrd_diagnosis.decision.explanation import FittedExplanation
from mrd_diagnosis.decision.rejection_rules import leaves_open
from mrd_diagnosis.diagnosis import (
    Advice,
    Candidate,
    CorrectedSimulator,
    Diagnosis,
    Finding,
    Gap,
    HeldOutBy,
    Region,
    StandIn,
    Verdict,
)
from mrd_diagnosis.experiment_design.open_explanations import advise_next
from mrd_diagnosis.explain_change import explain_change
from mrd_diagnosis.explain_gap import explain_gap
from mrd_diagnosis.fitting.base_fit import FittedBase, fit_base
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.fitting.weighting import Weighting, error_of_run
from mrd_diagnosis.localisation.localise import localise
from mrd_diagnosis.localisation.oscillation import find_oscillation
from mrd_diagnosis.recordings.closed_loop import closed_loop_notes
from mrd_diagnosis.recordings.limitations import limitation_notes, untestable_effects
from mrd_diagnosis.recordings.recording_set import RecordingSet, held_out_by
from mrd_diagnosis.report.sentences import fault_sentence, imitation_note, verdict_sentence
from mrd_diagnosis.search.alternative_models import OTHER_MODELS, best_model
from mrd_diagnosis.search.model_comparison import ModelComparison, RefitComparison, unchanged
from mrd_diagnosis.simulator.in_the_loop import SimulatorInLoop
from mrd_diagnosis.simulator.parameter_fit import refit_parameters
from mrd_diagnosis.simulator.stand_in import note_on, represent
from mrd_diagnosis.wrong_form.flexible_remainder import explainable_fraction
from mrd_identification.fit_file import StoredFit
from mrd_identification.metrics import nrmse
from mrd_identification.preflight import preflight
from mrd_identification.recording import thinned
from mrd_runs import Run
from mrd_runs.run import checked_runs
from mrd_runs.scales import Scales, scales_of
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import DamperModel, find_model
from mrd_sim.simulators.simulator import Simulator
from mrd_trajectory.settings import GeneratorSettings

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

NOTE_ON_CHANGE = (
    "The gap is the change since the reference runs. What the model lacks in both sets alike is described by a free "
    "correction (a flexible function of motion, current and force); the rest of the error counts as noise."
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


def diagnose(
    runs: Sequence[Run],
    model: str,
    *,
    held_out: Sequence[Run] = (),
    reference: Sequence[Run] = (),
    parameters: StoredFit | None = None,
    simulator: Simulator | None = None,
    free: Mapping[str, tuple[float, float] | None] | None = None,
    laws: str | Mapping[str, str] | None = None,
    effects: Sequence[str] = (),
    bench: GeneratorSettings | None = None,
    seed: int = 0,
    progress: Progress = ignore,
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
    simulator : Simulator, optional
        A simulator of the user's own. ``model`` is then the one of the catalogue that stands for it, by default the one that
        reproduces it best; see `mrd_diagnosis.simulator.stand_in`.
    free : mapping, optional
        Parameters of ``simulator`` that are refitted to the recordings first: lower and upper bound by name, or None for the
        bounds that the simulator states.
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
        For an unknown model, law or effect, parameters out of their bounds, no runs, both reference and held-out runs, or a
        simulator that fails.
    """
    began = time.monotonic()
    runs, held_out = checked_runs(runs), checked_runs(held_out, "held_out", least=0)
    reference = checked_runs(reference, "reference", least=0)
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
    request = _Request(tuple(runs), tuple(held_out), tuple(reference), seed, bench, progress, began)
    if any(finding.severity == "fault" for finding in findings):
        progress("done", 1.0)
        return _faulty(base, request, findings)
    start = _Start(base, theta, RecordingSet.prepare(runs, reference, held_out))
    if simulator:
        start = _around_simulator(start, simulator, free, scales, request, "" if model == BEST_MODEL else model)
    elif model == BEST_MODEL:
        start = _around_best_model(start, request)
    diagnosis = _diagnose_physics(start, candidates, (*findings, *start.limitations), request)
    notes = (*start.notes, *diagnosis.notes, *closed_loop_notes(runs))
    return replace(diagnosis, notes=tuple(filter(None, notes)), stand_in=start.stand_in)


def choose_model(runs: Sequence[Run], seed: int = 0) -> DamperModel:
    """Return the damper model that predicts recordings best without any effect, as a diagnosis with the model "auto" does.

    Raises
    ------
    InputError
        For no runs.
    """
    runs = checked_runs(runs)
    recordings = RecordingSet.prepare(runs, (), ())
    start = find_model(START_OF_CHOICE, scales=scales_of(runs))
    return best_model(start, thinned(recordings.after, MOST_SAMPLES), np.random.default_rng(seed))


@dataclass(frozen=True)
class _Request:
    """What was asked of the diagnosis, and when."""

    runs: tuple[Run, ...]
    held_out: tuple[Run, ...]
    reference: tuple[Run, ...]
    seed: int
    bench: GeneratorSettings | None
    progress: Progress
    began: float

    @property
    def held_out_by(self) -> HeldOutBy:
        return held_out_by(len(self.runs), len(self.held_out), is_change=bool(self.reference))


@dataclass(frozen=True)
class _Start:
    """What a diagnosis starts from.

    Attributes
    ----------
    model : DamperModel
        The model to which effects are added.
    theta_as_given : ndarray (parameters,) or None
        Parameters of the simulator as it is, where they are known.
    recordings : RecordingSet
    limitations : tuple of Finding
        What limits a diagnosis with a user's simulator.
    stand_in : StandIn or None
        What stands for that simulator.
    loop : SimulatorInLoop or None
        The simulator itself, where it answers to any motion.
    notes : tuple of str
    """

    model: DamperModel
    theta_as_given: Array | None
    recordings: RecordingSet
    limitations: tuple[Finding, ...] = ()
    stand_in: StandIn | None = None
    loop: SimulatorInLoop | None = None
    notes: tuple[str, ...] = ()

    @property
    def in_loop(self) -> RefitComparison:
        """What refits a comparison with the simulator in the loop, where there is one."""
        return self.loop.refit_comparison if self.loop else unchanged


@dataclass(frozen=True)
class _Location:
    """Where the gap lies, an oscillation that has most of it, and the share that a flexible function can explain."""

    where: tuple[Region, ...] = ()
    oscillation: Region | None = None
    explainable: float = float("nan")


def _around_simulator(
    start: _Start,
    simulator: Simulator,
    free: Mapping[str, tuple[float, float] | None] | None,
    scales: Scales,
    request: _Request,
    model: str,
) -> _Start:
    """Start from the model that stands for a user's simulator."""
    request.progress("asking the simulator", 0.02)
    if free:
        simulator = refit_parameters(simulator, start.recordings.fitted, free)
    rng = np.random.default_rng(request.seed)
    stand_in, recordings, limitations = represent(simulator, start.recordings, scales, rng, model)
    loop = SimulatorInLoop(simulator, stand_in.model, stand_in.theta) if simulator.answers_anew else None
    notes = (note_on(stand_in, asked_anew=loop is not None), *simulator.notes)
    return _Start(stand_in.model, stand_in.theta, recordings, limitations, stand_in, loop, notes)


def _around_best_model(start: _Start, request: _Request) -> _Start:
    """Start from the model of the catalogue that predicts the recordings best."""
    request.progress("choosing the damper model", 0.02)
    rng = np.random.default_rng(request.seed)
    best = best_model(start.model, thinned(start.recordings.after, MOST_SAMPLES), rng)
    tried = ", ".join(sorted({start.model.id, *OTHER_MODELS}))
    note = f"Of the damper models that were tried ({tried}), {best.id} predicts these recordings best."
    return replace(start, model=best, notes=(note,))


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


def _faulty(model: DamperModel, request: _Request, findings: tuple[Finding, ...]) -> Diagnosis:
    """Return the diagnosis that the recordings are faulty."""
    return Diagnosis(
        model,
        request.runs,
        request.held_out,
        request.seed,
        time.monotonic() - request.began,
        findings,
        "data_fault",
        fault_sentence(findings),
        request.held_out_by,
        request.reference,
    )


def _limited(model: DamperModel, request: _Request, findings: Sequence[Finding], conclusion: Conclusion) -> Diagnosis:
    """Return the diagnosis that limitations of the recordings are the answer: nothing is left that they cannot imitate."""
    faults = tuple(replace(finding, severity="fault") for finding in conclusion.limitations)
    others = tuple(finding for finding in findings if finding not in conclusion.limitations)
    faulty = _faulty(model, request, (*faults, *others))
    return replace(faulty, rejected=conclusion.rejected, notes=(imitation_note(conclusion.rejected),))


def _diagnose_physics(
    start: _Start, candidates: Sequence[str], findings: tuple[Finding, ...], request: _Request
) -> Diagnosis:
    """Diagnose recordings that have no fault: fit, explain, conclude, then describe what was found."""
    rng, progress = np.random.default_rng(request.seed), request.progress
    progress("fitting the model", 0.05)
    recordings = start.recordings.fitted
    fit = fit_base(start.model, start.theta_as_given, thinned(recordings, MOST_SAMPLES), rng)
    untestable = untestable_effects(start.model, start.theta_as_given, candidates, recordings)
    tried = [effect for effect in candidates if effect not in {entry.effect for entry in untestable}]
    progress("trying effects", 0.15)

    def part(stage: str, fraction: float) -> None:
        progress(stage, 0.15 + 0.75 * fraction)

    if start.recordings.is_change:
        fitted = explain_change(fit.weighting, fit.base, tried, rng, lambda fraction: part("trying effects", fraction))
        fitted = replace(fitted, complete=start.in_loop(fitted.complete))
    else:
        fitted = explain_gap(fit.weighting, fit.base, fit.null_errors, tried, rng, part, start.in_loop)
    runs = [*request.reference, *request.runs]
    conclusion = conclude(fitted.explanation, fitted.complete, findings, runs, rng, start.in_loop)
    if conclusion.explanation.verdict == "data_fault":
        progress("done", 1.0)
        return _limited(start.model, request, findings, conclusion)
    diagnosis = _describe(start, request, findings, fit, fitted, conclusion, rng)
    diagnosis = replace(diagnosis, untestable=(*diagnosis.untestable, *untestable))
    return replace(diagnosis, sentence=verdict_sentence(diagnosis))


def _describe(
    start: _Start,
    request: _Request,
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
    models = list_alternative_models(comparison, fitted.other_models, rng) if is_open else ()
    if has_gap:
        progress("designing the next experiment", 0.96)
    advice = _advice(fitted, conclusion, rng, request.bench) if has_gap else None
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
        rejected=reject_others(conclusion, listed, models, findings, [*request.reference, *request.runs]),
        weighed=explanation.weighed,
        alternatives=list_alternatives(comparison, probabilities) if verdict not in ("no_gap", "unknown_effect") else (),
        nearest=_nearest(comparison, listed) if is_open else None,
        candidates=listed,
        untestable=without_evidence,
        alternative_models=models,
        next_experiment=advice,
        residuals=closure.residuals,
        notes=(*fit.notes, *_notes(start, request, complete)),
    )


def _notes(start: _Start, request: _Request, complete: ModelComparison) -> list[str]:
    """Return what limits a diagnosis."""
    return [
        *([start.loop.note(complete)] if start.loop else []),
        *_notes_on_change(len(request.runs), len(request.reference)),
        *limitation_notes(start.recordings.fitted, complete.weighting.noise),
    ]


def _closure(start: _Start, complete: ModelComparison, rng: np.random.Generator) -> Closure:
    """Measure how far the gap closes, with a user's simulator in the loop where there is one."""
    held_out = start.recordings.held_out
    return compute_closure(complete, held_out, rng, start.loop.prepared(complete.best, held_out) if start.loop else held_out)


def _gap(start: _Start, weighting: Weighting, closure: Closure, location: _Location, form_fraction: float) -> Gap:
    return Gap(
        closure.noise_floor,
        closure.before,
        closure.after,
        closure.closed_fraction,
        _error_as_given(start.model, start.theta_as_given, weighting, closure),
        location.explainable,
        closure.extrapolated,
        form_fraction,
    )


def _advice(
    fitted: FittedExplanation, conclusion: Conclusion, rng: np.random.Generator, bench: GeneratorSettings | None
) -> Advice | None:
    """Advise what to record next; what a rule rejected may be there all the same, if the rule leaves that open."""
    rejected = {entry.effect: leaves_open(entry.rule) for entry in conclusion.rejected}
    return advise_next(fitted.explanation, rejected, fitted.singles, rng, bench)


def _corrected(start: _Start, complete: ModelComparison, before: Mapping[str, float]) -> CorrectedSimulator:
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
    errors = [error_of_run(problem, theta, run)[1] for run in counted]
    return nrmse(np.concatenate(errors), np.concatenate([recordings[run].force for run in counted]))
