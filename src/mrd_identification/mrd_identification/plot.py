"""plot.html: recordings before anything is fitted to them, and what dampers or simulators answer to the same motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base.linked_plots import COLORS, MEASURED, Line, Panel, linked_plots, script
from mrd_identification.metrics import metrics
from mrd_identification.recording import Recording, consecutive_modelled_forces, prepare_recording
from mrd_identification.report import render
from mrd_identification.run_start import estimate_starts
from mrd_runs import Run
from mrd_runs.read import describe_runs
from mrd_sim.damper import Damper
from mrd_sim.simulators.simulator import Simulator, signals_of

Array = NDArray[np.float64]

FORCE_HEIGHT, HEIGHT = 260, 150
"""Heights in pixels: of the force over time, and of the other signals."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a damper or a simulator answers to the motion of runs: its name, and the force (n,) in N of each run."""

    name: str
    forces: tuple[Array, ...]


def predict(source: Damper | Simulator, name: str, recordings: Sequence[Recording]) -> Prediction:
    """Return the force of a damper, whose state before each run is estimated, or of a simulator from rest.

    Raises
    ------
    InputError
        When the simulator fails.
    """
    if isinstance(source, Simulator):
        return Prediction(name, tuple(source.force(signals_of(recording.smoothed)) for recording in recordings))
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
        plots=linked_plots(panels_of(runs, predictions)),
        rows=[
            (run.name, prediction.name, *_error(recording, force))
            for prediction in predictions
            for run, recording, force in zip(runs, recordings, prediction.forces, strict=True)
        ],
        script=script(),
    )


def panels_of(runs: Sequence[Run], predictions: Sequence[Prediction] = ()) -> list[Panel]:
    """Return the panels of runs: force, residual, position, velocity and current over time, and both loops."""
    one = len(runs) == 1
    colors = [MEASURED if one else COLORS[index % len(COLORS)] for index in range(len(runs))]

    def measured(series: str, x: str = "") -> list[Line]:
        return [
            Line(run.name, run.time, getattr(run, series), getattr(run, x) if x else None, color)
            for run, color in zip(runs, colors, strict=True)
        ]

    def predicted(x: str = "", *, error: bool = False) -> list[Line]:
        return [
            Line(
                prediction.name if one else f"{run.name}, {prediction.name}",
                run.time,
                run.force - force if error else force,
                getattr(run, x) if x else None,
                COLORS[(number + 1) % len(COLORS)] if one else color,
                dashed=not one,
            )
            for number, prediction in enumerate(predictions)
            for run, color, force in zip(runs, colors, prediction.forces, strict=True)
        ]

    panels = [Panel("", "force, N", (*measured("force"), *predicted()), FORCE_HEIGHT)]
    if predictions:
        panels.append(Panel("", "residual, N", tuple(predicted(error=True)), HEIGHT))
    panels += [
        Panel("", "position, mm", tuple(_scaled(line) for line in measured("position")), HEIGHT),
        Panel("", "velocity, mm/s", tuple(_scaled(line) for line in measured("velocity")), HEIGHT),
        Panel("time, s", "current, A", tuple(measured("current")), HEIGHT),
    ]
    for series, title in (("position", "position, m"), ("velocity", "velocity, m/s")):
        panels.append(Panel(title, "force, N", (*measured("force", series), *predicted(series))))
    return panels


def _scaled(line: Line) -> Line:
    """Return a line over time in thousandths of its unit."""
    return Line(line.name, line.time, 1e3 * line.y, None, line.color, line.dashed)


def _error(recording: Recording, force: Array) -> tuple[str, str]:
    found = metrics(recording.force, force[recording.counted])
    return f"{100 * found.nrmse:.3g} %", f"{found.rmse:.3g} N"
