"""A word to the user where functions are compiled, which the first use on a machine does for half a minute."""

import math
import sys
import time

from numba.core.event import Event, Listener, register

AFTER = 1.0
"""s of compiling after which the user is told: what is compiled anew at every use takes less."""


class _Teller(Listener):
    """Tells once on stderr that functions are compiled. They compile the functions that they call, so that events nest."""

    def __init__(self, after: float) -> None:
        self._left, self._depth, self._begun = after, 0, 0.0

    def on_start(self, event: Event) -> None:
        if self._depth == 0:
            self._begun = time.monotonic()
        self._depth += 1

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        spent = time.monotonic() - self._begun
        if spent >= self._left:
            print(
                "compiling for this machine: only the first use does, for about half a minute", file=sys.stderr, flush=True
            )
            self._left = math.inf
        elif self._depth == 0:
            self._left -= spent


def tell_when_compiling(after: float = AFTER) -> None:
    """Tell the user on stderr, once, when this process has compiled functions for more than ``after`` s."""
    register("numba:compile", _Teller(after))
