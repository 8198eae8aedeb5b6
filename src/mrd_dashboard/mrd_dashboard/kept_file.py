"""A JSON file in which the page keeps something that outlives it."""

import json
from pathlib import Path
from typing import Any


def read_kept(file: Path | None) -> dict[str, Any]:
    """Return what a file holds; nothing without a file, and where it holds no JSON object."""
    if file is None or not file.exists():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, OSError):
        return {}
    return content if isinstance(content, dict) else {}


def keep(content: Any, file: Path | None, what: str) -> str:
    """Write a file, complete or not at all; return why that failed, or "".

    Parameters
    ----------
    content
        What JSON can hold.
    file : Path or None
        Without one, nothing is kept.
    what : str
        What the reason says will be lost.
    """
    if file is None:
        return ""
    part = file.with_name(file.name + ".part")
    try:
        part.write_text(json.dumps(content), encoding="utf-8")
        part.replace(file)
    except OSError as error:
        return f"{file}: {error.strerror}; {what} will be lost with the page"
    return ""
