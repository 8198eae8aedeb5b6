"""A word to the user, or help, where functions are compiled: the first use on a machine does that for half a minute."""

import math
import sys
import time
from collections.abc import Callable

from numba.core.event import Event, Listener, register

AFTER = 1.0
"""s of compiling after which the user is told, or helped: what is compiled anew at every use takes less."""


class _Stopwatch(Listener):
    """Calls a function once, after so much compiling. Events nest, as functions compile the functions that they call."""

    def __init__(self, call: Callable[[], object], after: float) -> None:
        self._call, self._left, self._depth, self._begun = call, after, 0, 0.0

    def on_start(self, event: Event) -> None:
        if self._depth == 0:
            self._begun = time.monotonic()
        self._depth += 1

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        spent = time.monotonic() - self._begun
        if spent >= self._left:
            self._left = math.inf
            self._call()
        elif self._depth == 0:
            self._left -= spent


def when_compiling(call: Callable[[], object], after: float = AFTER) -> None:
    """Call a function, once, when this process has compiled functions for more than ``after`` s."""
    register("numba:compile", _Stopwatch(call, after))


def tell_when_compiling(after: float = AFTER) -> None:
    """Tell the user on stderr, once, when this process has compiled functions for more than ``after`` s."""
    word = "compiling for this machine: only the first use does, for about half a minute"
    when_compiling(lambda: print(word, file=sys.stderr, flush=True), after)
