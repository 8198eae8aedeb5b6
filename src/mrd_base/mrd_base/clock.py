"""Bench time: the one time that every node stamps, waits and times out by."""

import time
from dataclasses import dataclass, field


def _uptime() -> float:
    # Unlike time.monotonic() it runs on while the machine is suspended; or else a node started after that would disagree
    # with the others by the time slept.
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def _epoch() -> float:
    return time.time() - _uptime()


# Bounds of ``time_scale``: beyond them, timeouts are too long to wait for or shorter than a process takes to answer.
SLOWEST, FASTEST = 0.01, 100.0


@dataclass(frozen=True)
class BenchClock:
    """Seconds of bench time; they pass ``time_scale`` times as fast as on the wall.

    It follows the time since the machine's start, which all processes share: nodes with the same ``time_scale`` agree on
    the time without exchanging a message, and no clock adjustment stops a watchdog. At ``time_scale`` 1 the zero is the
    Unix epoch as the node found it: nodes started before and after the machine's clock was set differ by as much. A
    simulation that runs faster or slower counts from the machine's start.

    Parameters
    ----------
    time_scale : float
        Bench seconds per wall second, > 0; 1 on a real bench.
    """

    time_scale: float = 1.0
    _zero: float = field(default_factory=_epoch, repr=False)

    def __post_init__(self) -> None:
        if not self.time_scale > 0:
            raise ValueError(f"time_scale is {self.time_scale}, expected > 0")
        if self.time_scale != 1.0:
            object.__setattr__(self, "_zero", 0.0)

    def now(self) -> float:
        """Bench time in s."""
        return self._zero + self.time_scale * _uptime()

    def wall(self, duration: float) -> float:
        """Wall-clock length in s of a ``duration`` in bench seconds."""
        return duration / self.time_scale

    def sleep_until(self, bench_time: float) -> None:
        """Block until ``bench_time``; return at once when it has passed."""
        remaining = self.wall(bench_time - self.now())
        if remaining > 0:
            time.sleep(remaining)
