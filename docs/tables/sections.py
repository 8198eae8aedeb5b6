"""Sections of pages that scripts write, and the Markdown tables in them."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path


def page_with(text: str, name: str, content: str, page: Path) -> str:
    """Replace what stands between the markers of a section of a page."""
    pattern = re.compile(rf"(<!-- {name} -->\n).*?(\n<!-- /{name} -->)", re.DOTALL)
    if not pattern.search(text):
        raise SystemExit(f"{page}: has no section {name}, expected <!-- {name} --> and <!-- /{name} -->")
    return pattern.sub(lambda match: match[1] + content + match[2], text)


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
