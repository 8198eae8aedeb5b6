"""gap_report.html: a diagnosis for a person, who has two minutes."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mrd_diagnosis.diagnosis import Candidate, Cause, Diagnosis, Interval, ParameterEstimate, RunResidual
from mrd_diagnosis.effect_names import candidate_title, effect_clause, effect_name, parameters_of_effect
from mrd_diagnosis.quantities import format_error, format_quantity, format_share
from mrd_diagnosis.report import figures
from mrd_diagnosis.report.gap_file import write_gap_file
from mrd_diagnosis.sentences import corrected_label
from mrd_identification.figures import html
from mrd_identification.report import render
from mrd_sim.effects import EFFECTS

_VERDICTS = {
    "data_fault": "fault in the data",
    "no_gap": "no gap",
    "explained": "explained",
    "ambiguous": "cannot be told apart",
    "unknown_effect": "unknown effect",
}
_HELD_OUT_BY = {
    "runs": "on runs that were held out from the start",
    "leave-one-run-out": "on each run in turn, fitted to the others (by its parts where it goes beyond them or alone "
    "shows the effect)",
    "blocks": "on each block of the run in turn, fitted to the others: weaker than judging by other runs",
}
_SEVERITIES = ("fault", "limitation", "remark")


def write_gap_report(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write gap_report.json and gap_report.html, which needs no network, into ``folder``; returns the path of the page."""
    write_gap_file(diagnosis, folder)
    return render("gap_report", folder, "mrd_diagnosis", **content(diagnosis))


def content(diagnosis: Diagnosis) -> dict[str, Any]:
    """What the page's template is filled with."""
    runs = len(diagnosis.runs) + len(diagnosis.held_out)
    physics = diagnosis.verdict != "data_fault"
    faults = [finding for finding in diagnosis.findings if finding.severity == "fault"]
    return {
        "title": f"{diagnosis.model.title} model against {runs} run{'s' if runs != 1 else ''}",
        "sentence": diagnosis.sentence,
        "verdict": diagnosis.verdict,
        "verdict_text": _VERDICTS[diagnosis.verdict],
        "diagnosis": diagnosis,
        "physics": physics,
        "held_out_by": _HELD_OUT_BY.get(diagnosis.held_out_by, diagnosis.held_out_by),
        "faults": faults,
        "findings": sorted(
            (finding for finding in diagnosis.findings if finding.severity != "fault"),
            key=lambda finding: _SEVERITIES.index(finding.severity),
        ),
        **(_physics(diagnosis) if physics else {}),
    }


def _physics(diagnosis: Diagnosis) -> dict[str, Any]:
    second = corrected_label(diagnosis) if diagnosis.corrected.effects else ""
    found = figures.most_telling(diagnosis)
    told = figures.telling(diagnosis.residuals)
    advice, near = diagnosis.next_experiment, diagnosis.nearest
    together = "all together close" if near and len(near.effects) > 1 else "closes"
    return {
        "headline": _headline(diagnosis),
        "how_far": _how_far(diagnosis),
        "steps": html(figures.steps(diagnosis)),
        "regions": html(figures.regions(diagnosis)) if found else "",
        "maps": [(name, html(figure)) for name, figure in figures.excess_maps(diagnosis)],
        "told": told,
        "loops": [html(figure) for figure in figures.loops(told, second)],
        "errors": html(figures.errors(told, second)),
        "candidates": html(figures.candidates(diagnosis)) if diagnosis.candidates else "",
        "tried": len(diagnosis.candidates),
        "most": figures.MOST_CANDIDATES,
        "causes": [
            _cause(c.effect, f"{_chance(diagnosis, c)}, closes {format_share(c.closed_fraction)} of the gap", c.parameters)
            for c in diagnosis.causes
        ],
        "nearest": [
            _cause(effect, f"{together} {format_share(near.closed_fraction)} of the gap", near.parameters)
            for effect in near.effects
            if effect not in [cause.effect for cause in diagnosis.causes]
        ]
        if near and diagnosis.verdict == "unknown_effect"
        else [],
        "forms": [(f.name, format_share(f.closed_fraction), f"{f.nrmse:.4f}") for f in diagnosis.alternative_models],
        "remarks": [
            (candidate_title(candidate), candidate.remark) for candidate in diagnosis.candidates if candidate.remark
        ],
        "alternatives": [
            (effect_name(a.effect), effect_name(a.instead_of), format_share(a.probability), a.why)
            for a in diagnosis.alternatives
        ],
        "untestable": sorted((EFFECTS[entry.effect].title, "–", entry.why) for entry in diagnosis.untestable),
        "advice": advice,
        "advice_between": [effect_name(one) for one in advice.between] if advice else [],
        "error_rate": format_share(advice.error_rate) if advice and np.isfinite(advice.error_rate) else "",
        "runs": [_run(diagnosis, place) for place in range(len(diagnosis.residuals))],
    }


def _headline(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """ParameterEstimate, name and interval of each number of the strip."""
    rows = [("before: refitted, no effect", diagnosis.gap.before)]
    if diagnosis.corrected.effects:
        rows.append((f"after: {corrected_label(diagnosis)}", diagnosis.gap.after))
    rows.append(("noise alone", diagnosis.gap.noise_floor))
    strip = [(format_error(interval.value), name, _ends(interval)) for name, interval in rows if np.isfinite(interval.value)]
    if diagnosis.corrected.effects and np.isfinite(diagnosis.gap.closed_fraction.value):
        ends = format_share(diagnosis.gap.closed_fraction).partition("(")[2].rstrip(")")
        strip.append((format_share(diagnosis.gap.closed_fraction.value), "of the gap closed", ends and f"{ends} %"))
    return strip


def _how_far(diagnosis: Diagnosis) -> list[str]:
    """What the steps from as given to noise mean, in words."""
    said = []
    if diagnosis.gap.as_given is not None and diagnosis.gap.as_given > 0:
        fitted = 1 - (diagnosis.gap.before.value / diagnosis.gap.as_given) ** 2
        said.append(f"Refitting the parameters alone takes away {format_share(max(fitted, 0.0))} of the squared error.")
    if diagnosis.corrected.effects and np.isfinite(diagnosis.gap.closed_fraction.value):
        said.append(f"Of what is left above the noise, {_what(diagnosis)} {format_share(diagnosis.gap.closed_fraction)}.")
    if np.isfinite(diagnosis.gap.explainable_fraction) and diagnosis.verdict != "no_gap":
        said.append(
            f"A flexible function of motion and current closes {format_share(diagnosis.gap.explainable_fraction)}: at least that can be explained."
        )
    if diagnosis.gap.extrapolated is not None:
        said.append(f"On the runs that go beyond the others, {_what(diagnosis)} {format_share(diagnosis.gap.extrapolated)}.")
    elif diagnosis.corrected.effects:
        said.append("No run goes beyond the others: how the answer carries over to other motions was not seen.")
    return said


def _what(diagnosis: Diagnosis) -> str:
    """What the closed share is due to."""
    name = corrected_label(diagnosis).removeprefix("with ")
    return f"{name} close{'s' * (len(diagnosis.causes) <= 1 or diagnosis.verdict != 'explained')}"


def _chance(diagnosis: Diagnosis, cause: Cause) -> str:
    """How sure a cause is; what a model lacks by construction has no rivals, whatever else is missing."""
    if diagnosis.verdict == "unknown_effect":
        return "the model lacks it by construction"
    return f"probability {format_share(cause.probability)}"


def _cause(effect: str, facts: str, parameters: Mapping[str, ParameterEstimate]) -> dict[str, Any]:
    own = parameters_of_effect(effect, parameters)
    declared = {p.name: p for p in EFFECTS[effect].parameters} if effect in EFFECTS else {}
    text = effect_clause(effect, parameters)
    return {
        "id": effect,
        "text": text[:1].upper() + text[1:],
        "stage": EFFECTS[effect].stage if effect in EFFECTS else "",
        "facts": facts,
        "parameters": [
            (
                name,
                format_quantity(value.value, value.unit),
                declared[name].meaning if name in declared else "",
                value.remark,
            )
            for name, value in own.items()
        ],
    }


def _run(diagnosis: Diagnosis, place: int) -> dict[str, Any]:
    trace = diagnosis.residuals[place]
    spread = float(np.std(trace.recording.force)) or np.nan
    return {
        "name": trace.recording.run.name,
        "judged": _judged(trace),
        "numbers": [
            f"{100 * np.sqrt(np.mean(part**2)) / spread:.2f}" for part in (trace.before, trace.after, trace.noise.sigma)
        ],
        "noise": f"{trace.noise.force:.3g} + {trace.noise.motion:.3g}",
        "source": trace.noise.source,
        "offset": f"{trace.offset:+.2f}".replace("-", "\u2212"),
        "gain": f"{100 * trace.gain:+.2f}".replace("-", "\u2212"),
        "extrapolates": trace.extrapolates,
    }


def _judged(trace: RunResidual) -> str:
    if trace.held_out:
        return "held out"
    return "by its parts" if trace.by_folds else "left out"


def _sorted(candidates: Iterable[Candidate]) -> list[Candidate]:
    return sorted(candidates, key=candidate_title)


def _ends(interval: Interval) -> str:
    return (
        f"{format_error(interval.lower)} to {format_error(interval.upper)}"
        if np.isfinite(interval.lower + interval.upper)
        else ""
    )


__all__ = ["content", "write_gap_report"]
