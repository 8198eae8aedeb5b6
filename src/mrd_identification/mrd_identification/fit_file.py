"""The file fit.json: an identified model with its intervals, metrics and Pareto front."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrd_base import InputError
from mrd_base.json_file import finite_or_none, read_json, write_json
from mrd_identification.effect_selection import AddedEffect, Selection
from mrd_identification.fit import Estimate, Fit
from mrd_identification.metrics import Metrics
from mrd_identification.versions import versions
from mrd_runs.summary import run_json

SCHEMA = "mrd-fit/6"


@dataclass(frozen=True)
class StoredFit:
    """The model that a fit.json describes.

    Attributes
    ----------
    model : str
    laws : mapping
        Current law by coefficient.
    effects : sequence of str
        Ids of the effects that act with it.
    values : mapping
        Parameters by name in SI units.
    content : mapping
        The whole file.
    """

    model: str
    laws: Mapping[str, str]
    effects: Sequence[str]
    values: Mapping[str, float]
    content: Mapping[str, Any]


def to_json(fit: Fit) -> dict[str, Any]:
    """Return the content of fit.json; floats that are not finite become null."""
    return {
        "schema": SCHEMA,
        "model": fit.model.id,
        "equation": fit.model.equation,
        "source": fit.model.source,
        "laws": fit.model.laws,
        "effects": [effect.id for effect in fit.model.effects],
        "selection": _selection_json(fit.selection) if fit.selection else None,
        "runs": {
            "fit": [run_json(result.run) for result in fit.fitted],
            "held_out": [run_json(result.run) for result in fit.held_out] if fit.held_out_by == "runs" else [],
            "held_out_by": fit.held_out_by,
        },
        "seed": fit.method.seed,
        "elapsed_s": round(fit.elapsed, 3),
        "method": _method_json(fit),
        "parameters": {estimate.parameter.name: _estimate_json(estimate) for estimate in fit.estimates},
        "observables": {
            "current_A": fit.current,
            "values": {name: {"value": value, "unit": unit} for name, (value, unit) in fit.observables.items()},
        },
        "objectives": {"e2_N": fit.pooled_fitted.e2, "einf_N": fit.pooled_fitted.einf, "samples": fit.pooled_fitted.samples},
        "pareto_front": [
            {
                "e2_N": float(norms[0]),
                "einf_N": float(norms[1]),
                "knee": index == fit.front.knee,
                "parameters": dict(zip(fit.model.names, map(float, theta), strict=True)),
            }
            for index, (theta, norms) in enumerate(zip(fit.front.thetas, fit.front.norms, strict=True))
        ],
        "metrics": {
            "fit": metrics_json(fit.pooled_fitted),
            "held_out": metrics_json(fit.pooled_held_out) if fit.pooled_held_out else None,
            "per_run": [
                {"run": result.run.name, "used_as": used_as, **metrics_json(result.metrics)}
                for used_as, results in (("fit", fit.fitted), ("held_out", fit.held_out))
                for result in results
            ],
        },
        "nrmse_by_seed": list(fit.seed_errors),
        "condition": finite_or_none(fit.condition),
        "correlation": {
            "parameters": [estimate.parameter.name for estimate in fit.estimates if not estimate.fixed],
            "matrix": np.round(fit.correlation, 6).tolist(),
        },
        "warnings": list(fit.warnings),
        "versions": versions("pymoo"),
    }


def _method_json(fit: Fit) -> dict[str, Any]:
    method = fit.method
    return {
        "search": "NSGA-II, linear parameters by variable projection",
        "population": method.population,
        "generations": method.generations,
        "seeds": method.seeds,
        "least_squares": method.least_squares,
        "loss": method.loss,
        "weights": method.weights if isinstance(method.weights, str) else list(method.weights),
        "run_offsets_N": list(fit.run_offsets) if method.offsets else None,
    }


def _selection_json(selection: Selection) -> dict[str, Any]:
    return {
        "left_out": "runs" if selection.of_runs else "stretches",
        "parts": selection.parts,
        "added": [_added_json(step) for step in selection.added],
        "next_best": _added_json(selection.next_best) if selection.next_best else None,
        "elapsed_s": round(selection.elapsed, 3),
    }


def _added_json(step: AddedEffect) -> dict[str, Any]:
    return {
        "effect": step.effect,
        "nrmse_before": step.nrmse_before,
        "nrmse_after": step.nrmse_after,
        "improvement": step.improvement,
        "standard_error": step.standard_error,
        "equally_good": list(step.equally_good),
    }


def _estimate_json(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": estimate.value,
        "ci95": [finite_or_none(estimate.lower), finite_or_none(estimate.upper)],
        "profile_ci95": [finite_or_none(estimate.profile_lower), finite_or_none(estimate.profile_upper)],
        "by_seed": list(estimate.by_seed),
        "unit": estimate.parameter.unit,
        "bounds": [estimate.parameter.lower, estimate.parameter.upper],
        "fixed": estimate.fixed,
        "on_bound": estimate.on_bound,
        "meaning": estimate.parameter.meaning,
    }


def write_fit(fit: Fit, folder: str | Path) -> Path:
    """Write fit.json into ``folder`` and return its path."""
    return write_json(to_json(fit), "mrd_identification", "fit", folder)


def read_fit(path: str | Path) -> StoredFit:
    """Read a fit.json.

    Raises
    ------
    InputError
        When the file cannot be read, or is not a fit.json of this version.
    """
    content = read_json(path, "mrd_identification", "fit", SCHEMA)
    values = {name: entry["value"] for name, entry in content["parameters"].items()}
    return StoredFit(content["model"], content["laws"], content["effects"], values, content)


def fitted_sources(path: str | Path) -> list[str]:
    """Return the files of the runs to which a fit.json or a gap_report.json was fitted.

    Raises
    ------
    InputError
        When the file names none.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        sources = [run["source"] for run in content["runs"]["fit"]]
    except (OSError, ValueError, KeyError, TypeError):
        sources = []
    if not sources or not all(sources):
        raise InputError(f"{path}: names no files of runs, expected a fit.json or a gap_report.json of recorded runs")
    return sources


def metrics_json(metrics: Metrics) -> dict[str, Any]:
    """Describe metrics in a JSON file."""
    return {
        "samples": metrics.samples,
        "rmse_N": finite_or_none(metrics.rmse),
        "nrmse": finite_or_none(metrics.nrmse),
        "fit_percent": finite_or_none(metrics.fit_percent),
        "vaf": finite_or_none(metrics.vaf),
        "e2_N": finite_or_none(metrics.e2),
        "einf_N": finite_or_none(metrics.einf),
    }
