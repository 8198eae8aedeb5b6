"""Pages from templates."""

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
from plotly.offline import get_plotlyjs

from mrd_base.quantities import four_figures, per_cent, quantity
from mrd_base.version import VERSION


def render(
    template: str, path: str | Path, package: str, /, *, files: Sequence[str] = (), interactive: bool = False, **content: Any
) -> Path:
    """Write a page from a template of a package, and return its path.

    The template ``template``.html.j2 extends ``page.html.j2``, which all packages share. The page ends with the version of
    the program, the date, and the ``files`` that it is about. An ``interactive`` page includes Plotly, which takes 4.7 MB.
    The file is complete or absent, even when the process is interrupted.
    """
    loaders = [jinja2.PackageLoader(name) for name in (package, "mrd_base")]
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(loaders), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    environment.filters["figures"] = four_figures
    environment.filters["per_cent"] = per_cent
    environment.filters["quantity"] = quantity
    page = environment.get_template(f"{template}.html.j2").render(
        plotly=get_plotlyjs() if interactive else "",
        version=VERSION,
        written=f"{datetime.datetime.now():%Y-%m-%d %H:%M}",
        sources=list(dict.fromkeys(files)),
        **content,
    )
    path = Path(path)
    partial = path.with_name(f"{path.name}.part")
    partial.write_text(page, encoding="utf-8")
    return partial.replace(path)
