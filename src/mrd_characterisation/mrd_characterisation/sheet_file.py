"""A sheet as files: sheet.html by a template, and sheet.pdf by a browser where there is one, else by Matplotlib."""

import os
import re
import shutil
import subprocess
import tempfile
import textwrap
from pathlib import Path
from typing import Any

import jinja2
import jinja2.sandbox

from mrd_base import InputError
from mrd_base.drawing import LINE_STYLES, draw
from mrd_base.text_file import read_text_file
from mrd_characterisation.sheet import Sheet

PAPERS = {"a4": ("A4", 210.0, 297.0), "letter": ("Letter", 215.9, 279.4)}
"""Name in CSS, width and height in mm."""

MARGIN = 10.0
"""mm."""

VERDICTS = {"pass": "PASSED", "fail": "FAILED", "not_decided": "NOT DECIDED", "": ""}
COLORS = {"pass": "#2e8b57", "fail": "#c62828", "not_decided": "#e69f00", "": "#cbd2d9"}

LONGEST_TEMPLATE = 2**20
"""Bytes."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")

FEWER_ROWS = (27, 24, 20, 16, 12, 9, 6, 3, 0)
"""Rows of the table that are tried in turn where the page does not hold all, as below a long head or legend."""

DRAWN_ROWS = 15
"""Rows of the table for which a sheet that Matplotlib draws has room."""

PATIENCE = 60.0
"""s that a browser may take to print a page; it takes about two."""

# Whatever a template asks for: nothing is loaded that is not in the page, and no script runs.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; font-src data:"

_PIXEL = 25.4 / 96.0  # mm

LOOK: dict[Any, Any] = {"font.size": 8.0, "pdf.fonttype": 42, "font.family": "DejaVu Sans", "text.parse_math": False}
"""Settings of Matplotlib."""

# Of a sheet that Matplotlib draws, in inches: its margin, room for the numbers of an axis, a line of text, the table.
EDGE, LEFT, LINE, TABLE = 0.45, 0.95, 0.16, 3.3


def write_sheet(sheet: Sheet, folder: str | Path, *, paper: str = "a4", template: str | Path | None = None) -> list[Path]:
    """Write sheet.html and sheet.pdf into ``folder`` and return their paths.

    Parameters
    ----------
    sheet : Sheet
    folder : path
    paper : str
        One of `PAPERS`.
    template : path, optional
        Jinja2 template of the page, which may extend ``sheet.html.j2``. It is sandboxed: it gets texts and drawings only.

    Raises
    ------
    InputError
        For an unknown paper, and for a template that cannot be used.
    """
    if paper not in PAPERS:
        raise InputError(f"--paper is {paper}, expected one of {', '.join(PAPERS)}")
    page, pdf = Path(folder) / "sheet.html", Path(folder) / "sheet.pdf"
    content = render_sheet(sheet, paper, template).encode()
    with tempfile.TemporaryDirectory() as scratch:
        source, printed = Path(scratch) / "sheet.html", Path(scratch) / "sheet.pdf"
        source.write_bytes(content)
        if _print_by_browser(source, printed):
            document = printed.read_bytes()
            fewer = [] if _pages(document) == 1 else [rows for rows in FEWER_ROWS if rows < len(sheet.rows)]
            for rows in fewer:
                shorter = render_sheet(sheet.shortened(rows), paper, template).encode()
                source.write_bytes(shorter)
                if _print_by_browser(source, printed) and _pages(printed.read_bytes()) == 1:
                    content, document = shorter, printed.read_bytes()
                    break
        else:
            _print_by_matplotlib(sheet, paper, printed)
            document = printed.read_bytes()
    _replace(page, content)
    _replace(pdf, document)
    return [page, pdf]


def _pages(pdf: bytes) -> int:
    """Return the number of pages of a PDF that a browser has printed."""
    return len(re.findall(rb"/Type ?/Page\b", pdf))


def _replace(path: Path, content: bytes) -> None:
    """Write a file that is complete or absent."""
    partial = path.with_name(f"{path.name}.part")
    partial.write_bytes(content)
    partial.replace(path)


def render_sheet(sheet: Sheet, paper: str = "a4", template: str | Path | None = None) -> str:
    """Return the page of a sheet; see `write_sheet`."""
    css, width, _ = PAPERS[paper]
    environment = jinja2.sandbox.ImmutableSandboxedEnvironment(
        loader=jinja2.PackageLoader("mrd_characterisation"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    room = width - 2.0 * MARGIN
    pixels = room / _PIXEL
    content: dict[str, Any] = {
        "serial": sheet.serial,
        "fields": list(sheet.fields),
        "verdict": sheet.verdict,
        "verdict_word": VERDICTS[sheet.verdict],
        "sentence": sheet.sentence,
        "plots": [draw(plot, pixels if place == 0 else 0.5 * pixels - 4.0) for place, plot in enumerate(sheet.plots)],
        "head": list(sheet.head),
        "rows": [list(row) for row in sheet.rows],
        "more": sheet.more,
        "logo": sheet.logo,
        "footer": sheet.footer,
        "paper": css,
        "width": f"{room:g}",
    }
    if template is None:
        page = environment.get_template("sheet.html.j2").render(content)
    else:
        text = read_text_file(Path(template), "a template of a sheet", LONGEST_TEMPLATE)
        try:
            page = environment.from_string(text).render(content)
        # A template may fail in any way: by syntax, a name that does not exist, what is forbidden, an error of its own.
        except Exception as error:
            line = f" line {error.lineno}:" if isinstance(error, jinja2.TemplateSyntaxError) else ""
            problem = " ".join(str(error).split())
            raise InputError(f"{template}:{line} {problem}; expected a Jinja2 template of {', '.join(content)}") from None
    # The policy has to come before all else, since it does not bind what stands before it.
    begin = re.match(r"\s*<!doctype html>", page, re.IGNORECASE)
    if begin is None:
        raise InputError(f"{template}: makes no page that begins with <!doctype html>; write one, or extend sheet.html.j2")
    return f'{begin.group()}\n<meta http-equiv="Content-Security-Policy" content="{_POLICY}">{page[begin.end() :]}'


def _print_by_browser(page: Path, pdf: Path) -> bool:
    """Print a page by a browser without network; return whether there was one that could."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        return False
    options = [
        "--headless",
        "--disable-gpu",
        # No name is resolved, and what needs none goes to a port where nothing listens.
        "--host-resolver-rules=MAP * ~NOTFOUND",
        "--proxy-server=http://127.0.0.1:9",
        "--proxy-bypass-list=<-loopback>",
        "--disable-background-networking",
        "--no-first-run",
        "--no-pdf-header-footer",
        f"--user-data-dir={pdf.parent / 'profile'}",
        f"--print-to-pdf={pdf}",
    ]
    # The browser's own sandbox refuses to run for root, as in a container.
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--no-sandbox")
    try:
        command = [browser, *options, page.resolve().as_uri()]
        done = subprocess.run(command, capture_output=True, timeout=PATIENCE, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0 and pdf.exists() and pdf.stat().st_size > 0


def _print_by_matplotlib(sheet: Sheet, paper: str, pdf: Path) -> None:
    """Draw the same content as a PDF; the template and the logo count for the page only."""
    # Matplotlib is slow to import, and a browser is the usual way.
    import matplotlib as mpl

    with mpl.rc_context(LOOK):
        draw_sheet(sheet, paper).savefig(pdf, format="pdf")


def draw_sheet(sheet: Sheet, paper: str) -> Any:
    """Return a sheet as a figure of Matplotlib."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.figure import Figure

    sheet = sheet.shortened(DRAWN_ROWS)
    _, *sides = PAPERS[paper]
    width, height = (side / 25.4 for side in sides)
    figure = Figure(figsize=(width, height))
    FigureCanvasPdf(figure)
    top = _draw_head(figure, sheet, width, height)
    columns, names = _legend(sheet)
    top -= LINE * -(-names // columns)
    # Above the table the first plot has the upper half, the two others have the lower one; beneath each are four lines.
    bottom = TABLE + 4 * LINE
    half, across = 0.5 * (top - bottom), 0.5 * (width - LEFT - EDGE)
    places = (
        (LEFT, bottom + half, 2 * across, half - LINE),
        (LEFT, bottom, across - LEFT, half - 4 * LINE),
        (LEFT + across, bottom, across, half - 4 * LINE),
    )
    for place, plot in zip(places, sheet.plots, strict=True):
        axes = figure.add_axes((place[0] / width, place[1] / height, place[2] / width, place[3] / height))
        _draw_plot(axes, plot)
        if plot is sheet.plots[0] and names:
            axes.legend(fontsize=6, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)
    edges = (EDGE / width, 0.0, (width - 2 * EDGE) / width, TABLE / height)
    _draw_table(figure.add_axes(edges), sheet, EDGE / TABLE)
    return figure


def _draw_plot(axes: Any, plot: Any) -> None:
    for trace in plot.data:
        dash = LINE_STYLES[trace.line.dash or "solid"]
        marker = "o" if "markers" in trace.mode else ""
        label = None if trace.showlegend is False else trace.name
        style = {"color": trace.line.color, "marker": marker, "markersize": 3, "linewidth": 1.2}
        x, y = ([float("nan") if value is None else value for value in series] for series in (trace.x, trace.y))
        axes.plot(x, y, dash, label=label, **style)
    axes.set_xlabel(plot.layout.xaxis.title.text)
    axes.set_ylabel(plot.layout.yaxis.title.text)
    axes.grid(color="#e4e7eb")


def _legend(sheet: Sheet) -> tuple[int, int]:
    """Return the columns of the legend that have room beside each other, and the number of its names."""
    names = [trace.name for trace in sheet.plots[0].data if trace.showlegend is not False]
    return max(1, 130 // (max(map(len, names), default=1) + 10)), len(names)


def _draw_head(figure: Any, sheet: Sheet, width: float, height: float) -> float:
    """Write serial number, fields and verdict; return the height in inches that is left beneath."""
    top = height - EDGE
    fields = "    ".join(f"{name}: {text}" for name, text in sheet.fields)
    word = VERDICTS[sheet.verdict]
    indent = 1.6 if word else 0.0
    figure.text(EDGE / width, top / height, sheet.serial, va="top", fontweight="bold", fontsize=_serial_size(sheet))
    top -= 1.8 * _serial_size(sheet) / 72.0
    for text, most, shift in ((fields, 120, 0.0), (sheet.sentence, 95, indent)):
        lines = textwrap.wrap(text, most)
        figure.text((EDGE + shift) / width, top / height, "\n".join(lines), va="top")
        if shift:
            colour = COLORS[sheet.verdict]
            figure.text(EDGE / width, top / height, word, va="top", fontsize=13.0, fontweight="bold", color=colour)
        top -= LINE * (max(len(lines), 2 if shift else 1) + 0.5)
    return top


def _serial_size(sheet: Sheet) -> float:
    return 16.0 if len(sheet.serial) <= 40 else 8.5


def _draw_table(axes: Any, sheet: Sheet, foot: float) -> None:
    axes.axis("off")
    axes.text(0.0, foot, f"{sheet.more} {sheet.footer}.".strip(), fontsize=6, va="top")
    if not sheet.rows:
        return
    longest = [max(len(cell) for cell in column) for column in zip(sheet.head, *sheet.rows, strict=True)]
    widths = [length / sum(longest) for length in longest]
    look: dict[str, Any] = {"loc": "upper left", "cellLoc": "left", "colLoc": "left", "edges": "horizontal"}
    table = axes.table(cellText=sheet.rows, colLabels=sheet.head, colWidths=widths, **look)
    table.auto_set_font_size(False)
    table.set_fontsize(6 if sum(longest) < 150 else 5)
