"""The verdict in one or two sentences: what was found, how sure it is, and how much of the gap it removes."""

import math
import shlex
from collections.abc import Sequence

import yaml

from mrd_diagnosis.diagnosis import Advice, Alternative, AlternativeModel, Candidate, Cause, Diagnosis, Finding, Gap, Region
from mrd_diagnosis.effect_names import effect_clause, effect_names
from mrd_diagnosis.quantities import capitalised, format_error, format_share, join_words
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_sim.models import MODELS


def fault_sentence(findings: Sequence[Finding]) -> str:
    """Return the verdict on faulty recordings: the first fault, and how many more there are."""
    faults = [finding for finding in findings if finding.severity == "fault"]
    place = ", ".join(part for part in (faults[0].run and f"run {faults[0].run}", faults[0].channel) if part)
    more = f" ({len(faults) - 1} more {'problem' if len(faults) == 2 else 'problems'} below.)" if len(faults) > 1 else ""
    return f"Data problem{f' ({place})' if place else ''}: {faults[0].text.rstrip('.')}.{more}"


def no_gap_sentence(gap: Gap) -> str:
    """Return the verdict that noise explains the error."""
    before, noise = format_error(gap.before.value), format_error(gap.noise_floor.value)
    if gap.as_given is not None and gap.as_given > THRESHOLDS.notable_refit * gap.before.value:
        return (
            f"The parameters caused the gap. With refitted parameters, the error falls from {format_error(gap.as_given)} to "
            f"{before} of the force's standard deviation; noise explains that ({noise})."
        )
    return f"No gap beyond the noise. The model's error is {before} of the force's standard deviation, the noise is {noise}."


def explained_sentence(causes: Sequence[Cause], gap: Gap) -> str:
    """Return the verdict that names the causes."""
    return f"{_clauses(causes)} ({_certainty(causes)}). {_removal(causes, gap)}."


def partly_explained_sentence(causes: Sequence[Cause], gap: Gap) -> str:
    """Return the verdict that names causes although they do not explain the whole gap."""
    return f"{_clauses(causes)} ({_certainty(causes)}). {_removal(causes, gap)}; the rest is not explained."


def ambiguous_sentence(causes: Sequence[Cause], alternatives: Sequence[Alternative], gap: Gap, advice: Advice | None) -> str:
    """Return the verdict that several explanations fit nearly as well."""
    doubted = {alternative.instead_of for alternative in alternatives}
    certain = [cause for cause in causes if cause.effect not in doubted]
    uncertain = [cause.effect for cause in causes if cause.effect in doubted]
    options = list(dict.fromkeys([*uncertain, *(alternative.effect for alternative in alternatives)]))
    if not options:
        return f"Probably {_clauses(causes, capital=False)} ({_certainty(causes)}). {_removal(causes, gap)}."
    cannot = f"these runs cannot tell {effect_names(options)} apart."
    text = f"{_clauses(certain)}. Beyond that, {cannot}" if certain else capitalised(cannot)
    if math.isfinite(gap.closed_fraction.value):
        text += f" The most likely explanation removes {format_share(gap.closed_fraction.value)} of the explainable gap."
    if advice is not None:
        experiment = experiment_name(advice.experiment)
        # Without an experiment, the first sentence of the advice repeats that nothing separates them.
        remedy = advice.text.partition(". ")[2] or advice.text
        text += f" Record the experiment “{experiment}” to separate them." if experiment else f" {remedy}"
    return text


def unknown_effect_sentence(
    causes: Sequence[Cause],
    where: Sequence[Region],
    nearest: Candidate | None,
    alternative_models: Sequence[AlternativeModel],
) -> str:
    """Return the verdict that no catalogued effect explains the gap, with the best clues."""
    sentences = ["No catalogued effect explains the gap."]
    if causes:
        closed = format_share(sum(cause.closed_fraction.value for cause in causes))
        sentences = [f"{_clauses(causes)}; this removes {closed} of the gap.", "No catalogued effect explains the rest."]
    significant = [region for region in where if region.q_value < THRESHOLDS.q_value]
    places = [region for region in significant if region.axis != "run"] or significant
    if places:
        share = places[0].share.value
        part = "Most of the error" if share > 0.5 else "The largest part of the error"
        sentences.append(f"{part} ({format_share(share)}) occurs {_at(places[0].label)}.")
    named = {cause.effect for cause in causes}
    if model := notable_model(nearest, alternative_models):
        sentences.append(f"The model {model.name} removes {format_share(model.closed_fraction.value)}: try it next.")
    elif (
        nearest is not None
        and not named.issuperset(nearest.effects)
        and nearest.closed_fraction.value > THRESHOLDS.notable_alternative_model
    ):
        names = effect_names([effect for effect in nearest.effects if effect not in named])
        verb = "comes" if len(nearest.effects) - len(named.intersection(nearest.effects)) == 1 else "come"
        removes = "in total removes" if named else "would remove"
        sentences.append(
            f"{capitalised(names)} {verb} nearest: this {removes} {format_share(nearest.closed_fraction.value)} of the gap."
        )
    return " ".join(sentences)


def notable_model(nearest: Candidate | None, alternative_models: Sequence[AlternativeModel]) -> AlternativeModel | None:
    """Return the best other damper model if it closes notably more of the gap than the nearest effect."""
    reached = nearest.closed_fraction.value if nearest is not None else 0.0
    needed = reached + THRESHOLDS.notable_alternative_model * (1.0 - reached)
    if alternative_models and alternative_models[0].closed_fraction.value > needed:
        return alternative_models[0]
    return None


def next_command(diagnosis: Diagnosis, folder: str = "DIR") -> str:
    """Return the commands that follow from a verdict, one a line; empty where none do. ``folder`` is that of the report."""
    folder = shlex.quote(folder)
    model, advice = notable_model(diagnosis.nearest, diagnosis.alternative_models), diagnosis.next_experiment
    if diagnosis.verdict == "explained":
        return f"ros2 run mrd_diagnosis apply {folder}/gap_report.json --plant PLANT.yaml --output CORRECTED.yaml"
    if diagnosis.verdict == "ambiguous" and advice is not None and advice.experiment:
        return (
            f"ros2 run mrd_bench_driver bench {folder}/next_experiment.yaml\n"
            f"ros2 run mrd_diagnosis diagnose RUN... NEW_RUN --model {diagnosis.model.id} --output DIR"
        )
    if diagnosis.verdict == "unknown_effect" and model is not None:
        model_id, _, change = model.name.partition(" with ")
        arguments = {"": f"--model {model_id}", "quadratic current laws": f"--model {model_id} --law quadratic"}.get(change)
        if model_id in MODELS and arguments:
            return f"ros2 run mrd_diagnosis diagnose RUN... {arguments} --output DIR"
    if diagnosis.verdict == "unknown_effect":
        return "ros2 run mrd_identification compare RUN... --output DIR"
    return ""


def corrected_label(diagnosis: Diagnosis) -> str:
    """Return what the corrected simulator contains, such as "with the cause"; empty where it contains no effect."""
    if diagnosis.corrected is None or not diagnosis.corrected.effects:
        return ""
    if diagnosis.verdict == "explained":
        return "with the cause" if len(diagnosis.causes) == 1 else "with the causes"
    if diagnosis.verdict == "ambiguous":
        return "with the most likely cause" if len(diagnosis.causes) == 1 else "with the most likely causes"
    return "with the nearest effect" if len(diagnosis.corrected.effects) == 1 else "with the nearest effects"


def experiment_name(text: str) -> str:
    """Return the name that an experiment.yaml gives itself; empty without an experiment."""
    content = yaml.safe_load(text)
    return str(content.get("name") or "next_experiment") if isinstance(content, dict) else ""


def _clauses(causes: Sequence[Cause], capital: bool = True) -> str:
    text = join_words([effect_clause(cause.effect, cause.parameters) for cause in causes])
    return capitalised(text) if capital else text


def _certainty(causes: Sequence[Cause]) -> str:
    """Return the probability of the least certain cause in words."""
    least = min((cause.probability for cause in causes), default=math.nan)
    bound = "above " if least > 0.99 else "at least " if len(causes) > 1 else ""
    return f"probability {bound}{'99 %' if least > 0.99 else format_share(least)}"


def _removal(causes: Sequence[Cause], gap: Gap) -> str:
    adding = {1: "this effect", 2: "both effects"}.get(len(causes), "these effects")
    return f"Adding {adding} removes {format_share(gap.closed_fraction.value)} of the explainable gap"


def _at(label: str) -> str:
    """Return the label of a region after "occurs"."""
    first = label.partition(" ")[0]
    if first in ("at", "in", "while", "within", "above", "below", "after", "between", "more", "up"):
        return label
    return f"{'in' if first in ('run', 'the') else 'at'} {label}"
