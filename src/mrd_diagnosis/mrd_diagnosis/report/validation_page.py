"""validation.html and validation.json: how well a damper predicts new runs, for a reader and for programs."""

from pathlib import Path
from typing import Any

from mrd_base.figures import MOST_POINTS, to_html
from mrd_base.json_file import finite_or_none, make_folder, write_json
from mrd_diagnosis.localisation.sentence import place_sentence
from mrd_diagnosis.thresholds import is_noise
from mrd_diagnosis.validation.validate import ValidatedRun, Validation
from mrd_diagnosis.wording.quantities import format_error, format_quantity
from mrd_identification import figures
from mrd_identification.report import MOST_RUNS, POINTS, render
from mrd_identification.run_panels import closer_look
from mrd_identification.versions import versions
from mrd_runs.summary import run_json

SCHEMA = "mrd-validation/1"


def validation_sentence(validation: Validation) -> str:
    """Return what was found: the error against the noise floor, the worst run, what exceeds the fitted runs, and where."""
    runs = validation.runs
    count = f"{len(runs)} runs" if len(runs) > 1 else "the run"
    floor = f"a perfect model would have {format_error(validation.noise_floor)}"
    size = f"{format_error(validation.nrmse)} of the force's standard deviation"
    error = f"The damper predicts {count} with an error of {size}; {floor}."
    only_noise = is_noise(validation.nrmse, validation.noise_floor)
    if only_noise:
        error += " That is hardly more than noise."
    sentences = [error]
    worst = max(runs, key=lambda run: run.result.metrics.nrmse)
    if len(runs) > 1:
        sentences.append(f"The largest is that of {worst.result.run.name}, {format_error(worst.result.metrics.nrmse)}.")
    if fitted := [run.result.run.name for run in runs if run.was_fitted]:
        which = "all of them" if len(fitted) == len(runs) > 1 else ", ".join(fitted)
        sentences.append(f"The damper was fitted to {which}; that error says nothing about new runs.")
    if beyond := [run for run in runs if run.exceeds]:
        names = ", ".join(f"{run.result.run.name} ({run.exceeds})" for run in beyond)
        sentences.append(f"Beyond the runs to which it was fitted: {names}.")
    if not only_noise and (place := place_sentence(validation.where, "the error beyond noise")):
        sentences.append(place)
    return " ".join(sentences)


def write_validation(validation: Validation, folder: str | Path) -> Path:
    """Write validation.html and validation.json into ``folder`` and return the path of the page."""
    make_folder(str(folder))
    write_json(to_json(validation), "mrd_diagnosis", "validation", folder)
    by_error = sorted(validation.runs, key=lambda run: -run.result.metrics.nrmse)
    points = min(POINTS // min(len(by_error), MOST_RUNS), MOST_POINTS)
    results = [run.result for run in validation.runs]
    return render(
        "validation",
        folder,
        "mrd_diagnosis",
        runs=[result.run for result in results],
        title=f"Prediction by {validation.damper.description}",
        sentence=validation_sentence(validation),
        headline=[
            ("error (NRMSE)", format_error(validation.nrmse)),
            ("noise floor", format_error(validation.noise_floor)),
            ("rms error", format_quantity(validation.rmse, "N")),
            ("runs", str(len(results))),
        ],
        rows=[_row(run) for run in by_error],
        fitted_known=validation.fitted_known,
        limitations=[finding.sentence for finding in validation.limitations],
        loops=to_html(figures.loops(results)),
        over_time=[
            (
                f"{run.result.run.name}, {format_error(run.result.metrics.nrmse)}",
                to_html(figures.force_over_time(run.result, points)),
            )
            for run in by_error[:MOST_RUNS]
        ],
        residuals=to_html(figures.residuals(results)),
        closer=closer_look(by_error[0].result.run, {validation.damper.description: by_error[0].result.modelled}),
    )


def to_json(validation: Validation) -> dict[str, Any]:
    """Return the content of validation.json; floats that are not finite become null."""
    damper = validation.damper
    return {
        "schema": SCHEMA,
        "sentence": validation_sentence(validation),
        "model": damper.model.id,
        "laws": dict(damper.model.laws),
        "effects": [effect.id for effect in damper.model.effects],
        "nrmse": finite_or_none(validation.nrmse),
        "rmse_N": finite_or_none(validation.rmse),
        "noise_floor": finite_or_none(validation.noise_floor),
        "runs": [
            run_json(run.result.run)
            | {
                "nrmse": finite_or_none(run.result.metrics.nrmse),
                "rmse_N": finite_or_none(run.result.metrics.rmse),
                "noise_floor": finite_or_none(run.noise_floor),
                "offset_N": run.offset,
                "gain": run.gain,
                "exceeds": run.exceeds if validation.fitted_known else None,
                "was_fitted": run.was_fitted if validation.fitted_known else None,
            }
            for run in validation.runs
        ],
        "limitations": [finding.sentence for finding in validation.limitations],
        "versions": versions(),
    }


def _row(run: ValidatedRun) -> tuple[str, ...]:
    metrics = run.result.metrics
    return (
        run.result.run.name,
        format_error(metrics.nrmse),
        format_error(run.noise_floor),
        format_quantity(metrics.rmse, "N"),
        format_quantity(run.offset, "N") if run.offset else "–",
        f"{100 * run.gain:+.1f} %" if run.gain else "–",
        "no, fitted to it" if run.was_fitted else run.exceeds or "–",
    )
