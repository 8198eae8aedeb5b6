"""The plots (ECharts): colours that can be told apart in both themes, one table behind all curves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from mrd_trajectory.limits import Limits

# Measured, predicted, residual: distinguishable with red-green blindness, on white and on black (Okabe and Ito, 2008).
MEASURED, PREDICTED, RESIDUAL, LIMIT = "#2b8cd6", "#e69f00", "#009e73", "#d55e00"
_AXIS, _GRID = "#808080", "#80808040"
_LOW = 15.0  # percent; a plot lower than that has few lines

NARROW = 560
"""Width of a chart in pixels up to which plots that would stand beside each other stand beneath each other."""
_LABELS = 5.0  # percent of a high chart that the labels beneath a plot take


@dataclass(frozen=True)
class Panel:
    """One plot: its place in percent of the chart, its curves, and its limits.

    Attributes
    ----------
    x, y : str
        Columns; ``y`` of the first curve names the axis.
    place : tuple of float
        Left, top, width, height in percent.
    curves : sequence of (str, str, str)
        Column, colour, and name of each curve.
    x_limits, y_limits : tuple of float
        Where lines are drawn, in the unit of the axis.
    """

    x: str
    place: tuple[float, float, float, float]
    curves: Sequence[tuple[str, str, str]]
    x_limits: tuple[float, ...] = ()
    y_limits: tuple[float, ...] = ()


def title(column: str) -> str:
    """Return the title of an axis: the quantity and its unit, from the name of the column."""
    name, _, unit = column.partition("_")
    return f"{name} / {unit.replace('_per_', '/')}" if unit else name


def chart(
    panels: Sequence[Panel],
    *,
    show_limits: bool = True,
    columns: Mapping[str, Any] | None = None,
    stacked_if_narrow: bool = False,
) -> dict[str, Any]:
    """Return the options of a chart with several plots over one table.

    Parameters
    ----------
    show_limits : bool
        Whether the axes reach to the limits; else they follow the curves.
    columns : mapping, optional
        The table.
    stacked_if_narrow : bool
        Whether the plots stand beneath each other in a chart of at most `NARROW` pixels, which then has to be high.
    """
    grids, x_axes, y_axes, series = [_grid(panel.place) for panel in panels], [], [], []
    for index, panel in enumerate(panels):
        height = panel.place[3]
        x_axes.append(_axis(index, title(panel.x), panel.x_limits, show_limits, gap=22))
        y_axes.append(_axis(index, title(panel.curves[0][0]), panel.y_limits, show_limits, gap=44))
        if height < _LOW:
            y_axes[-1]["splitNumber"] = 3  # the labels of more lines would cover each other
        if panel.x == "time_s":
            x_axes[-1] |= {"min": "dataMin", "max": "dataMax", "scale": True}
        lines = [{"yAxis": limit} for limit in panel.y_limits] + [{"xAxis": limit} for limit in panel.x_limits]
        for number, (column, colour, name) in enumerate(panel.curves):
            curve: dict[str, Any] = {
                "type": "line",
                "name": name,
                "xAxisIndex": index,
                "yAxisIndex": index,
                "encode": {"x": panel.x, "y": column},
                "showSymbol": False,
                "silent": True,
                "lineStyle": {"width": 1.5, "color": colour},
                "itemStyle": {"color": colour},
            }
            if number == 0 and lines:
                style = {"color": LIMIT, "type": "dashed", "width": 1}
                curve["markLine"] = {
                    "symbol": "none",
                    "silent": True,
                    "label": {"show": False},
                    "lineStyle": style,
                    "data": lines,
                }
            series.append(curve)
    narrow = [
        {"query": {"maxWidth": NARROW}, "option": {"grid": [_grid(place) for place in _stacked(panels)]}},
        {"option": {"grid": grids}},
    ]
    return {
        **({"media": narrow} if stacked_if_narrow else {}),
        "animation": False,
        # Without columns, ECharts does not know what kind of table it is.
        "dataset": {"source": dict(columns or {name: [] for panel in panels for name in (panel.x, panel.curves[0][0])})},
        "grid": grids,
        "xAxis": x_axes,
        "yAxis": y_axes,
        "series": series,
    }


def _grid(place: tuple[float, float, float, float]) -> dict[str, str]:
    return {name: f"{share:g}%" for name, share in zip(("left", "top", "width", "height"), place, strict=True)}


def _stacked(panels: Sequence[Panel]) -> list[tuple[float, float, float, float]]:
    """Return places beneath each other in percent, in the order of the panels; low plots stay lower than others."""
    shares = [min(max(panel.place[3], 12.0), 24.0) for panel in panels]
    scale = (100.0 - _LABELS * len(panels) - 1.0) / sum(shares)
    places, top = [], 1.0
    for share in shares:
        places.append((17.0, round(top, 2), 79.0, round(scale * share, 2)))
        top += scale * share + _LABELS
    return places


def _axis(index: int, name: str, limits: tuple[float, ...], show_limits: bool, gap: int) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "type": "value",
        "gridIndex": index,
        "name": name,
        "nameLocation": "middle",
        "nameGap": gap,
        "nameTextStyle": {"color": _AXIS},
        # The ends of an axis are no round numbers.
        "axisLabel": {"color": _AXIS, "hideOverlap": True, "showMinLabel": False, "showMaxLabel": False},
        "axisLine": {"lineStyle": {"color": _AXIS}},
        "splitLine": {"lineStyle": {"color": _GRID}},
        "scale": True,
    }
    if limits:
        margin = 0.06 * (max(limits) - min(limits))
        # Without None, a chart would keep the ends that it had.
        axis["min"] = min(limits) - margin if show_limits else None
        axis["max"] = max(limits) + margin if show_limits else None
    return axis


def legend(panels: Sequence[Panel]) -> None:
    """Show the names of the curves of plots that have several, and of their limits, in their colours."""
    names = {(colour, name): None for panel in panels if len(panel.curves) > 1 for _, colour, name in panel.curves}
    if any(panel.x_limits or panel.y_limits for panel in panels):
        names[LIMIT, "limits"] = None
    with ui.row().classes("gap-x-4 gap-y-0"):
        for colour, name in names:
            with ui.row().classes("items-center gap-1 no-wrap"):
                ui.icon("horizontal_rule").style(f"color: {colour}")
                ui.label(name).classes("text-sm")


def live_panels(limits: Limits, *, predicted: bool) -> list[Panel]:
    """Return the plots of the live page: over time force, position and current, then the two loops.

    Where a model ``predicted`` the force, its curve is over the measured one, and the residual is beneath.
    """
    force = (-limits.force, limits.force)
    reach = (-1e3 * limits.reach, 1e3 * limits.reach)
    speed = (-1e3 * limits.speed, 1e3 * limits.speed)
    current = (1e3 * limits.current_min, 1e3 * limits.current_max)
    both = [("force_N", MEASURED, "measured")]
    if predicted:
        both.append(("predicted_N", PREDICTED, "predicted"))
        over_time = [
            Panel("time_s", (8, 2, 40, 24), both, (), force),
            Panel("time_s", (8, 33, 40, 10), [("residual_N", RESIDUAL, "residual")]),
        ]
    else:
        over_time = [Panel("time_s", (8, 2, 40, 40), both, (), force)]
    return [
        *over_time,
        Panel("time_s", (8, 51, 40, 17), [("position_mm", MEASURED, "position")], (), reach),
        Panel("time_s", (8, 76, 40, 17), [("current_mA", MEASURED, "current")], (), current),
        Panel("velocity_mm_per_s", (58, 2, 40, 40), both, speed, force),
        Panel("position_mm", (58, 51, 40, 42), both, reach, force),
    ]


def hybrid_panels(limits: Limits) -> list[Panel]:
    """Return the plots of a hybrid test over time: motion, error of the rod, force and current."""
    reach = (-1e3 * limits.reach, 1e3 * limits.reach)
    motion = [("wanted_mm", PREDICTED, "wanted"), ("rod_mm", MEASURED, "rod")]
    current = [("commanded_mA", PREDICTED, "commanded"), ("current_mA", MEASURED, "measured")]
    return [
        Panel("time_s", (9, 3, 88, 25), motion, (), reach),
        Panel("time_s", (9, 36, 88, 11), [("error_mm", RESIDUAL, "rod minus wanted")]),
        Panel("time_s", (9, 55, 88, 14), [("force_N", MEASURED, "force")]),
        Panel("time_s", (9, 77, 88, 14), current),
    ]


# The browser asks for a frame once it has drawn the one before, so that a slow one never has frames waiting for it. Plots
# that stand still would look like a bench that stands still: why they do is said above them.
_PULL = """
(() => {
  let busy = false;
  let latest = '';
  window.mrdFrames = window.mrdFrames || 0;
  setInterval(async () => {
    // Under another tab of the page, the chart is not there; later it is there again.
    const chart = getElement(ID)?.chart;
    if (!chart || busy || document.hidden || !document.getElementById('cID')?.offsetParent) return;
    busy = true;
    let why = 'the server of the page does not answer';
    try {
      const answer = await fetch('ADDRESS', {signal: AbortSignal.timeout(5000)});
      if (answer.ok) {
        why = 'the latest frame cannot be drawn; please report this';
        const table = await answer.text();
        chart.setOption({dataset: {source: JSON.parse(table)}}, {lazyUpdate: false});
        // Counted is what shows anything new.
        if (table !== latest) window.mrdFrames += 1;
        latest = table;
        why = '';
      } else {
        why = await answer.text();
      }
    } catch (error) { /* said below */ }
    const said = document.getElementById('cSAID');
    if (said) said.textContent = why && `The plots stand still: ${why}. They go on by themselves once this is over.`;
    busy = false;
  }, PERIOD);
})();
"""


def fresh_chart(options: dict[str, Any], address: str, period: float) -> ui.echart:
    """Build a chart that draws the table at an address of the server every ``period`` s, and says above why it cannot."""
    said = ui.label().classes("text-sm text-negative").props("role=alert")
    plots = ui.echart(options).classes("w-full")
    script = _PULL.replace("SAID", str(said.id)).replace("ID", str(plots.id)).replace("ADDRESS", address)
    script = script.replace("PERIOD", str(int(1e3 * period)))
    ui.timer(0.1, lambda: ui.run_javascript(script), once=True)
    return plots
