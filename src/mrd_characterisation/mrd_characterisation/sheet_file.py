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
from mrd_base.drawing import draw
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

PATIENCE = 60.0
"""s that a browser may take to print a page; it takes about two."""

# Whatever a template asks for: nothing is loaded that is not in the page, and no script runs.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; font-src data:"

_PIXEL = 25.4 / 96.0  # mm


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
    _replace(page, render_sheet(sheet, paper, template).encode())
    with tempfile.TemporaryDirectory() as scratch:
        printed = Path(scratch) / "sheet.pdf"
        if not _print_by_browser(page, printed):
            _print_by_matplotlib(sheet, paper, printed)
        _replace(pdf, printed.read_bytes())
    return [page, pdf]


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
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.figure import Figure

    _, width, height = PAPERS[paper]
    with mpl.rc_context({"font.size": 8.0, "pdf.fonttype": 42, "font.family": "DejaVu Sans", "text.parse_math": False}):
        figure = Figure(figsize=(width / 25.4, height / 25.4))
        FigureCanvasPdf(figure)
        edges = {"left": 0.1, "right": 0.96, "top": 0.97, "bottom": 0.03}
        grid = figure.add_gridspec(4, 2, height_ratios=(2.4, 5.0, 4.6, 7.5), hspace=0.35, wspace=0.3, **edges)
        _draw_head(figure.add_subplot(grid[0, :]), sheet)
        for place, plot in zip((grid[1, :], grid[2, 0], grid[2, 1]), sheet.plots, strict=True):
            axes = figure.add_subplot(place)
            for trace in plot.data:
                dash = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}[trace.line.dash or "solid"]
                marker = "o" if "markers" in trace.mode else ""
                label = trace.name if trace.showlegend else None
                style = {"color": trace.line.color, "marker": marker, "markersize": 3, "linewidth": 1.2}
                axes.plot(trace.x, trace.y, dash, label=label, **style)
            axes.set_xlabel(plot.layout.xaxis.title.text)
            axes.set_ylabel(plot.layout.yaxis.title.text)
            axes.grid(color="#e4e7eb")
            if any(trace.showlegend for trace in plot.data):
                axes.legend(fontsize=6, frameon=False)
        _draw_table(figure.add_subplot(grid[3, :]), sheet)
        figure.savefig(pdf, format="pdf")


def _draw_head(axes: Any, sheet: Sheet) -> None:
    axes.axis("off")
    axes.text(0.0, 1.0, sheet.serial, fontsize=16, fontweight="bold", va="top")
    lines = textwrap.wrap("    ".join(f"{name}: {text}" for name, text in sheet.fields), 120)
    axes.text(0.0, 0.62, "\n".join(lines), va="top")
    axes.text(0.0, 0.0, VERDICTS[sheet.verdict], fontsize=13, fontweight="bold", color=COLORS[sheet.verdict], va="bottom")
    sentence = "\n".join(textwrap.wrap(sheet.sentence, 90))
    axes.text(0.2 if sheet.verdict else 0.0, 0.0, sentence, va="bottom")


def _draw_table(axes: Any, sheet: Sheet) -> None:
    axes.axis("off")
    if not sheet.rows:
        return
    longest = [max(len(cell) for cell in column) for column in zip(sheet.head, *sheet.rows, strict=True)]
    widths = [length / sum(longest) for length in longest]
    look: dict[str, Any] = {"loc": "upper left", "cellLoc": "left", "edges": "horizontal"}
    table = axes.table(cellText=sheet.rows, colLabels=sheet.head, colWidths=widths, **look)
    table.auto_set_font_size(False)
    table.set_fontsize(6 if sum(longest) < 150 else 5)
    axes.text(0.0, -0.02, f"{sheet.more} {sheet.footer}.".strip(), fontsize=6, va="top")
