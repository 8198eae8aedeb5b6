"""Whether the machine keeps time: how late periodic work comes. On a simulated bench, nothing is ever late."""

import math


class Punctuality:
    """Counts the late ones of periodic cycles.

    Parameters
    ----------
    limit : float
        Delay in s from which a cycle is late.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self.restart()

    def restart(self) -> None:
        """Count from the beginning."""
        self.cycles = self.late = 0
        self.worst = 0.0
        self._last = math.nan

    def note(self, now: float, period: float) -> None:
        """Note that a cycle began at the bench time ``now``, where it was due ``period`` s after the one before."""
        delay = now - self._last - period
        self._last = now
        self.cycles += 1
        # The first cycle has none before it; a comparison with nan is false.
        if delay > self._limit:
            self.late += 1
            self.worst = max(self.worst, delay)

    def problem(self) -> str:
        """Return in one sentence that the machine is too slow and what to do, or "" if no cycle was late."""
        if not self.late:
            return ""
        return (
            f"this machine is too slow: {self.late} of {self.cycles} cycles came more than {1e3 * self._limit:g} ms late, "
            f"the worst {1e3 * self.worst:.0f} ms; end other programs, or give the bench a machine of its own"
        )
