"""Diagnosis of the gap between a simulator and recordings: this module calls the steps in their order."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_diagnosis.decision.conclusion import Conclusion, conclude, worse_by_runs
from mrd_diagnosis.description import describe
from mrd_diagnosis.diagnosis import Diagnosis, Finding
from mrd_diagnosis.explain_change import explain_change
from mrd_diagnosis.explain_gap import explain_gap
from mrd_diagnosis.fitting.base_fit import fit_base
from mrd_diagnosis.recordings.closed_loop import closed_loop_notes
from mrd_diagnosis.recordings.imitating_limitations import clock_finding
from mrd_diagnosis.recordings.limitations import untestable_effects
from mrd_diagnosis.recordings.recording_set import RecordingSet
from mrd_diagnosis.report.sentences import fault_sentence, imitation_note, verdict_sentence
from mrd_diagnosis.search.alternative_models import best_model
from mrd_diagnosis.start import (
    MOST_SAMPLES,
    START_OF_CHOICE,
    Progress,
    Request,
    Start,
    around_best_model,
    around_simulator,
    parameters_as_given,
)
from mrd_identification.fit_file import StoredFit
from mrd_identification.preflight import preflight
from mrd_identification.recording import thinned
from mrd_runs import Run
from mrd_runs.run import checked_runs
from mrd_runs.scales import scales_of
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import DamperModel, find_model
from mrd_sim.simulators.simulator import Simulator
from mrd_trajectory.settings import GeneratorSettings

BEST_MODEL = "auto"
"""In place of a model's id: the model of the catalogue that predicts the recordings best."""


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
        The same seed and input give the same result but for rounding. Where a simulator of the user's own answers in the
        loop, rounding can grow to a small part of the interval of a size.
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
    if parameters and "mid_stroke" in parameters.values:
        scales = scales.counted_from(parameters.values["mid_stroke"])
    base = find_model(START_OF_CHOICE if model == BEST_MODEL else model, laws, scales=scales)
    theta = parameters_as_given(base, parameters)
    progress("checking the recordings", 0.0)
    expected = None if model == BEST_MODEL else base
    findings = preflight([*runs, *held_out], expected)
    if reference:
        findings = (*preflight(reference, expected), *findings)
    request = Request(tuple(runs), tuple(held_out), tuple(reference), seed, bench, progress, began)
    if any(finding.severity == "fault" for finding in findings):
        progress("done", 1.0)
        return _faulty(base, request, findings)
    start = Start(base, theta, RecordingSet.prepare(runs, reference, held_out))
    if simulator:
        start = around_simulator(start, simulator, free, scales, request, "" if model == BEST_MODEL else model)
    elif model == BEST_MODEL:
        start = around_best_model(start, request)
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


def _faulty(model: DamperModel, request: Request, findings: tuple[Finding, ...]) -> Diagnosis:
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


def _limited(model: DamperModel, request: Request, findings: Sequence[Finding], conclusion: Conclusion) -> Diagnosis:
    """Return the diagnosis that limitations of the recordings are the answer: nothing is left that they cannot imitate."""
    faults = tuple(replace(finding, severity="fault") for finding in conclusion.limitations)
    others = tuple(finding for finding in findings if finding not in conclusion.limitations)
    faulty = _faulty(model, request, (*faults, *others))
    return replace(faulty, rejected=conclusion.rejected, notes=(imitation_note(conclusion.rejected),))


def _diagnose_physics(start: Start, candidates: Sequence[str], findings: tuple[Finding, ...], request: Request) -> Diagnosis:
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
    of_clocks = clock_finding(request.runs, request.reference)
    conclusion = conclude(fitted.explanation, fitted.complete, findings, of_clocks, rng, start.in_loop)
    if conclusion.explanation.verdict != "data_fault":
        diagnosis = describe(start, request, findings, fit, fitted, conclusion, rng)
        if diagnosis.causes and diagnosis.gap is not None and diagnosis.gap.is_worse:
            conclusion = worse_by_runs(conclusion)
            diagnosis = describe(start, request, findings, fit, fitted, conclusion, rng)
    if conclusion.explanation.verdict == "data_fault":
        progress("done", 1.0)
        return _limited(start.model, request, findings, conclusion)
    diagnosis = replace(diagnosis, untestable=(*diagnosis.untestable, *untestable))
    return replace(diagnosis, sentence=verdict_sentence(diagnosis))
