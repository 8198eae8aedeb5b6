"""Output of a node: a terminal that stands still, or a full pipe, must not stop the node."""

import contextlib
import os
import stat
import sys
import threading
from collections.abc import Iterator

_LAST_WORDS = 1.0
"""Time in s that a node which ends leaves to its output."""


@contextlib.contextmanager
def output_that_never_waits() -> Iterator[None]:
    """Let threads of their own write what goes to stdout and stderr; while these wait, what exceeds a pipe is lost.

    ROS logs while Python's interpreter is locked: a write that waits would stop all threads of the process, also those that
    stop rod and coil. A file takes everything at once, and has the last words of a process that is killed.
    """
    copies = []
    for descriptor in (1, 2):
        with contextlib.suppress(OSError):  # it is closed
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                copies.append(_Copy(descriptor))
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        for copy in copies:
            copy.end()


class _Copy:
    """Puts a pipe in the place of a descriptor, and copies what comes through it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._original = descriptor, os.dup(descriptor)
        if descriptor == 2 and os.isatty(descriptor):
            os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")  # ROS does not colour what goes into a pipe
        read, write = os.pipe()
        os.set_blocking(write, False)
        os.dup2(write, descriptor)
        os.close(write)
        self._thread = threading.Thread(target=self._copy, args=(read,), daemon=True)
        self._thread.start()

    def _copy(self, read: int) -> None:
        while data := memoryview(os.read(read, 65536)):
            with contextlib.suppress(OSError):  # nobody reads it any more
                while data:
                    data = data[os.write(self._original, data) :]
        os.close(read)

    def end(self) -> None:
        """Restore the descriptor, and wait a moment for what is under way."""
        os.dup2(self._original, self._descriptor)
        self._thread.join(_LAST_WORDS)
