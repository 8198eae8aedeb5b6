"""gap_report.json: a diagnosis as a file."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Advice, Candidate, Cause, Diagnosis, Interval, ParameterEstimate, Region, RunResidual
from mrd_diagnosis.effect_names import parameters_of_effect
from mrd_identification.json_file import finite, read_json, run_json, versions, write_json
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

SCHEMA = "mrd-gap/1"


def to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Content of gap_report.json; floats that are not finite become null."""
    model = diagnosis.model
    told = {trace.recording.run.name: _run(trace) for trace in diagnosis.residuals}
    return {
        "schema": SCHEMA,
        "sentence": diagnosis.sentence,
        "verdict": diagnosis.verdict,
        "model": model.id,
        "laws": model.laws,
        "runs": {
            "fit": [told.get(run.name, run_json(run)) for run in diagnosis.runs],
            "held_out": [told.get(run.name, run_json(run)) for run in diagnosis.held_out],
            "held_out_by": diagnosis.held_out_by,
        },
        "seed": diagnosis.seed,
        "elapsed_s": round(diagnosis.elapsed, 3),
        "gap": {
            "noise_floor": _interval(diagnosis.gap.noise_floor),
            "unfitted": _number(diagnosis.gap.as_given),
            "before": _interval(diagnosis.gap.before),
            "after": _interval(diagnosis.gap.after),
            "closed_fraction": _interval(diagnosis.gap.closed_fraction),
            "ceiling": finite(diagnosis.gap.explainable_fraction),
            "extrapolated": _interval(diagnosis.gap.extrapolated) if diagnosis.gap.extrapolated else None,
        },
        "where": [_region(region) for region in diagnosis.where],
        "causes": [_cause(cause) for cause in diagnosis.causes],
        "alternatives": [
            {
                "effect": alternative.effect,
                "instead_of": alternative.instead_of,
                "probability": finite(alternative.probability),
                "why": alternative.why,
            }
            for alternative in diagnosis.alternatives
        ],
        "nearest": _candidate(diagnosis.nearest) if diagnosis.nearest else None,
        "candidates": [_candidate(candidate) for candidate in diagnosis.candidates],
        "untestable": [{"effect": entry.effect, "why": entry.why} for entry in diagnosis.untestable],
        "forms": [
            {
                "model": form.name,
                "nrmse": finite(form.nrmse),
                "closed_fraction": finite(form.closed_fraction.value),
                "ci95": _ends(form.closed_fraction),
            }
            for form in diagnosis.alternative_models
        ],
        "next_experiment": _advice(diagnosis.next_experiment) if diagnosis.next_experiment else None,
        "corrected": {
            "effects": list(diagnosis.corrected.effects),
            "parameters": {name: finite(float(value)) for name, value in diagnosis.corrected.parameters.items()},
        },
        "findings": [
            {
                "kind": finding.kind,
                "severity": finding.severity,
                "run": finding.run,
                "channel": finding.channel,
                "text": finding.text,
            }
            for finding in diagnosis.findings
        ],
        "notes": list(diagnosis.notes),
        "versions": versions(),
    }


def write_gap_file(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write gap_report.json into ``folder`` and return its path; the file is whole or not there."""
    return write_json(to_json(diagnosis), "mrd_diagnosis", "gap_report", folder)


def read_gap_report(path: str | Path) -> Mapping[str, Any]:
    """Content of a gap_report.json.

    Raises
    ------
    InputError
        When the file cannot be read or is no gap_report.json of this version.
    """
    content: Mapping[str, Any] = read_json(path, "mrd_diagnosis", "gap_report", SCHEMA)
    return content


def _run(trace: RunResidual) -> dict[str, Any]:
    force = trace.recording.force
    spread = float(np.std(force)) or math.nan

    def nrmse(errors: Array) -> float | None:
        return finite(float(np.sqrt(np.mean(errors**2))) / spread) if len(errors) else None

    return run_json(trace.recording.run) | {
        "before": nrmse(trace.before),
        "after": nrmse(trace.after),
        "noise_floor": nrmse(trace.noise.sigma),
        "noise": {
            "force_N": finite(trace.noise.force),
            "motion_N": finite(trace.noise.motion),
            "source": trace.noise.source,
        },
        "offset_N": finite(trace.offset),
        "gain": finite(trace.gain),
        "extrapolates": trace.extrapolates,
        "in_parts": trace.by_folds,
    }


def _region(region: Region) -> dict[str, Any]:
    return {
        "axis": region.axis,
        "lower": finite(region.lower),
        "upper": finite(region.upper),
        "unit": region.unit,
        "share": finite(region.share.value),
        "lift": finite(region.lift),
        "ci95": _ends(region.share),
        "q_value": finite(region.q_value),
        "label": region.label,
    }


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "effect": cause.effect,
        "probability": finite(cause.probability),
        "stage": EFFECTS[cause.effect].stage if cause.effect in EFFECTS else None,
        "parameters": _parameters(parameters_of_effect(cause.effect, cause.parameters)),
        "closed_fraction": finite(cause.closed_fraction.value),
        "ci95": _ends(cause.closed_fraction),
        "p_value": finite(cause.p_value),
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    return {
        "effects": list(candidate.effects),
        "probability": finite(candidate.probability),
        "nrmse": finite(candidate.nrmse),
        "closed_fraction": finite(candidate.closed_fraction.value),
        "ci95": _ends(candidate.closed_fraction),
        "p_value": finite(candidate.p_value),
        "parameters": _parameters(candidate.parameters),
        "alike": list(candidate.indistinguishable),
        "remark": candidate.remark,
        "smallest": candidate.smallest_detectable,
    }


def _advice(advice: Advice) -> dict[str, Any]:
    return {
        "text": advice.text,
        "experiment": advice.experiment or None,
        "between": list(advice.between),
        "error_rate": finite(advice.error_rate),
    }


def _parameters(values: Mapping[str, ParameterEstimate]) -> dict[str, Any]:
    return {name: {**_interval(value.value), "unit": value.unit, "remark": value.remark} for name, value in values.items()}


def _interval(interval: Interval) -> dict[str, Any]:
    return {"value": finite(interval.value), "ci95": _ends(interval)}


def _ends(interval: Interval) -> list[float | None]:
    return [finite(interval.lower), finite(interval.upper)]


def _number(value: float | None) -> float | None:
    return None if value is None else finite(value)
