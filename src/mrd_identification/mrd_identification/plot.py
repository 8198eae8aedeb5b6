"""plot.html: recordings before anything is fitted to them, and what dampers or simulators answer to the same motion."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.linked_plots import linked_page
from mrd_identification.metrics import metrics
from mrd_identification.recording import Recording, consecutive_modelled_forces, prepare_recording
from mrd_identification.report import render
from mrd_identification.run_panels import Prediction, panels_of
from mrd_identification.run_start import estimate_starts
from mrd_runs import Run
from mrd_runs.read import describe_runs
from mrd_sim.damper import Damper
from mrd_sim.simulators.simulator import Simulator, signals_of

Array = NDArray[np.float64]


def predict(source: Damper | Simulator, name: str, recordings: Sequence[Recording]) -> Prediction:
    """Return the force of a damper, whose state before each run is estimated, or of a simulator from rest.

    Raises
    ------
    InputError
        When the simulator fails, or a damper corrects a simulator of the user's own.
    """
    if isinstance(source, Simulator):
        return Prediction(name, tuple(source.force(signals_of(recording.smoothed)) for recording in recordings))
    if source.model.stands_for:
        raise InputError(
            f"{name}: corrects the simulator {source.model.stands_for}, whose force it needs; `validate` with --simulator "
            "shows both"
        )
    started = estimate_starts(source.model, source.theta, recordings)
    return Prediction(name, tuple(consecutive_modelled_forces(source.model, source.theta, started)))


def write_plot(runs: Sequence[Run], folder: str | Path, sources: Mapping[str, Damper | Simulator] | None = None) -> Path:
    """Write plot.html into ``folder`` and return its path.

    Parameters
    ----------
    runs : sequence of Run
    folder : path
    sources : mapping, optional
        Dampers and simulators by name.

    Raises
    ------
    InputError
        When a simulator fails.
    """
    recordings = [prepare_recording(run) for run in runs] if sources else []
    predictions = [predict(source, name, recordings) for name, source in (sources or {}).items()]
    return render(
        "plot",
        folder,
        runs=runs,
        title=", ".join(run.name for run in runs[:3]) + (f" and {len(runs) - 3} more" if len(runs) > 3 else ""),
        sentence=f"{describe_runs(runs)}.",
        plots=linked_page(panels_of(runs, predictions)),
        rows=[
            (run.name, prediction.name, *_error(recording, force))
            for prediction in predictions
            for run, recording, force in zip(runs, recordings, prediction.forces, strict=True)
        ],
    )


def _error(recording: Recording, force: Array) -> tuple[str, str]:
    found = metrics(recording.force, force[recording.counted])
    return f"{100 * found.nrmse:.3g} %", f"{found.rmse:.3g} N"
