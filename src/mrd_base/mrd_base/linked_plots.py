"""Plots over time that a reader can zoom, pan and read together, in a page that needs no network (uPlot is part of it)."""

import base64
import html
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_BYTES = 700_000
"""Size of the data of all panels of a page; lines are drawn with fewer points beyond it."""

COLORS = ("#00798c", "#d1495b", "#edae49", "#66a182", "#8d6a9f", "#3d6fa5", "#b7791f", "#7a4fa3")
"""Colours of lines, in their order."""

LEAST_POINTS = 100
"""Points of a line that are always drawn."""

LOOP_POINTS_OF_STROKE = 12
"""Points between two reversals of a loop; where there is less room, a part of the recording is drawn."""

MEASURED = "measured"
"""Colour of what was measured: that of the page's small print."""


_HELP = (
    "Drag to zoom, turn the wheel to zoom around the pointer, hold shift and drag to move, double-click to see all. Panels "
    "move together; the loops show the same times. Click a name to hide its line. A residual is the measured force less the "
    "modelled one."
)

_STYLE = """
.linked-plots .loop { display: inline-block; width: min(48%, 560px); min-width: min(100%, 320px); vertical-align: top; }
.linked-plots .over-time { margin: 4px 0 10px; } .uplot { max-width: 100%; }
.u-legend { font-size: 12px; color: var(--ink); text-align: left !important; padding-left: 58px; }
.u-legend th { font-weight: normal; border: 0; } .u-legend td { border: 0; } .u-series td, .u-series th { padding: 1px 3px; }
@media (max-width: 600px) { .linked-plots .loop { width: 100%; } }
"""


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a panel.

    Attributes
    ----------
    name : str
    time : ndarray (n,)
        s, increasing.
    y : ndarray (n,)
    x : ndarray (n,) or None
        What stands on the horizontal axis of a loop; None over time.
    color : str
        As in CSS, or `MEASURED`.
    dashed : bool
    """

    name: str
    time: Array
    y: Array
    x: Array | None = None
    color: str = COLORS[0]
    dashed: bool = False


@dataclass(frozen=True)
class Panel:
    """A diagram: its axes with their units, and its lines, all over time or all loops."""

    x_title: str
    y_title: str
    lines: tuple[Line, ...]
    height: int = 200


def linked_page(panels: Sequence[Panel], title: str = "", most_bytes: int = MOST_BYTES) -> str:
    """Return panels with all that draws them, once in a page; with a title, they are folded away below it."""
    content = f'<p class="soft">{_HELP}</p>{linked_plots(panels, most_bytes)}'
    if title:
        content = f"<details><summary>{html.escape(title)}</summary>{content}</details>"
    return content + script()


def linked_plots(panels: Sequence[Panel], most_bytes: int = MOST_BYTES) -> str:
    """Return panels as a part of a page that has the `script`.

    Parameters
    ----------
    panels : sequence of Panel
    most_bytes : int
        Size of the data. Where there is more, each line is drawn by the extremes of its samples, evenly in time.
    """
    lines = [(len(line.time), 2 if line.x is None else 3) for panel in panels for line in panel.lines]
    most = max((samples for samples, _ in lines), default=1)
    # Four bytes a number, and a third more as text.
    while most > LEAST_POINTS and sum(min(samples, most) * series for samples, series in lines) * 16 / 3 > most_bytes:
        most = int(0.9 * most)
    content = [_panel(panel, most) for panel in panels]
    text = json.dumps(content).replace("<", "\\u003c")
    return f'<div class="linked-plots"><script type="application/json">{text}</script></div>'


def script() -> str:
    """Return what draws the panels, as a part of the end of a page: style and scripts."""
    folder = resources.files("mrd_base").joinpath("templates")
    style = folder.joinpath("uplot", "uPlot.min.css").read_text(encoding="utf-8")
    library = folder.joinpath("uplot", "uPlot.iife.min.js").read_text(encoding="utf-8")
    own = folder.joinpath("linked_plots.js").read_text(encoding="utf-8")
    return f"<style>{style}{_STYLE}</style><script>{library}</script><script>{own}</script>"


def _panel(panel: Panel, most: int) -> dict[str, Any]:
    return {
        "x": panel.x_title,
        "y": panel.y_title,
        "height": panel.height,
        "loop": any(line.x is not None for line in panel.lines),
        "lines": [_line(line, most) for line in panel.lines],
    }


def _line(line: Line, most: int) -> dict[str, Any]:
    kept = _extremes(line.y, most) if line.x is None else _of_loop(line.x, most)
    coded = {"time": line.time, "x": line.x, "y": line.y}
    numbers = {name: _coded(series[kept]) for name, series in coded.items() if series is not None}
    return {"name": line.name, "color": line.color, "dashed": line.dashed, **numbers}


def _coded(series: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(series, np.float32).tobytes()).decode("ascii")


def _of_loop(x: Array, most: int) -> NDArray[np.intp]:
    """Return the places of a loop's points: evenly, where its strokes keep their shape; else of a part from its start."""
    if len(x) <= most:
        return np.arange(len(x))
    reversals = 1 + int(np.count_nonzero(np.diff(np.sign(np.diff(_smoothed(x))))))
    part = len(x) if most >= LOOP_POINTS_OF_STROKE * reversals else int(len(x) * most / (LOOP_POINTS_OF_STROKE * reversals))
    return np.unique(np.linspace(0, max(part, 2) - 1, min(part, most)).astype(np.intp))


def _smoothed(x: Array) -> Array:
    """Return a series whose noise makes no reversals."""
    length = max(1, len(x) // 2000)
    return np.convolve(x, np.full(length, 1 / length), "valid")[::length]


def _extremes(series: Array, most: int) -> NDArray[np.intp]:
    """Return the places of the least and largest value of each of ``most`` / 2 pieces, so that no peak is lost."""
    if len(series) <= most:
        return np.arange(len(series))
    edges = np.linspace(0, len(series), max(most // 2, 1) + 1).astype(np.intp)
    pieces = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges) if b > a]
    kept = {0, len(series) - 1}
    for piece in pieces:
        kept |= {piece.start + int(np.argmin(series[piece])), piece.start + int(np.argmax(series[piece]))}
    return np.array(sorted(kept), dtype=np.intp)
