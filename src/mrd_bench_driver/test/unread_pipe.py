"""A pipe that nobody reads, as if the terminal of a node stood still."""

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def unread_pipe() -> Iterator[int]:
    """Yield the descriptor of the end into which a node writes."""
    unread, written = os.pipe()
    try:
        yield written
    finally:
        os.close(unread)
        os.close(written)


def fill(pipe: int) -> None:
    """Fill a pipe, so that whoever writes into it next waits."""
    filler = os.open(f"/proc/self/fd/{pipe}", os.O_WRONLY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(filler, b"x")
    os.close(filler)
