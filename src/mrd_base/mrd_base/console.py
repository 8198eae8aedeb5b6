"""Tables on a terminal."""

import os
import sys
from collections.abc import Collection, Sequence

from rich.cells import cell_len
from rich.console import Console
from rich.padding import Padding
from rich.table import Column, Table

WIDE = 140
"""Characters of a line where no terminal says how many there are: in a file or a pipe."""
INDENT = 4
"""Characters by which a text beneath its row is indented."""


def print_table(table: Table, beneath: Collection[str] = ()) -> None:
    """Print a table as wide as the terminal; text is folded between words, and nothing is cut.

    Parameters
    ----------
    table : rich.table.Table
        Its cells are strings or `rich.text.Text`. A table whose longest words do not fit side by side becomes wider than the
        terminal.
    beneath : collection of str
        Titles of columns with sentences. Where the table is wider than the terminal, their text stands in lines beneath its
        row instead of in a narrow column.
    """
    told = sys.stdout.isatty() or "COLUMNS" in os.environ
    console = Console(width=None if told else WIDE, highlight=False)
    if beneath and _total(_widths(table.columns), table) > console.width:
        _print_with_texts_beneath(console, table, beneath)
        return
    _fit(table, console)
    console.print(table)


def _print_with_texts_beneath(console: Console, table: Table, beneath: Collection[str]) -> None:
    """Print each row as a table of its own, all of the same widths, and the texts of the columns ``beneath`` below it."""
    texts = [column for column in table.columns if column.header in beneath]
    table.columns = [column for column in table.columns if column.header not in beneath]
    table.box = None
    _fit(table, console)
    for number in range(table.row_count):
        columns = (Column(column.header, justify=column.justify, width=column.width) for column in table.columns)
        row = Table(*columns, box=None, show_header=number == 0, title=None if number else table.title)
        row.add_row(*(list(column.cells)[number] for column in table.columns))
        console.print(row)
        for text in (list(column.cells)[number] for column in texts):
            if str(text):
                console.print(Padding(text, (0, 0, 0, INDENT), style="dim", expand=False))
    if table.caption:
        console.print(table.caption)


def _fit(table: Table, console: Console) -> None:
    """Narrow the columns until they fit, the widest first; the console grows where words are too long for it."""
    columns = table.columns
    widths = _widths(columns)
    longest_words = [max(cell_len(word) for text in _texts(column) for word in text.split() or [""]) for column in columns]
    console.width = max(console.width, _total(longest_words, table))
    while _total(widths, table) > console.width:
        widest = max(range(len(widths)), key=lambda k: (widths[k] > longest_words[k], widths[k]))
        widths[widest] -= 1
    for column, width in zip(columns, widths, strict=True):
        column.width = width


def _widths(columns: Sequence[Column]) -> list[int]:
    """Return the widths at which no text is folded."""
    return [max(cell_len(line) for text in _texts(column) for line in text.splitlines() or [""]) for column in columns]


def _texts(column: Column) -> list[str]:
    return [str(cell) for cell in (column.header, *column.cells)]


def _total(widths: Sequence[int], table: Table) -> int:
    """Return the width of a table: of each column, a space on both sides and, in a box, a line between it and the next."""
    return sum(widths) + 2 * len(widths) + (len(widths) + 1 if table.box else 0)
