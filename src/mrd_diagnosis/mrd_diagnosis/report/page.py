"""gap_report.html: a diagnosis for a reader who has two minutes and has never seen the project."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base.figures import HALF, NARROW, to_html
from mrd_base.json_file import make_folder
from mrd_diagnosis.diagnosis import (
    Cause,
    CorrectedSimulator,
    Diagnosis,
    Gap,
    Interval,
    ParameterEstimate,
    Region,
    RunResidual,
)
from mrd_diagnosis.localisation.sentence import where_sentence
from mrd_diagnosis.report import figures
from mrd_diagnosis.report.candidate_text import (
    LEAST_SHOWN,
    describe_candidate,
    nothing_removes,
    ordered_candidates,
    with_probabilities,
)
from mrd_diagnosis.report.chain import chain_of
from mrd_diagnosis.report.gap_file import write_gap_file
from mrd_diagnosis.report.sentences import (
    FORM,
    corrected_label,
    found_several,
    is_doubted,
    least_probability,
    next_command,
    next_step,
    notable_model,
    open_share,
    placeholders,
    share_of_form,
    what_was_found,
)
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.effect_names import (
    candidate_title,
    effect_clause,
    effect_name,
    parameters_of_effect,
    place_of_effect,
)
from mrd_diagnosis.wording.quantities import (
    capitalised,
    format_error,
    format_probability,
    format_quantity,
    format_share,
    format_share_ends,
    join_words,
)
from mrd_identification.metrics import nrmse
from mrd_identification.report import render
from mrd_identification.run_panels import closer_look
from mrd_runs.scales import Scales
from mrd_sim.effects import EFFECTS
from mrd_sim.parameter import Parameter

Array = NDArray[np.float64]

MOST_REGIONS = 10
"""Regions that the page shows; more cannot be read in two minutes."""

_VERDICTS = {
    "data_fault": "Faulty recordings",
    "no_gap": "No gap",
    "explained": "Explained",
    "ambiguous": "Ambiguous",
    "partly_explained": "Partly explained",
    "unknown_effect": "Unknown effect",
}
_HELD_OUT_BY = {
    "runs": "on runs that were set aside from the start",
    "leave-one-run-out": "on each run in turn, with the parameters fitted to the other runs. A run that exceeds them, "
    "or is the only one that shows an effect, is divided into segments, and each segment is predicted from the other ones",
    "blocks": "on each segment of a run in turn, with the parameters fitted to all other segments. This is weaker "
    "evidence than a prediction of other runs",
}
_NOISE_SOURCES = {
    "repeats": "repeated runs",
    "periods": "repeated periods",
    "residual": "the high frequencies of the residual",
}
_SEVERITIES = ("fault", "limitation", "remark")
GLOSSARY = {
    "gap": "The part of the model's error that noise does not explain, after all parameters of the model were refitted.",
    "NRMSE": "Normalised root-mean-square error: the rms of measured minus modelled force, divided by the standard "
    "deviation of the measured force. 0 % is a perfect model, 100 % is as bad as a constant force.",
    "noise": "The error that a perfect model would still have: noise of the force sensor, and errors of the measured motion "
    "and current.",
    "excess error": "The squared error beyond what noise explains.",
    "freer form": "A flexible function of speed, recent travel and current, which is added to the force of the damper model "
    "and changes its sign with the direction of motion. It takes the place of what the form of the model lacks.",
    "held out": "Not used to fit the parameters. An error on held-out data shows how well the model predicts. Whole runs "
    "are held out in turn, except those that the table of runs marks “by segments”.",
    "share of the gap removed": "1 − (after² − noise²) / (before² − noise²), where before and after are NRMSE without and "
    "with the effect; limited to ±100 %. It is negative where an effect predicts held-out data worse than the model without "
    "it: its parameters then fit something else. At the top of the page whole runs are held out. “By segments” means that "
    "segments of runs are held out, as in the comparison of effects; the two differ a little.",
    "probability": "How likely an effect is the cause, compared with the other effects that were fitted in its place. It "
    "compares the effects that were tried; an effect that is not in the catalogue is not among them. Where the gap is "
    "partly explained, the effects are compared around several damper models, and the probability is the share of cases in "
    "which evidence like that was right for dampers whose effects were known.",
    "95 % interval": "The range, here in brackets or after ±, that contains the true value in 95 of 100 cases if "
    "the formula of the effect is exact. With other formulas, it contains the true value less often (docs/trials.md).",
    "p-value": "The probability that noise alone improves the fit to the same data so much. An effect can improve the fit "
    "and still predict held-out data worse.",
}
"""Terms of the page, in the order in which they are listed."""


def write_gap_report(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write a diagnosis into ``folder``, which is made where it does not exist, and return the path of the page.

    The files are gap_report.json, gap_report.html, which needs no network, and next_experiment.yaml where an experiment is
    advised. A next_experiment.yaml of an earlier diagnosis is removed.
    """
    make_folder(str(folder))
    write_gap_file(diagnosis, folder)
    experiment = Path(folder) / "next_experiment.yaml"
    experiment.unlink(missing_ok=True)
    if diagnosis.next_experiment is not None and diagnosis.next_experiment.experiment:
        experiment.write_text(diagnosis.next_experiment.experiment, encoding="utf-8")
    runs = (*diagnosis.runs, *diagnosis.held_out, *diagnosis.reference)
    return render("gap_report", folder, "mrd_diagnosis", runs=runs, **page_content(diagnosis, str(folder)))


def page_content(diagnosis: Diagnosis, folder: str = "DIR") -> dict[str, Any]:
    """Return what the template of the page is filled with; ``folder`` is the folder of the report."""
    count = len(diagnosis.runs) + len(diagnosis.held_out)
    against = f"{count} run{'s' if count != 1 else ''}{_origin(diagnosis)}"
    command = next_command(diagnosis, folder)
    earlier = f", compared with {len(diagnosis.reference)} from before a change" if diagnosis.reference else ""
    content = {
        "title": f"{_simulator(diagnosis)} against {against}{earlier}",
        "verdict": diagnosis.verdict,
        "verdict_text": _VERDICTS[diagnosis.verdict],
        "verdict_sentence": diagnosis.sentence,
        "next_step": next_step(diagnosis),
        "command": command,
        "placeholders": placeholders(command),
        "diagnosis": diagnosis,
        "glossary": GLOSSARY,
        "faults": [finding for finding in diagnosis.findings if finding.severity == "fault"],
        "findings": sorted(
            (finding for finding in diagnosis.findings if finding.severity != "fault"),
            key=lambda finding: _SEVERITIES.index(finding.severity),
        ),
        "comparison": None,
    }
    if diagnosis.gap is not None and diagnosis.corrected is not None:
        content["comparison"] = _comparison(diagnosis, diagnosis.gap, diagnosis.corrected)
    return content


def _simulator(diagnosis: Diagnosis) -> str:
    """Return what is compared with the recordings."""
    return f"Simulator {diagnosis.stand_in.name}" if diagnosis.stand_in else f"{diagnosis.model.title} model"


def _origin(diagnosis: Diagnosis) -> str:
    """Return the folder of the runs and their date, as far as they are known."""
    runs = (*diagnosis.runs, *diagnosis.held_out)
    folders = {Path(str(run.info["source"])).parent.name for run in runs if run.info.get("source")}
    dates = {str(run.info["started"])[:10] for run in runs if run.info.get("started")}
    folder = f" of {folders.pop()}" if len(folders) == 1 else ""
    return f"{folder}, recorded on {min(dates)}" if dates else folder


def _comparison(diagnosis: Diagnosis, gap: Gap, corrected: CorrectedSimulator) -> dict[str, Any]:
    """Return what the page shows of the comparison of model and recordings; faulty recordings have none."""
    label = corrected_label(diagnosis)
    regions = significant_regions(diagnosis)
    nearest, ordered = _nearest_cards(diagnosis), ordered_candidates(diagnosis)
    shown = figures.most_informative_run(diagnosis.residuals)
    return {
        "headline": _headline(diagnosis, gap),
        "chain": chain_of([cause.effect for cause in diagnosis.causes], _simulator(diagnosis)) if diagnosis.causes else (),
        "errors": to_html(figures.error_chart(diagnosis, gap), HALF),
        "error_notes": _error_notes(diagnosis, gap),
        "held_out_by": _HELD_OUT_BY[diagnosis.held_out_by],
        "candidates": "" if nothing_removes(diagnosis) else to_html(figures.candidate_chart(diagnosis), HALF),
        "candidate_rows": [
            (candidate_title(candidate), " + ".join(candidate.effects), *describe_candidate(diagnosis, candidate))
            for candidate in ordered
        ],
        "least_shown": f"{100 * LEAST_SHOWN:g} %",
        "with_probabilities": with_probabilities(diagnosis),
        "most_candidates": figures.MOST_CANDIDATES,
        "negative": any(c.closed_fraction.value < -LEAST_SHOWN for c in ordered[: figures.MOST_CANDIDATES]),
        "causes": [
            _effect_card(
                cause.effect,
                _cause_facts(diagnosis, cause, gap),
                cause.parameters,
                diagnosis.model.scales,
                is_doubted(diagnosis, cause),
            )
            for cause in diagnosis.causes
        ],
        "parameter_columns": [title for title, _ in _parameter_columns(diagnosis, corrected)],
        "parameter_rows": [
            (
                parameter.name,
                *(format_quantity(values.get(parameter.name, np.nan), parameter.unit) for _, values in columns),
                parameter.meaning,
            )
            for columns in [_parameter_columns(diagnosis, corrected)]
            for parameter in diagnosis.model.parameters
        ],
        "seen": [
            (
                capitalised(effect_clause(entry.effect, entry.parameters)),
                entry.effect,
                capitalised(entry.why),
                format_share(entry.closed_fraction),
            )
            for entry in diagnosis.rejected
            if entry.chosen
        ],
        "remains": _remains(diagnosis, gap) if diagnosis.verdict == "partly_explained" else [],
        "nearest": nearest,
        "alternative_models": [
            (model.name, format_share(model.closed_fraction), format_error(model.nrmse))
            for model in diagnosis.alternative_models
        ],
        "alternatives": [
            (
                capitalised(
                    effect_clause(other.effect, other.parameters) if other.parameters else effect_name(other.effect)
                ),
                other.effect,
                effect_name(other.instead_of),
                format_probability(other.probability),
            )
            for other in diagnosis.alternatives
        ],
        "advice": diagnosis.next_experiment,
        "regions": to_html(figures.region_chart(regions)) if regions else "",
        "maps": [(capitalised(title), to_html(figure, NARROW)) for title, figure in figures.map_figures(diagnosis)],
        "shown_run": shown.recording.run.name,
        "loops": [to_html(figure, HALF) for figure in figures.hysteresis_loops(shown, label)],
        "over_time": to_html(figures.error_over_time(shown, label, diagnosis.oscillation)),
        "closer": closer_look(shown.recording.run, _modelled(shown, label)),
        "unnoticed": _unnoticed(diagnosis, {card["id"] for card in nearest}),
        "untestable": sorted((EFFECTS[entry.effect].title, entry.effect, entry.why) for entry in diagnosis.untestable),
        "runs": [_run_row(residual) for residual in diagnosis.residuals],
        "noise_sources": join_words(list(dict.fromkeys(_NOISE_SOURCES[r.noise.source] for r in diagnosis.residuals))),
    }


def _modelled(shown: RunResidual, label: str) -> dict[str, Array]:
    """Return the modelled force (n,) in N of a run by name: of the model alone and, where there is one, corrected."""
    run, recording = shown.recording.run, shown.recording
    counted = run.time[recording.counted]

    def force(residual: Array) -> Array:
        modelled = np.full(len(run), np.nan)
        modelled[recording.counted] = recording.force - residual
        within = (run.time >= counted[0]) & (run.time <= counted[-1])
        modelled[within] = np.interp(run.time[within], counted, recording.force - residual)
        return modelled

    forces = {"model alone": force(shown.before)}
    return forces | {label: force(shown.after)} if label else forces


def _parameter_columns(diagnosis: Diagnosis, corrected: CorrectedSimulator) -> list[tuple[str, Mapping[str, float]]]:
    """Return title and values of each set of the model's parameters that is known: as given, refitted, with the causes."""
    columns = [
        ("as given", corrected.as_given),
        ("refitted", corrected.without_effects),
        (corrected_label(diagnosis), corrected.parameters if corrected.effects else {}),
    ]
    return [(title, values) for title, values in columns if title and values]


def significant_regions(diagnosis: Diagnosis) -> list[Region]:
    """Return the most significant regions of the excess error, as many as the page shows.

    An oscillation takes the place of the bands of frequencies, which would divide it.
    """
    significant = [region for region in diagnosis.where if region.significant]
    if diagnosis.oscillation is not None:
        significant = [diagnosis.oscillation, *(region for region in significant if region.axis != "frequency")]
    return significant[:MOST_REGIONS]


def _headline(diagnosis: Diagnosis, gap: Gap) -> list[tuple[str, str, str]]:
    """Return value, name and interval of each number at the top of the page: how sure, how much is removed, the errors."""
    label, numbers = corrected_label(diagnosis), []
    if diagnosis.causes:
        which = "least certain " if len(diagnosis.causes) > 1 else "most likely " if diagnosis.alternatives else ""
        probability = format_probability(least_probability(diagnosis))
        numbers.append((probability, f"probability of the {which}cause among the effects tried", ""))
    if label and np.isfinite(gap.closed_fraction.value):
        numbers.append(_headline_share(gap.closed_fraction, f"of the gap removed {label}"))
        if gap.extrapolated is not None:
            numbers.append(_headline_share(gap.extrapolated, "of the gap removed on runs that go beyond the others"))
    if diagnosis.verdict == "partly_explained" and np.isfinite(gap.form_fraction):
        numbers.append((format_share(share_of_form(gap)), "of the gap lies in the form of the damper model", ""))
    if model := notable_model(diagnosis):
        numbers.append((format_share(model.closed_fraction.value), f"of the gap removed by {model.name}", ""))
    errors = [(f"error of {_model_without_effects(diagnosis)}", gap.before)]
    if label:
        errors.append((f"error {label}", gap.after))
    errors.append(("error from noise alone", gap.noise_floor))
    numbers += [(format_error(error.value), name, _ends(error)) for name, error in errors if np.isfinite(error.value)]
    return numbers


def _model_without_effects(diagnosis: Diagnosis) -> str:
    if diagnosis.reference:
        return "the model and a function common to the runs before and after"
    return "the model alone, parameters refitted"


def _headline_share(share: Interval, name: str) -> tuple[str, str, str]:
    ends = format_share_ends(share)
    return format_share(share.value), name, ends and f"{ends} %"


def _error_notes(diagnosis: Diagnosis, gap: Gap) -> list[str]:
    """Return what the errors, from the parameters as given down to the noise, mean."""
    notes, found = [], what_was_found(diagnosis)
    if gap.as_given is not None and gap.as_given > 0:
        removed = max(1 - (gap.before.value / gap.as_given) ** 2, 0.0)
        notes.append(f"Refitting the parameters alone removes {format_share(removed)} of the squared error.")
    removes = f"{found} {'remove' if found_several(diagnosis) else 'removes'}"
    if found and np.isfinite(gap.closed_fraction.value):
        notes.append(f"{capitalised(removes)} {format_share(gap.closed_fraction)} of the gap.")
    if diagnosis.verdict not in ("no_gap", "partly_explained"):
        notes.append(_check_note(diagnosis, gap))
    if gap.extrapolated is not None:
        notes.append(
            f"On the runs that go beyond the others in stroke, speed or current, {removes} "
            f"{format_share(gap.extrapolated)} of the gap. There the parameters were fitted to the other runs only."
        )
    elif found and len(diagnosis.residuals) > 1 and not any(residual.extrapolates for residual in diagnosis.residuals):
        notes.append("No run exceeds the others in stroke, speed or current; beyond these the result is untested.")
    return notes


def _check_note(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return the share of the gap, or of what remains of it, that is not random."""
    removed = gap.explainable_fraction >= figures.LEAST_SHARE
    share = format_share(gap.explainable_fraction) if removed else "nothing"
    partly = diagnosis.verdict == "partly_explained"
    error, of_what = ("remaining error", "it") if partly else ("error", "the gap")
    meaning = (
        "So at least this share is no noise: it repeats with motion and current. An effect with the right formula can "
        "remove more."
        if removed
        else "This check finds nothing that repeats with motion and current; it is a lower bound."
    )
    return (
        "As a check, a free correction (a flexible function of motion, current and their past) was fitted to the "
        f"{error} alone. On data that were not fitted, it removes {share} of {of_what}. {meaning}"
    )


def _remains(diagnosis: Diagnosis, gap: Gap) -> list[str]:
    """Return what is known about the error that remains beside the causes of a partly explained gap."""
    remaining, form = open_share(gap), share_of_form(gap)
    lines = [
        f"{capitalised(corrected_label(diagnosis))}, {format_share(remaining)} of the gap stays open.",
        where_sentence(diagnosis, "it"),
    ]
    if np.isnan(form):  # not asked, as of a change
        form = remaining
    elif form > THRESHOLDS.notable_share:
        lines.append(
            f"{format_share(form)} of the gap lies in the form of the damper model: a freer function of {FORM} would remove "
            "it."
        )
    else:
        lines.append(
            f"A freer form of the damper model, as a function of {FORM}, would remove almost nothing of what remains."
        )
    if remaining - form > THRESHOLDS.notable_share:
        lines.append(f"For {format_share(remaining - form)} of the gap, neither a cause nor the form accounts.")
    if diagnosis.alternative_models:
        best = diagnosis.alternative_models[0]
        if best.closed_fraction.value > 0:
            lines.append(
                f"Of the other damper models, {best.name} comes nearest to the recordings: without an effect, it removes "
                f"{format_share(best.closed_fraction)} of the gap."
            )
        else:
            lines.append("None of the other damper models comes nearer to the recordings than this one without an effect.")
    lines.append(_check_note(diagnosis, gap))
    return [line for line in lines if line]


def _cause_facts(diagnosis: Diagnosis, cause: Cause, gap: Gap) -> str:
    """Return how certain a cause is, and how much it removes."""
    certainty = f"probability {format_probability(cause.probability)}"
    if cause.level == "class":
        probabilities = [
            f"{effect_name(other.effect)} ({format_probability(other.probability)})" for other in cause.members[1:]
        ]
        certainty += f" · these runs do not tell it from {join_words(probabilities, 'or')}"
    # The only cause removes what is said at the top of the page; the part of one of several causes is known by segments.
    single = diagnosis.corrected is not None and diagnosis.corrected.effects == (cause.effect,)
    share = format_share(gap.closed_fraction) if single else f"{format_share(cause.closed_fraction)} (by segments)"
    return f"{certainty} · removes {share} of the gap"


def _nearest_cards(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the effects that come nearest to an unknown effect, without the named causes."""
    nearest = diagnosis.nearest
    if nearest is None or diagnosis.verdict == "partly_explained":
        return []
    if nearest.closed_fraction.value <= THRESHOLDS.notable_share:
        return []
    causes = {cause.effect for cause in diagnosis.causes}
    removes = "all effects together remove" if len(nearest.effects) > 1 else "removes"
    facts = f"{removes} {format_share(nearest.closed_fraction)} of the gap"
    return [
        _effect_card(effect, facts, nearest.parameters, diagnosis.model.scales)
        for effect in nearest.effects
        if effect not in causes
    ]


def _effect_card(
    effect: str, facts: str, parameters: Mapping[str, ParameterEstimate], scales: Scales, doubtful: bool = False
) -> dict[str, Any]:
    catalogued = EFFECTS[effect].scaled(scales) if effect in EFFECTS else None
    clause = effect_clause(effect, parameters)
    declared = {parameter.name: parameter for parameter in catalogued.parameters} if catalogued else {}
    return {
        "id": effect,
        "clause": f"If this is the cause: {clause}" if doubtful else capitalised(clause),
        "place": place_of_effect(catalogued.id) if catalogued else "",
        "equation": catalogued.equation if catalogued else "",
        "facts": facts,
        "parameters": [
            (name, *_fitted_value(estimate, declared.get(name)))
            for name, estimate in parameters_of_effect(effect, parameters).items()
        ],
    }


def _fitted_value(estimate: ParameterEstimate, declared: Parameter | None) -> tuple[str, str, str]:
    """Return the value of a parameter, its meaning, and a remark; a value that the runs do not determine has no interval."""
    value, meaning = estimate.value, declared.meaning if declared else ""
    if declared is None or not np.allclose(
        (value.lower, value.upper), (declared.lower, declared.upper), rtol=1e-6, atol=0.0
    ):
        return format_quantity(value, estimate.unit), meaning, estimate.remark
    fitted, lower, upper, default = (
        format_quantity(number, declared.unit) for number in (value.value, declared.lower, declared.upper, declared.default)
    )
    remark = f"any plausible value ({lower} to {upper}) fits about as well; the default is {default}"
    return fitted, meaning, ": ".join(filter(None, (estimate.remark, remark)))


def _unnoticed(diagnosis: Diagnosis, nearest: Collection[str]) -> list[tuple[str, str, str]]:
    """Return title, id and the largest size that may have gone unnoticed of each effect that was tried and has no card."""
    shown = {*nearest, *(cause.effect for cause in diagnosis.causes), *(other.effect for other in diagnosis.alternatives)}
    unnamed = [c for c in diagnosis.candidates if len(c.effects) == 1 and shown.isdisjoint(c.effects)]
    return sorted(
        (candidate_title(candidate), candidate.effects[0], capitalised(candidate.smallest_detectable) or "not computed")
        for candidate in unnamed
    )


def _run_row(residual: RunResidual) -> dict[str, Any]:
    return {
        "name": residual.recording.run.name,
        "held_out": "from the start" if residual.held_out else "by segments" if residual.by_folds else "whole run",
        "errors": [
            format_error(nrmse(errors, residual.recording.force))
            for errors in (residual.before, residual.after, residual.noise.sigma)
        ],
        "force_noise": format_quantity(residual.noise.force, "N"),
        "motion_noise": format_quantity(residual.noise.motion, "N"),
        "offset": f"{'+' if residual.offset > 0.0 else ''}{format_quantity(residual.offset, 'N')}",
        "gain": f"{100 * residual.gain:+.2f}".replace("-", "\u2212"),
        "extrapolates": residual.extrapolates,
    }


def _ends(interval: Interval) -> str:
    if not np.isfinite(interval.lower + interval.upper):
        return ""
    return f"{format_error(interval.lower)} to {format_error(interval.upper)}"
