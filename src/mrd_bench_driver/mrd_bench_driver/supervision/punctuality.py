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
        self._due = math.nan
        self.restart()

    def restart(self) -> None:
        """Count from the beginning; a cycle that is due already counts."""
        self.cycles = self.late = 0
        self.worst = 0.0

    def note(self, now: float, period: float) -> None:
        """Note that a cycle began at the bench time ``now``, where it was due ``period`` s after the one before."""
        delay = now - self._due
        self._due = now + period
        self.cycles += 1
        # Before the first cycle, none was due; a comparison with nan is false.
        if delay > self._limit:
            self.late += 1
            self.worst = max(self.worst, delay)

    def problem(self, now: float) -> str:
        """Return in one sentence that the machine is too slow and what to do, or "" if no cycle was late.

        A cycle that has not come at the bench time ``now`` is late, too.
        """
        missing = now - self._due > self._limit
        late, cycles = self.late + missing, self.cycles + missing
        if not late:
            return ""
        worst = max(self.worst, now - self._due if missing else 0.0)
        return (
            f"this machine is too slow: {late} of {cycles} cycles came more than {1e3 * self._limit:g} ms late, "
            f"the worst {1e3 * worst:.0f} ms; end other programs, or give the bench a machine of its own"
        )
