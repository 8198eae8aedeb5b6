"""The thread that owns the serial line: it connects, exchanges data, and leaves the rod at rest with the drive off."""

import os
import random
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from mrd_base import BenchClock, InputError
from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.controller import ServoController
from mrd_bench_driver.servo.motor_line import LineLostError, MotorLine, WaitInterrupted
from mrd_bench_driver.servo.motor_setup import connect_motor
from mrd_bench_driver.servo.smartmotor import ReplyError
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.servo.streaming import TURNAROUND

# First and longest wait in bench s before the next attempt to connect; it doubles from attempt to attempt.
_RETRY_DELAY = (0.25, 5.0)
# The line counts as lost after this silence in bench s, if more than this many batches in a row have missed replies.
_MAX_SILENCE = 0.3
_MAX_MISSED = 3
# Time in bench s that the rod is given to come to rest before the drive is switched off.
_REST_DELAY = 0.1
# Margin in bench s for the replies of a batch, beyond the turnaround and the bytes of each.
_REPLY_MARGIN = 0.03


class ServoCommunication:
    """Connects a `ServoController` with the motor on a serial port, in a thread of its own.

    Parameters
    ----------
    on_status : callable
        Receives the status of the servo after each exchange, in the thread of the line, until `close` is called.
    check : callable
        Called before it. Stops that it asks for are written before anybody is told of them.
    """

    def __init__(
        self,
        config: ServoConfig,
        clock: BenchClock,
        on_status: Callable[[ServoStatus], None],
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self._config, self._clock, self._on_status, self._check = config, clock, on_status, check
        self._waiter = clock.waiter()
        self.controller = ServoController(config, self._waiter.wake)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="servo line", daemon=True)

    def start(self) -> None:
        """Start to search for the motor."""
        self._thread.start()

    def close(self) -> None:
        """Bring the rod to rest, switch the drive off, and close the port. This may be called at any time, and twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._waiter.wake()
        if self._thread.ident is not None:
            self._thread.join(timeout=5.0)
        if not self._thread.is_alive():
            self._waiter.close()

    def _run(self) -> None:
        with self._clock.busy():
            self._waiter.wait(
                self._clock.now() + 1e-3
            )  # until the time of a simulated bench has begun, and its port is there
            try:
                self._connect_until_closed()
            except Exception:
                # The motor has been stopped. Without this thread, a process that lives on would look sound.
                try:
                    self._publish(self._clock.now())
                finally:
                    os.kill(os.getpid(), signal.SIGTERM)
                raise

    def _connect_until_closed(self) -> None:
        delay = _RETRY_DELAY[0]
        while not self._closing.is_set():
            line: MotorLine | None = None
            try:
                line, motor = connect_motor(self._config, self.controller.homed, self._clock, self._waiter)
                self.controller.connect(motor, line.baud_rate, self._clock.now())
                delay = _RETRY_DELAY[0]
                self._exchange_until_closed(line)
            except (LineLostError, InputError) as error:
                self.controller.disconnect(str(error))
            except WaitInterrupted:
                continue
            except Exception as error:
                # The state of the rod must not depend on an error of this program.
                self.controller.disconnect(f"internal error: {error!r}")
                raise
            finally:
                if line is not None:
                    self._disconnect(line)
            delay = self._wait_to_retry(delay)

    def _wait_to_retry(self, delay: float) -> float:
        """Wait about ``delay`` bench s and go on publishing; return the next delay.

        The wait varies, lest two drivers collide again and again. It ends when the port appears: a cable was plugged in, or
        a simulated motor was started. Delays begin at the shortest again then, because that motor may still boot.
        """
        end = self._clock.now() + delay * random.uniform(0.8, 1.2)
        port = Path(self._config.port)
        absent = not port.exists()
        while not self._closing.is_set() and (now := self._clock.now()) < end:
            if absent and port.exists():
                return _RETRY_DELAY[0]
            self._publish(now)
            self._waiter.wait(min(now + 0.1, end))
        return min(_RETRY_DELAY[1], 2 * delay)

    def _exchange_until_closed(self, line: MotorLine) -> None:
        controller, clock = self.controller, self._clock
        due = answered = clock.now()
        missed = 0
        while not self._closing.is_set():
            # A stop that comes after this wakes the thread. Either it interrupts the exchange below before a motion command
            # is written, or it is written after that command.
            self._waiter.clear()
            self._write_commands(line)
            # A line on which nothing useful comes must not delay the stop of a motion that it leaves without positions.
            # Neither this wait nor that for replies therefore goes on beyond it.
            if self._waiter.wait(min(due, controller.position_due)):
                continue
            batch = controller.tick(clock.now())
            # After a delay the next tick is one period away: ticks to catch up would send targets in a burst.
            due = max(due + controller.period, batch.time)
            timeout = _REPLY_MARGIN + sum(TURNAROUND + line.duration(8) for _ in batch.queries)
            try:
                replies = line.exchange(batch.data, len(batch.queries), timeout, controller.position_due)
                values = [query.parse(reply) for query, (reply, _) in zip(batch.queries, replies, strict=True)]
            except ReplyError as error:
                controller.replies_missed()
                missed += 1
                if missed > _MAX_MISSED and clock.now() - answered > _MAX_SILENCE:
                    raise LineLostError(f"{line.port}: the motor no longer answers ({error})") from error
            except WaitInterrupted:
                controller.replies_interrupted()
            else:
                missed, answered = 0, replies[0][1]
                controller.take_replies(batch, values, answered)
            self._publish(clock.now(), line)

    def _write_commands(self, line: MotorLine) -> None:
        if data := self.controller.take_commands():
            line.write(data)

    def _publish(self, now: float, line: MotorLine | None = None) -> None:
        if self._closing.is_set():
            return
        self._check()
        if line is not None:
            self._write_commands(line)  # first, because whoever is told may block
        self._on_status(self.controller.status(now))

    def _disconnect(self, line: MotorLine) -> None:
        """Bring the rod to rest and switch the drive off, whatever ended the exchange."""
        with suppress(LineLostError):
            line.write(b"\rX\r")
            self._clock.sleep(_REST_DELAY)
            line.write(b"OFF\r")
            self._clock.sleep(line.duration(4) + 0.002)
        line.close()
