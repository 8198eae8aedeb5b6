"""The progress of a long computation: a bar with the time left on a terminal, a line now and then in a log."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

EVERY = 10.0
"""s between two lines in a log."""

Report = Callable[[str, float], None]
"""Takes the present stage and the finished share, 0 to 1."""


def ignore(*_reported: object) -> None:
    """Ignore what is reported."""


@contextmanager
def shown_progress(what: str) -> Iterator[Report]:
    """Show the progress of a computation on stderr as long as the context lasts; yields the function that takes it."""
    if sys.stderr.isatty():
        with tqdm(total=100, desc=what, unit="%", file=sys.stderr, leave=False) as bar:
            yield lambda stage, share: _move(bar, f"{what}: {stage}" if stage else what, share)
    else:
        yield _line_reporter(what)


def _move(bar: "tqdm[None]", text: str, share: float) -> None:
    bar.set_description_str(text, refresh=False)
    bar.update(int(100 * share) - bar.n)


def _line_reporter(what: str) -> Report:
    """Return a function that prints a line where the last one, or the beginning, is long enough ago."""
    begin = last = time.monotonic()

    def report(stage: str, share: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < EVERY:
            return
        last = now
        left = f", about {(now - begin) * (1 - share) / share:.0f} s left" if share > 0 else ""
        print(f"{what}: {stage + ', ' if stage else ''}{100 * share:.0f} %{left}", file=sys.stderr, flush=True)

    return report
