"""Writes the tables of keys in docs/experiments.md from the declarations of the fields.

python docs/tables/experiments.py            # writes them into the page
python docs/tables/experiments.py --check    # fails where the page is not up to date
"""

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

from sections import page_with, table

from mrd_base.config import yaml_key
from mrd_trajectory.damper_tests import damper_test_table
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.until import Until

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "experiments.md"


def keys(cls: type[Any]) -> str:
    """Return the table of the YAML keys of a dataclass."""
    rows = []
    for field in dataclasses.fields(cls):
        default = "required" if field.default is dataclasses.MISSING else field.default
        shown = default if isinstance(default, str | int) and default != "" else ""
        meaning = field.metadata["doc"]
        rows.append((f"`{yaml_key(field)[0]}`", str(shown), meaning))
    return table(("key", "default", "meaning"), rows)


def page(text: str) -> str:
    """Return the page with its tables."""
    tests = [(f"`{row.test}`", f"`{row.key}`", row.default, row.meaning) for row in damper_test_table()]
    text = page_with(text, "experiment", keys(Experiment), PAGE)
    text = page_with(text, "until", keys(Until), PAGE)
    return page_with(text, "damper tests", table(("test", "key", "default", "meaning"), tests), PAGE)


def main() -> None:
    """Write the tables, or compare them with the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    before = PAGE.read_text(encoding="utf-8")
    after = page(before)
    if check and after != before:
        sys.exit(f"{PAGE}: is not up to date; run python docs/tables/experiments.py")
    PAGE.write_text(after, encoding="utf-8")


if __name__ == "__main__":
    main()
