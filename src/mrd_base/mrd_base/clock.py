"""Bench time: the time by which every node stamps its messages, waits and times out."""

import time
from dataclasses import dataclass, field

# Bounds of ``time_scale``. Below, waiting for a timeout takes too long; above, a timeout is shorter than the time in which a
# process can answer.
SLOWEST, FASTEST = 0.01, 100.0


def _uptime() -> float:
    """Return the time since the machine was started, in s."""
    # Unlike time.monotonic(), this clock also counts while the machine is suspended. Otherwise a node that is started after
    # a suspension would disagree with the others by its length.
    return time.clock_gettime(time.CLOCK_BOOTTIME)


@dataclass(frozen=True)
class BenchClock:
    """Clock of bench time, which passes ``time_scale`` times as fast as wall-clock time.

    Bench time follows the time since the machine was started, which all processes share. Nodes with the same ``time_scale``
    therefore agree on the time without exchanging messages, and an adjustment of the machine's clock stops no watchdog.
    With ``time_scale`` 1, bench time is Unix time as it was when the clock was created: nodes created before and after an
    adjustment of the machine's clock differ by that adjustment. Otherwise it is zero at the start of the machine.

    Parameters
    ----------
    time_scale : float
        Bench seconds per wall-clock second, > 0; 1 on a real bench.
    """

    time_scale: float = 1.0
    _offset: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.time_scale > 0:
            raise ValueError(f"time_scale is {self.time_scale}, expected > 0")
        object.__setattr__(self, "_offset", time.time() - _uptime() if self.time_scale == 1.0 else 0.0)

    def now(self) -> float:
        """Return the bench time in s."""
        return self._offset + self.time_scale * _uptime()

    def wall(self, duration: float) -> float:
        """Return the wall-clock length, in s, of a duration in bench seconds."""
        return duration / self.time_scale

    def sleep_until(self, bench_time: float) -> None:
        """Block until ``bench_time``; return at once when it has passed."""
        remaining = self.wall(bench_time - self.now())
        if remaining > 0:
            time.sleep(remaining)
