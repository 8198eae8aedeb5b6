"""Bench time: the time by which every node stamps its messages, waits and times out.

On a real bench, it is the time of the machine (`BenchClock`). On a simulated bench, it stands still until every node has
done its work (`mrd_base.barrier_clock.BarrierClock`). Code that only uses the methods of `BenchClock` runs on both.
"""

import contextlib
import os
import select
import time
from contextlib import AbstractContextManager, suppress


def _uptime() -> float:
    """Return the time since the machine was started, in s."""
    # Unlike time.monotonic(), this clock also counts while the machine is suspended. Otherwise a node that is started after
    # a suspension would disagree with the others by its length.
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Waiter:
    """Lets one thread wait for a bench time. Any other thread may end the wait."""

    def __init__(self, clock: "BenchClock") -> None:
        self._clock = clock
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)

    def wake(self) -> None:
        """End the present wait, or else the next one, at once."""
        # A full pipe means that it is woken already.
        with suppress(BlockingIOError):
            os.write(self._write, b"!")

    def clear(self) -> None:
        """Forget that it was woken."""
        with suppress(BlockingIOError):
            os.read(self._read, 4096)

    def wait(self, until: float, line: int | None = None) -> bool:
        """Wait until a bench time; return whether `wake` ended the wait.

        Parameters
        ----------
        line : int, optional
            Descriptor of the motor's serial line. Bytes that arrive on it end the wait, too.
        """
        watched = [self._read] if line is None else [self._read, line]
        if self._read in select.select(watched, [], [], max(0.0, until - self._clock.now()))[0]:
            self.clear()
            return True
        return False

    def close(self) -> None:
        """Release what it holds. Nobody may wait or wake afterwards."""
        os.close(self._read)
        os.close(self._write)


class BenchClock:
    """Clock of a real bench.

    Bench time is Unix time as it was when the clock was created, and follows the time since the machine was started, which
    all processes share. An adjustment of the machine's clock therefore stops no watchdog; nodes created before and after it
    differ by that adjustment.
    """

    def __init__(self) -> None:
        self._offset = time.time() - _uptime()

    def now(self) -> float:
        """Return the bench time in s."""
        return self._offset + _uptime()

    def sleep_until(self, bench_time: float) -> None:
        """Block until ``bench_time``; return at once when it has passed."""
        remaining = bench_time - self.now()
        if remaining > 0:
            time.sleep(remaining)

    def sleep(self, duration: float) -> None:
        """Block for ``duration`` bench seconds."""
        self.sleep_until(self.now() + duration)

    def sleep_step(self, period: float) -> None:
        """Block for a period between two looks at a condition."""
        time.sleep(period)

    def waiter(self) -> Waiter:
        """Return a means to wait that another thread can end."""
        return Waiter(self)

    def settle(self) -> None:
        """Let all others of a simulated bench end their work of the present instant; on a real bench there is none."""

    def busy(self) -> AbstractContextManager[None]:
        """Return a context in which a simulated bench stands still, except while the thread waits for a bench time."""
        return contextlib.nullcontext()

    def hold(self) -> None:
        """Begin work during which a simulated bench stands still; any thread ends it by `release`."""

    def release(self) -> None:
        """End work that `hold` began."""

    def sending(self, channel: str, count: int = 1) -> None:
        """Announce messages or bytes that are about to be sent, so that a simulated bench waits until they are received."""
