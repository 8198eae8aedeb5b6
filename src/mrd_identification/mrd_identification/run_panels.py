"""Panels of runs: what was measured, and what dampers or simulators answer to the same motion, to zoom and to read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_base.linked_plots import COLORS, MEASURED, Line, Panel, linked_page
from mrd_runs import Run

Array = NDArray[np.float64]

FORCE_HEIGHT, HEIGHT = 260, 150
"""Heights in pixels: of the force over time, and of the other signals."""


CLOSER_BYTES = 150_000
"""Size of the data of a closer look within another page."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a damper or a simulator answers to the motion of runs: its name, and the force (n,) in N of each run."""

    name: str
    forces: tuple[Array, ...]


def panels_of(runs: Sequence[Run], predictions: Sequence[Prediction] = ()) -> list[Panel]:
    """Return the panels of runs: force, residual, position, velocity and current over time, and both loops."""
    one = len(runs) == 1
    colors = [MEASURED if one else COLORS[index % len(COLORS)] for index in range(len(runs))]

    def measured(series: str, x: str = "") -> list[Line]:
        return [
            Line(run.name, run.time, getattr(run, series), 1e3 * getattr(run, x) if x else None, color)
            for run, color in zip(runs, colors, strict=True)
        ]

    def predicted(x: str = "", *, error: bool = False) -> list[Line]:
        return [
            Line(
                prediction.name if one else f"{run.name}, {prediction.name}",
                run.time,
                run.force - force if error else force,
                1e3 * getattr(run, x) if x else None,
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
    for series, title in (("position", "position, mm"), ("velocity", "velocity, mm/s")):
        panels.append(Panel(title, "force, N", (*measured("force", series), *predicted(series))))
    return panels


def _scaled(line: Line) -> Line:
    """Return a line over time in thousandths of its unit."""
    return Line(line.name, line.time, 1e3 * line.y, None, line.color, line.dashed)


def closer_look(run: Run, forces: Mapping[str, Array]) -> str:
    """Return a part of a page, folded away, in which a run and modelled forces (n,) by name can be zoomed and read."""
    predictions = [Prediction(name, (force,)) for name, force in forces.items()]
    return linked_page(panels_of([run], predictions), f"Look closer at {run.name}", CLOSER_BYTES)
