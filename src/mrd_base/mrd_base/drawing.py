"""Drawing of Plotly figures as SVG, for pages that are small, need no script and print sharply.

Plotly itself draws in a browser only and adds 4.7 MB to a page. A figure is therefore described once, as a Plotly figure,
which a notebook shows with zoom and values under the pointer, and is drawn by Matplotlib where it goes into a page. What
the figures of this workspace use can be drawn: scatter, bar and heatmap traces with error bars, fills, annotations and lines
across, on linear, logarithmic, categorical and date axes.
"""

import hashlib
import html
import io
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

Array = NDArray[np.float64]

INK, SOFT, LINE = "#010203", "#040506", "#070809"
"""Colours that stand for those of the page, which are dark on light or light on dark."""
_OF_PAGE = {
    INK: "var(--ink)",
    SOFT: "var(--soft)",
    LINE: "var(--line)",
    "#616e7c": "var(--soft)",
    "#52606d": "var(--soft)",
    "#d5dbe1": "var(--empty)",
}

FONT_SIZE = 13.0
CHARACTER = 0.56
"""Width of a character, relative to the size of the font."""
LEGEND_ROW = 18.0
"""Height of a row of the legend in pixels."""
COLORS = ("#00798c", "#d1495b", "#edae49", "#66a182", "#8d6a9f", "#2e4057")

LINE_STYLES = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}
"""Line styles of Matplotlib by the dashes of Plotly."""
_SYMBOLS = {
    "circle": "o",
    "circle-open": "o",
    "diamond": "D",
    "square": "s",
    "cross": "P",
    "x": "X",
    "star": "*",
    "triangle-up": "^",
    "line-ns": "|",
}


def draw(figure: go.Figure, width: float) -> str:
    """Draw a figure as an SVG element.

    Parameters
    ----------
    figure : plotly.graph_objects.Figure
    width : float
        Of the drawing in CSS pixels, at which its text has the size of the page's text. The height is that of the figure.

    Returns
    -------
    str
        The same for the same figure.

    Raises
    ------
    ValueError
        For a kind of trace that cannot be drawn.
    """
    # Matplotlib is slow to import, and only pages need it.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    layout = figure.layout.to_plotly_json()
    traces = [trace.to_plotly_json() for trace in figure.data]
    # Names of shapes in a drawing are hashes. Each drawing of a page has its own.
    salt = hashlib.sha1(f"{width} {figure.to_json()}".encode()).hexdigest()
    settings: dict[Any, Any] = {
        "svg.fonttype": "none",
        "svg.hashsalt": salt,
        "text.parse_math": False,
        "path.simplify": True,
        "path.simplify_threshold": 0.25,
        "axes.unicode_minus": True,
        "font.family": "DejaVu Sans",
        "font.size": FONT_SIZE,
        "axes.edgecolor": LINE,
        "axes.facecolor": layout.get("plot_bgcolor", "none"),
        "text.color": INK,
        "axes.labelcolor": INK,
        "xtick.labelcolor": INK,
        "ytick.labelcolor": INK,
        "xtick.color": LINE,
        "ytick.color": LINE,
    }
    with mpl.rc_context(settings):
        canvas = Figure(figsize=(width / 72, layout["height"] / 72), dpi=72, layout="constrained", facecolor="none")
        _Drawing(canvas, traces, layout, width).draw()
        written = io.StringIO()
        canvas.savefig(
            written, format="svg", dpi=144, metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    return _for_page(written.getvalue())


def _for_page(svg: str) -> str:
    """Return an SVG file as an element that takes the width of its place and the colours of the page."""
    svg = svg[svg.index("<svg") :].strip()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg).replace("xlink:", "")  # a page needs no namespaces
    svg = re.sub(r' (width|height)="[\d.]+pt"', "", svg, count=2)
    # Groups need no names, several drawings of a page would share them, and the page has its own font.
    svg = re.sub(r'<g id="[^"]*"/>', "", svg)
    svg = _without_plain_groups(re.sub(r'<g id="[^"]*">', "<g>", svg))
    svg = re.sub(r' transform="rotate\(-0 [^)]*\)"', "", svg).replace("font-family: 'DejaVu Sans'; ", "")
    # Places are written to a hundredth of a pixel; numbers in texts, which stand between the tags, are not touched.
    svg = re.sub(r"<[^>]*>", lambda tag: re.sub(r"(\.\d\d)\d+", r"\1", tag.group()), svg)
    svg = re.sub(r' d="([^"]*)"', lambda line: f' d="{_shortened(line.group(1))}"', svg)
    svg = re.sub(r"\s*\n\s*", "\n", svg)
    for colour, of_page in _OF_PAGE.items():
        svg = svg.replace(colour, of_page)
    return svg


def _without_plain_groups(svg: str) -> str:
    """Return an SVG without the tags of groups that have no attributes: they are a twentieth of a small drawing."""
    opened: list[str] = []

    def kept(tag: re.Match[str]) -> str:
        if tag.group() != "</g>":
            opened.append("" if tag.group() == "<g>" else tag.group())
            return opened[-1]
        return opened.pop() and "</g>"

    return re.sub(r"<g\b[^>]*(?<!/)>|</g>", kept, svg)


def _shortened(path: str) -> str:
    """Return a path to a tenth of a pixel; one of straight lines with the steps between its points, which are short."""
    words = path.split()
    if set(re.findall("[A-Za-z]", path)) - {"M", "L", "z"}:
        return re.sub(r"(\.\d)\d", r"\1", path)
    written, before, last = [], "", (0, 0)
    for command, x, y in zip(words, words[1:], words[2:], strict=False):
        if command not in ("M", "L"):
            continue
        point = round(10 * float(x)), round(10 * float(y))
        start = (0, 0) if command == "M" else last
        sign = "M" if command == "M" else "l" if before != "L" else " "  # a step after a step needs none
        written.append(f"{sign}{(point[0] - start[0]) / 10:g} {(point[1] - start[1]) / 10:g}")
        before, last = command, point
    # Numbers begin with their point, and a minus parts them as a space does.
    text = re.sub(r"(?<![\d.])0\.", ".", "".join(written)).replace(" -", "-")
    return text + "z" * (words[-1:] == ["z"])


class _Panel:
    """Axes of a figure with the categories of its axes."""

    def __init__(self, axes: Any, x: dict[str, Any], y: dict[str, Any]) -> None:
        self.axes = axes
        self.layout = {"x": x, "y": y}
        self.categories: dict[str, list[str]] = {"x": [], "y": []}

    def place(self, values: Any, axis: str) -> Any:
        """Return where values of a trace stand on an axis: numbers, dates, or the places of categories."""
        listed = [values] if isinstance(values, str) or np.ndim(values) == 0 else list(values)
        if not any(isinstance(value, str) for value in listed):
            return np.array([np.nan if value is None else value for value in listed], dtype=float)
        if all(re.match(r"\d{4}-\d\d-\d\d", value) for value in listed):
            return np.array(listed, dtype="datetime64[us]")
        names = self.categories[axis]
        names.extend(name for name in dict.fromkeys(listed) if name not in names)
        return np.array([names.index(name) for name in listed], dtype=float)


class _Drawing:
    """A drawing in the making."""

    def __init__(self, canvas: Any, traces: list[dict[str, Any]], layout: dict[str, Any], width: float) -> None:
        self.canvas, self.traces, self.layout, self.width = canvas, traces, layout, width
        self.legend: dict[str, Any] = {}
        self.panels = self._make_panels()

    def draw(self) -> None:
        """Draw everything; what is laid out by the size of other things comes last."""
        for index, trace in enumerate(self.traces):
            kind = trace.get("type", "scatter")
            drawn: dict[str, Callable[[_Panel, dict[str, Any], int], None]] = {
                "scatter": self._scatter,
                "bar": self._bar,
                "heatmap": self._heatmap,
            }
            if kind not in drawn:
                raise ValueError(f"trace {kind}: expected one of {', '.join(drawn)}")
            drawn[kind](self._panel_of(trace), trace, index)
        for panel in self.panels.values():
            self._finish_axis(panel, "x")
            self._finish_axis(panel, "y")
        for shape in self.layout.get("shapes", ()):
            self._line_across(shape)
        for annotation in self.layout.get("annotations", ()):
            self._annotation(annotation)
        title = (self.layout.get("title") or {}).get("text")
        if title:
            next(iter(self.panels.values())).axes.set_title(_plain(title), loc="left", fontsize=15)
        self._legend()

    def _make_panels(self) -> dict[tuple[str, str], _Panel]:
        """Make the axes of each pair of axes that the traces use, in a grid of the rows and columns of the figure."""
        pairs = list(dict.fromkeys((t.get("xaxis") or "x", t.get("yaxis") or "y") for t in self.traces)) or [("x", "y")]
        domains = {name: self._domain(name) for pair in pairs for name in pair}
        columns = sorted({domains[x] for x, _ in pairs})
        rows = sorted({domains[y] for _, y in pairs}, reverse=True)
        grid = self.canvas.add_gridspec(
            len(rows), len(columns), height_ratios=[b - a for a, b in rows], width_ratios=[b - a for a, b in columns]
        )
        panels: dict[tuple[str, str], _Panel] = {}
        for x, y in pairs:
            axes = self.canvas.add_subplot(grid[rows.index(domains[y]), columns.index(domains[x])])
            panels[x, y] = _Panel(axes, self._axis_layout(x), self._axis_layout(y))
            matched = self._axis_layout(x).get("matches")
            other = next((p for (name, _), p in panels.items() if name == matched and name != x), None)
            if other is not None:
                axes.sharex(other.axes)
        return panels

    def _axis_layout(self, name: str) -> dict[str, Any]:
        found: dict[str, Any] = self.layout.get(f"{name[0]}axis{name[1:]}") or {}
        return found

    def _domain(self, name: str) -> tuple[float, float]:
        low, high = self._axis_layout(name).get("domain") or (0.0, 1.0)
        return float(low), float(high)

    def _panel_of(self, trace: dict[str, Any]) -> _Panel:
        return self.panels[trace.get("xaxis") or "x", trace.get("yaxis") or "y"]

    def _in_legend(self, trace: dict[str, Any], handle: Any) -> None:
        name = trace.get("name")
        if name and trace.get("showlegend") is not False:
            self.legend.setdefault(_plain(name), handle)

    def _scatter(self, panel: _Panel, trace: dict[str, Any], index: int) -> None:
        x, y = panel.place(trace.get("x"), "x"), panel.place(trace.get("y"), "y")
        mode = trace.get("mode") or "lines"
        line, marker = trace.get("line") or {}, trace.get("marker") or {}
        colour = _colour(line.get("color") or _first(marker.get("color")) or COLORS[index % len(COLORS)])
        if trace.get("fill"):
            handle = self._fill(panel, trace, index, x, y)
            self._in_legend(trace, handle)
            if line.get("width") == 0:
                return
        self._error_bars(panel, trace, x, y, colour)
        width = line.get("width", 2.0) if "lines" in mode else 0.0
        style: dict[str, Any] = {
            "linewidth": width,
            "linestyle": LINE_STYLES[line.get("dash", "solid")] if width else "none",
        }
        style["drawstyle"] = "steps-post" if line.get("shape") == "hv" else "default"
        (drawn,) = panel.axes.plot(x, y, color=colour, solid_joinstyle="round", **style)
        handle = drawn
        if "markers" in mode:
            handle = self._markers(panel, marker, x, y, colour, width)
        if width or "markers" in mode:
            self._in_legend(trace, handle)

    def _markers(self, panel: _Panel, marker: dict[str, Any], x: Any, y: Any, colour: str, width: float) -> Any:
        symbol = marker.get("symbol") or "circle"
        count = len(x)
        colours = [_colour(c or colour) for c in _each(marker.get("color"), count)]
        sizes = np.array([float(s or 6.0) for s in _each(marker.get("size"), count)])
        edge = marker.get("line") or {}
        hollow = symbol.endswith("-open")
        thin = symbol == "line-ns"
        panel.axes.scatter(
            x,
            y,
            s=sizes**2 * (1.6 if symbol == "star" else 1.0),
            marker=_SYMBOLS[symbol],
            # A thin mark is all edge; Matplotlib draws it in the colour of faces.
            facecolors="none" if hollow else _colour(edge["color"]) if thin and edge.get("color") else colours,
            edgecolors=None if thin else _colour(edge["color"]) if edge.get("color") else colours,
            linewidths=edge.get("width", 1.0 if hollow else 0.0),
            zorder=3,
        )
        from matplotlib.lines import Line2D

        shown = _colour(edge["color"]) if thin and edge.get("color") else (colours or [colour])[0]
        return Line2D(
            [],
            [],
            color=colour,
            linewidth=width,
            marker=_SYMBOLS[symbol],
            markersize=min(float(sizes.max(initial=6.0)), 10.0),
            markerfacecolor="none" if hollow else shown,
            markeredgecolor=shown,
        )

    def _fill(self, panel: _Panel, trace: dict[str, Any], index: int, x: Any, y: Any) -> Any:
        colour = _colour(trace.get("fillcolor") or COLORS[index % len(COLORS)])
        if trace["fill"] == "toself":
            return panel.axes.fill(x, y, facecolor=colour, linewidth=0)[0]
        lower = panel.place(self.traces[index - 1]["y"], "y")
        return panel.axes.fill_between(x, lower, y, facecolor=colour, linewidth=0)

    def _bar(self, panel: _Panel, trace: dict[str, Any], index: int) -> None:
        x, y = panel.place(trace.get("x"), "x"), panel.place(trace.get("y"), "y")
        lying = trace.get("orientation") == "h"
        places, lengths = (y, x) if lying else (x, y)
        colours = [
            _colour(c or COLORS[index % len(COLORS)]) for c in _each((trace.get("marker") or {}).get("color"), len(places))
        ]
        steps = np.diff(np.sort(places))
        thickness = trace.get("width") or (1 - self.layout.get("bargap", 0.2)) * (float(steps.min()) if len(steps) else 1.0)
        if lying:
            drawn = panel.axes.barh(places, lengths, height=thickness, color=colours, zorder=2)
        else:
            drawn = panel.axes.bar(places, lengths, width=thickness, color=colours, zorder=2)
        self._error_bars(panel, trace, x, y, SOFT)
        self._in_legend(trace, drawn)

    def _error_bars(self, panel: _Panel, trace: dict[str, Any], x: Any, y: Any, colour: str) -> None:
        for axis in "xy":
            bars = trace.get(f"error_{axis}") or {}
            if bars.get("array") is None:
                continue
            above = np.array([np.nan if b is None else b for b in bars["array"]], dtype=float)
            below = bars.get("arrayminus")
            below = above if below is None else np.array([np.nan if b is None else b for b in below], dtype=float)
            ends = np.maximum(np.nan_to_num([below, above]), 0.0)
            panel.axes.errorbar(
                x,
                y,
                **{f"{axis}err": ends},
                fmt="none",
                ecolor=_colour(bars.get("color") or colour),
                elinewidth=bars.get("thickness", 1.4),
                capsize=bars.get("width", 4),
                capthick=bars.get("thickness", 1.4),
                zorder=2.5,
            )

    def _heatmap(self, panel: _Panel, trace: dict[str, Any], index: int) -> None:
        from matplotlib.colors import LinearSegmentedColormap

        values = np.ma.masked_invalid(np.array(trace["z"], dtype=float))
        x, y = (_edges(panel.place(trace[axis], axis), size) for axis, size in zip("xy", values.shape[::-1], strict=True))
        common = self.layout.get("coloraxis") or {} if trace.get("coloraxis") else {}
        scale = common.get("colorscale") or trace["colorscale"]
        colours = LinearSegmentedColormap.from_list("scale", [(float(at), _colour(colour)) for at, colour in scale])
        low, high = (common.get("cmin"), common.get("cmax")) if common else (trace.get("zmin"), trace.get("zmax"))
        drawn = panel.axes.pcolormesh(x, y, values, cmap=colours, vmin=low, vmax=high, rasterized=True)
        panel.axes.set_axisbelow(False)
        if index + 1 == len(self.traces):
            bar = common.get("colorbar") or trace.get("colorbar") or {}
            axes = [other.axes for other in self.panels.values()]
            legend = self.canvas.colorbar(drawn, ax=axes, aspect=30, pad=0.03, fraction=0.06)
            legend.outline.set_visible(False)
            legend.ax.tick_params(length=0, labelsize=11)
            legend.set_label(_plain((bar.get("title") or {}).get("text") or ""), fontsize=12)
            if bar.get("tickvals") is not None:
                legend.set_ticks(bar["tickvals"], labels=list(bar["ticktext"]))

    def _finish_axis(self, panel: _Panel, axis: str) -> None:
        from matplotlib.dates import AutoDateFormatter, AutoDateLocator
        from matplotlib.ticker import FuncFormatter, MaxNLocator

        layout, axes = panel.layout[axis], panel.axes
        side = axes.xaxis if axis == "x" else axes.yaxis
        limits = axes.set_xlim if axis == "x" else axes.set_ylim
        for name in ("top", "right", "left", "bottom"):
            axes.spines[name].set_visible(False)
        axes.tick_params(length=0)
        if title := (layout.get("title") or {}).get("text"):
            side.set_label_text(_plain(title))
        gridded = layout.get("showgrid", True) and not any(t.get("type") == "heatmap" for t in self.traces)
        if gridded:
            axes.grid(axis=axis, color=LINE, linewidth=1)
        axes.set_axisbelow(True)
        if layout.get("type") == "log":
            (axes.set_xscale if axis == "x" else axes.set_yscale)("log")
        places = {self._domain(pair["xy".index(axis)]) for pair in self.panels}
        pixels = (self.width if axis == "x" else self.layout["height"]) / len(places)
        if axis == "x":
            lines = [line for name in panel.categories["y"] for line in _plain(name).split("\n")]
            pixels -= CHARACTER * FONT_SIZE * max(map(len, lines), default=6)
        categories = panel.categories[axis]
        if categories:
            side.set_ticks(range(len(categories)), labels=[_plain(name) for name in categories])
            limits(-0.5, len(categories) - 0.5)
        elif layout.get("tickvals") is not None:
            labels = layout.get("ticktext")
            kept = _thinned(layout["tickvals"], layout.get("range"), pixels / 60 if axis == "x" else np.inf)
            side.set_ticks([layout["tickvals"][i] for i in kept], labels=labels and [labels[i] for i in kept])
        elif layout.get("type") != "log" and side.get_converter() is None:
            most = min(layout.get("nticks") or 7, max(3, int(pixels / (70 if axis == "x" else 45))))
            side.set_major_locator(MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]))
            side.get_major_formatter().set_useOffset(False)  # a summand beside the axis would run into its title
        elif side.get_converter() is not None:
            locator = AutoDateLocator(minticks=2, maxticks=max(5, int(pixels / 90)))
            side.set_major_locator(locator)
            side.set_major_formatter(AutoDateFormatter(locator))
        if form := layout.get("tickformat"):
            side.set_major_formatter(FuncFormatter(_tick_formats(form)))
        if layout.get("range") is not None:
            ends = np.array(layout["range"], dtype=float)
            limits(*(10**ends if layout.get("type") == "log" else ends))
        elif layout.get("rangemode") == "tozero":
            limits(0.0, None)
        if layout.get("autorange") == "reversed":
            limits(*reversed(axes.get_xlim() if axis == "x" else axes.get_ylim()))
        if layout.get("showticklabels") is False:
            axes.tick_params(axis=axis, labelleft=False, labelbottom=False)
        if angle := layout.get("tickangle"):
            for label in side.get_ticklabels():
                label.set(rotation=-angle, ha="left" if angle > 0 else "right", va="center", rotation_mode="anchor")

    def _line_across(self, shape: dict[str, Any]) -> None:
        panel = self.panels.get((_reference(shape, "x"), _reference(shape, "y"))) or next(iter(self.panels.values()))
        axes, line = panel.axes, shape.get("line") or {}
        style = {"color": _colour(line.get("color", SOFT)), "linestyle": LINE_STYLES[line.get("dash", "solid")]}
        if shape["x0"] == shape["x1"]:
            place = shape["x0"]
            axes.axvline(np.datetime64(place) if isinstance(place, str) else place, **style)
        else:
            axes.axhline(shape["y0"], **style)

    def _annotation(self, note: dict[str, Any]) -> None:
        font = note.get("font") or {}
        bold = note["text"].startswith("<b>")
        style = {"color": _colour(font.get("color", INK)), "fontsize": font.get("size", FONT_SIZE)}
        in_paper = note.get("xref", "paper") == "paper" and note.get("yref", "paper") == "paper"
        if in_paper and note.get("yanchor") == "bottom" and 0.0 <= float(note["x"]) <= 1.0:
            panel = self._panel_below(float(note["x"]), float(note["y"]))
            panel.axes.set_title(_plain(note["text"]), loc=note.get("xanchor", "center"), pad=4, **style)
            return
        panel = self.panels.get((_reference(note, "x"), _reference(note, "y"))) or next(iter(self.panels.values()))
        x, y = (
            float(note[axis]) if note.get(f"{axis}ref") == "paper" else panel.place(note[axis], axis)[0] for axis in "xy"
        )
        anchors = {"horizontalalignment": note.get("xanchor", "center"), "verticalalignment": note.get("yanchor", "center")}
        anchors = {name: {"middle": "center", "auto": "center"}.get(anchor, anchor) for name, anchor in anchors.items()}
        frame = tuple(
            "axes fraction" if note.get(f"{axis}ref", "").endswith(("paper", "domain")) else "data" for axis in "xy"
        )
        weight = "bold" if bold else "normal"
        panel.axes.annotate(_plain(note["text"]), (x, y), xycoords=frame, weight=weight, **anchors, **style)

    def _panel_below(self, x: float, y: float) -> _Panel:
        """Return the panel whose upper edge is at ``y`` and that contains ``x``, in shares of the figure."""

        def distance(pair: tuple[str, str]) -> float:
            left, right = self._domain(pair[0])
            return abs(self._domain(pair[1])[1] - y) + max(left - x, 0.0, x - right)

        return self.panels[min(self.panels, key=distance)]

    def _legend(self) -> None:
        shown = self.layout.get("showlegend")
        if not self.legend or shown is False or (shown is None and len(self.legend) < 2):
            return
        layout = self.layout.get("legend") or {}
        widths = [len(name) * CHARACTER * FONT_SIZE + 45 for name in self.legend]
        longest, fitting = max(widths), sum(widths) < self.width
        beside = layout.get("orientation") == "v" and self.width > 3 * longest
        side = "right" if layout.get("xanchor", "right") == "right" else "left"
        columns = 1 if beside else len(widths) if fitting else max(1, int(self.width / longest))
        if not beside:
            # The height of a figure has room for one row of the legend; what needs more takes it from no diagram.
            more = math.ceil(len(widths) / columns) - 1
            self.canvas.set_figheight(self.canvas.get_figheight() + more * LEGEND_ROW / 72)
        self.canvas.legend(
            self.legend.values(),
            self.legend.keys(),
            loc="outside right upper" if beside else f"outside upper {side}",
            ncols=columns,
            frameon=False,
            fontsize=12,
            handlelength=1.6,
            columnspacing=1.4,
        )


def _first(values: Any) -> Any:
    return values if isinstance(values, str) or values is None else next(iter(values), None)


def _each(value: Any, count: int) -> Sequence[Any]:
    """Return one value for each of ``count`` points."""
    return [value] * count if isinstance(value, str | int | float) or value is None else list(value)


def _colour(text: str) -> Any:
    """Return a CSS colour as Matplotlib has it."""
    if numbers := re.match(r"rgba?\(([^)]*)\)", text):
        parts = [float(part) for part in numbers.group(1).split(",")]
        return (*(part / 255 for part in parts[:3]), *(parts[3:] or [1.0]))
    return text


def _edges(places: Array, cells: int) -> Array:
    """Return the edges of ``cells`` cells, of which the edges or the middles are given."""
    if len(places) == cells + 1:
        return places
    middles = 0.5 * (places[1:] + places[:-1])
    half = 0.5 * (places[1] - places[0]) if cells > 1 else 0.5
    return np.concatenate([[places[0] - half], middles, [places[-1] + half]])


def _thinned(ticks: Sequence[float], ends: Sequence[float] | None, most: float) -> range:
    """Return which ticks are shown, so that at most ``most`` are between the ends of the axis, and zero among them."""
    shown = sum(ends[0] <= tick <= ends[1] for tick in ticks) if ends is not None else len(ticks)
    step = max(1, int(np.ceil(shown / most)))
    return range(list(ticks).index(0) % step if 0 in ticks else 0, len(ticks), step)


def _reference(note: dict[str, Any], axis: str) -> str:
    name = str(note.get(f"{axis}ref", axis)).split(" ")[0]
    return axis if name == "paper" else name


def _plain(text: str) -> str:
    """Return the text of a label of Plotly, which may have tags."""
    return html.unescape(re.sub(r"<[^>]*>", "", text.replace("<br>", "\n")))


def _tick_formats(form: str) -> Callable[[float, int], str]:
    """Return the function for a format of ticks: shares in per cent, or with three figures."""
    digits = {".0%": "{:.0f} %", ".3~p": "{:.3g} %"}[form]
    return lambda value, _place: digits.format(100 * value + 0.0).replace("-", "\u2212")
