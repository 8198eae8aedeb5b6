"""Tables on a terminal."""

import os
import sys

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

WIDE = 140
"""Characters of a line where no terminal says how many there are: in a file or a pipe."""


def print_table(table: Table) -> None:
    """Print a table as wide as the terminal; text is folded between words, and nothing is cut.

    Parameters
    ----------
    table : rich.table.Table
        Its cells are strings or `rich.text.Text`. A table whose longest words do not fit side by side becomes wider than the
        terminal.
    """
    told = sys.stdout.isatty() or "COLUMNS" in os.environ
    console = Console(width=None if told else WIDE, highlight=False)
    texts = [[str(cell) for cell in (column.header, *column.cells)] for column in table.columns]
    widths = [max(cell_len(line) for text in cells for line in text.splitlines() or [""]) for cells in texts]
    longest_words = [max(cell_len(word) for text in cells for word in text.split() or [""]) for cells in texts]
    # Of each column: a space on both sides, and a line that separates it from the next.
    between = 3 * len(widths) + 1
    console.width = max(console.width, sum(longest_words) + between)
    while sum(widths) + between > console.width:
        widest = max(range(len(widths)), key=lambda k: (widths[k] > longest_words[k], widths[k]))
        widths[widest] -= 1
    for column, width in zip(table.columns, widths, strict=True):
        column.width = width
    console.print(table)
