"""gap_report.json: a diagnosis as a file."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base.json_file import finite_or_none, read_json, write_json
from mrd_diagnosis.diagnosis import (
    Advice,
    Alternative,
    Candidate,
    Cause,
    CorrectedSimulator,
    Diagnosis,
    Gap,
    Interval,
    ParameterEstimate,
    Region,
    Rejected,
    RunResidual,
    StandIn,
)
from mrd_diagnosis.evidence.cause_class import class_name
from mrd_diagnosis.wording.effect_names import parameters_of_effect
from mrd_identification.metrics import nrmse
from mrd_identification.versions import versions
from mrd_runs.summary import run_json
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

SCHEMA = "mrd-gap/5"


def to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the content of gap_report.json; floats that are not finite become null."""
    model, advice = diagnosis.model, diagnosis.next_experiment
    residuals = {residual.recording.run.name: _run(residual) for residual in diagnosis.residuals}
    return {
        "schema": SCHEMA,
        "sentence": diagnosis.sentence,
        "verdict": diagnosis.verdict,
        "model": model.id,
        "laws": model.laws,
        "simulator": None if diagnosis.stand_in is None else _stand_in(diagnosis.stand_in),
        "runs": {
            "fit": [residuals.get(run.name, run_json(run)) for run in diagnosis.runs],
            "held_out": [residuals.get(run.name, run_json(run)) for run in diagnosis.held_out],
            "held_out_by": diagnosis.held_out_by,
            "reference": [run_json(run) for run in diagnosis.reference],
        },
        "seed": diagnosis.seed,
        "elapsed_s": round(diagnosis.elapsed, 3),
        "gap": None if diagnosis.gap is None else _gap(diagnosis.gap),
        "where": [_region(region) for region in diagnosis.where],
        "oscillation": None if diagnosis.oscillation is None else _region(diagnosis.oscillation),
        "causes": [_cause(cause) for cause in diagnosis.causes],
        "rejected": [_rejected(entry) for entry in diagnosis.rejected],
        "weighed": [
            {
                "effect": entry.effect,
                "members": list(entry.members),
                "probability": finite_or_none(entry.probability),
                "evidence": {name: finite_or_none(value) for name, value in entry.evidence.items()},
                "table": {name or "none": finite_or_none(value) for name, value in entry.table.items()},
            }
            for entry in diagnosis.weighed
        ],
        "alternatives": [_alternative(alternative) for alternative in diagnosis.alternatives],
        "nearest": None if diagnosis.nearest is None else _candidate(diagnosis.nearest),
        "candidates": [_candidate(candidate) for candidate in diagnosis.candidates],
        "untestable": [asdict(entry) for entry in diagnosis.untestable],
        "alternative_models": [
            {"model": other.name, "nrmse": finite_or_none(other.nrmse), **_closed_fraction(other.closed_fraction)}
            for other in diagnosis.alternative_models
        ],
        "next_experiment": None if advice is None else _advice(advice),
        "corrected": None if diagnosis.corrected is None else _corrected(diagnosis.corrected),
        "findings": [asdict(finding) for finding in diagnosis.findings],
        "notes": list(diagnosis.notes),
        "versions": versions(),
    }


def write_gap_file(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write gap_report.json into ``folder`` and return its path; the file is complete or absent."""
    return write_json(to_json(diagnosis), "mrd_diagnosis", "gap_report", folder)


def read_gap_report(path: str | Path) -> Mapping[str, Any]:
    """Read a gap_report.json.

    Raises
    ------
    InputError
        When the file cannot be read, or is not a gap_report.json of this version.
    """
    content: Mapping[str, Any] = read_json(path, "mrd_diagnosis", "gap_report", SCHEMA)
    return content


def _stand_in(stand_in: StandIn) -> dict[str, Any]:
    return {
        "name": stand_in.name,
        "source": stand_in.source,
        "model": stand_in.model.id,
        "parameters": stand_in.values,
        "error": finite_or_none(stand_in.error),
        "set": dict(stand_in.set_values),
    }


def _gap(gap: Gap) -> dict[str, Any]:
    return {
        "noise_floor": _interval(gap.noise_floor),
        "as_given": None if gap.as_given is None else finite_or_none(gap.as_given),
        "before": _interval(gap.before),
        "after": _interval(gap.after),
        "closed_fraction": _interval(gap.closed_fraction),
        "explainable_fraction": finite_or_none(gap.explainable_fraction),
        "extrapolated": None if gap.extrapolated is None else _interval(gap.extrapolated),
        "form_fraction": finite_or_none(gap.form_fraction),
    }


def _corrected(corrected: CorrectedSimulator) -> dict[str, Any]:
    return {
        "effects": list(corrected.effects),
        "parameters": {name: finite_or_none(float(value)) for name, value in corrected.parameters.items()},
    }


def _run(residual: RunResidual) -> dict[str, Any]:
    def relative(errors: Array) -> float | None:
        return finite_or_none(nrmse(errors, residual.recording.force)) if len(errors) else None

    return run_json(residual.recording.run) | {
        "before": relative(residual.before),
        "after": relative(residual.after),
        "noise_floor": relative(residual.noise.sigma),
        "noise": {
            "force_N": finite_or_none(residual.noise.force),
            "motion_N": finite_or_none(residual.noise.motion),
            "source": residual.noise.source,
        },
        "offset_N": finite_or_none(residual.offset),
        "gain": finite_or_none(residual.gain),
        "extrapolates": residual.extrapolates,
        "by_folds": residual.by_folds,
    }


def _region(region: Region) -> dict[str, Any]:
    return {
        "axis": region.axis,
        "lower": finite_or_none(region.lower),
        "upper": finite_or_none(region.upper),
        "unit": region.unit,
        "share": finite_or_none(region.share.value),
        "lift": finite_or_none(region.lift),
        "ci95": _ends(region.share),
        "q_value": finite_or_none(region.q_value),
        "label": region.label,
    }


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "effect": cause.effect,
        "probability": finite_or_none(cause.probability),
        "stage": EFFECTS[cause.effect].stage if cause.effect in EFFECTS else None,
        "level": cause.level,
        "class": class_name([member.effect for member in cause.members]) or None,
        "members": [
            {
                "effect": member.effect,
                "probability": finite_or_none(member.probability),
                "imitation": finite_or_none(member.imitation),
                "parameters": _parameters(parameters_of_effect(member.effect, member.parameters)),
            }
            for member in cause.members
        ],
        "plausible": list(cause.plausible),
        "parameters": _parameters(parameters_of_effect(cause.effect, cause.parameters)),
        **_closed_fraction(cause.closed_fraction),
        "p_value": finite_or_none(cause.p_value),
    }


def _rejected(entry: Rejected) -> dict[str, Any]:
    return {
        "effect": entry.effect,
        "rule": entry.rule,
        "why": entry.why,
        "seen": entry.chosen,
        "probability": finite_or_none(entry.probability),
        **_closed_fraction(entry.closed_fraction),
        "p_value": finite_or_none(entry.p_value),
        "parameters": _parameters(parameters_of_effect(entry.effect, entry.parameters)),
    }


def _alternative(alternative: Alternative) -> dict[str, Any]:
    return {
        "effect": alternative.effect,
        "instead_of": alternative.instead_of,
        "probability": finite_or_none(alternative.probability),
        "why": alternative.why,
        "parameters": _parameters(parameters_of_effect(alternative.effect, alternative.parameters)),
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    return {
        "effects": list(candidate.effects),
        "probability": finite_or_none(candidate.probability),
        "nrmse": finite_or_none(candidate.nrmse),
        **_closed_fraction(candidate.closed_fraction),
        "p_value": finite_or_none(candidate.p_value),
        "parameters": _parameters(candidate.parameters),
        "indistinguishable": list(candidate.indistinguishable),
        "smallest_detectable": candidate.smallest_detectable,
    }


def _advice(advice: Advice) -> dict[str, Any]:
    return {
        "text": advice.text,
        "experiment": advice.experiment or None,
        "between": list(advice.between),
        "error_rate": finite_or_none(advice.error_rate),
    }


def _parameters(values: Mapping[str, ParameterEstimate]) -> dict[str, Any]:
    return {name: {**_interval(value.value), "unit": value.unit, "remark": value.remark} for name, value in values.items()}


def _interval(interval: Interval) -> dict[str, Any]:
    return {"value": finite_or_none(interval.value), "ci95": _ends(interval)}


def _closed_fraction(closed: Interval) -> dict[str, Any]:
    return {"closed_fraction": finite_or_none(closed.value), "ci95": _ends(closed)}


def _ends(interval: Interval) -> list[float | None]:
    return [finite_or_none(interval.lower), finite_or_none(interval.upper)]
