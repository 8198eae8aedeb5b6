"""The thread that owns the serial line: connects, exchanges, stops at once, and leaves the rod at rest and let go."""

import random
import threading
from collections.abc import Callable
from contextlib import suppress

from mrd_base import BenchClock, InputError
from mrd_bench_driver.drive import TURNAROUND
from mrd_bench_driver.serial_line import Interrupted, LineLost, SerialLine, Wake
from mrd_bench_driver.servo import Servo
from mrd_bench_driver.servo_config import ServoConfig, ServoReport
from mrd_bench_driver.smartmotor import ReplyError
from mrd_bench_driver.smartmotor_setup import connect

# Bench seconds.
_BACK_OFF = (0.25, 5.0)
_SILENCE = 0.3
_COMING_TO_REST = 0.1
# Replies missing in a row before the line counts as lost.
_MISSED = 3


class ServoLoop:
    """Runs a `Servo` on a serial port.

    Parameters
    ----------
    config : ServoConfig
    clock : BenchClock
    on_report : callable
        Given the servo's state after each exchange, in the loop's thread; not any more once `close` was called.
    """

    def __init__(self, config: ServoConfig, clock: BenchClock, on_report: Callable[[ServoReport], None]) -> None:
        self._config, self._clock, self._on_report = config, clock, on_report
        self._wake = Wake()
        self.servo = Servo(config, self._wake.set)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="servo line", daemon=True)

    def start(self) -> None:
        """Begin to look for the motor."""
        self._thread.start()

    def close(self) -> None:
        """Bring the rod to rest, let it go, give the port back. Safe at any time, and twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._wake.set()
        if self._thread.ident is not None:
            self._thread.join(timeout=5.0)
        if not self._thread.is_alive():
            self._wake.close()

    def _run(self) -> None:
        delay = _BACK_OFF[0]
        while not self._closing.is_set():
            line: SerialLine | None = None
            try:
                line, motor = connect(
                    self._config.port,
                    self._config.baud_rate,
                    self._config.drive,
                    self._config.following_error_limit,
                    2 * self._config.limits.speed,
                    self._config.limit_switches,
                    self.servo.keep_origin,
                    self._clock,
                    self._wake,
                )
                self.servo.connected(motor, line.baud_rate, self._clock.now())
                delay = _BACK_OFF[0]
                self._serve(line)
            except (LineLost, InputError) as error:
                self.servo.lost(str(error))
            except Interrupted:
                continue
            except Exception as error:
                # A fault of this program; the rod must not depend on it.
                self.servo.lost(f"internal error: {error!r}")
                self._tell(self._clock.now())
                raise
            finally:
                if line is not None:
                    self._leave(line)
            self._wait_to_retry(delay)
            delay = min(_BACK_OFF[1], 2 * delay)

    def _wait_to_retry(self, delay: float) -> None:
        """Wait ``delay`` bench s, a little more or less lest two drivers meet for ever; go on telling the state."""
        end = self._clock.now() + delay * random.uniform(0.8, 1.2)
        while not self._closing.is_set() and (now := self._clock.now()) < end:
            self._tell(now)
            self._wake.wait(self._clock.wall(min(0.1, end - now)))

    def _serve(self, line: SerialLine) -> None:
        servo, clock = self.servo, self._clock
        due = answered = clock.now()
        missed = 0
        while not self._closing.is_set():
            # A stop that comes after this wakes the loop: it breaks off the exchange below before a motion is written,
            # or is written after it.
            self._wake.clear()
            if data := servo.take():
                line.write(data)
            if self._wake.wait(clock.wall(due - clock.now())):
                continue
            batch = servo.tick(clock.now())
            # After a delay the rhythm starts anew: targets made up for would come in a burst.
            due = max(due + servo.period, batch.time)
            timeout = 0.03 + sum(TURNAROUND + line.duration(8) for _ in batch.reports)
            try:
                replies = line.ask(batch.data, len(batch.reports), timeout)
                values = [report.parse(reply) for report, (reply, _) in zip(batch.reports, replies, strict=True)]
            except ReplyError as error:
                servo.missed()
                missed += 1
                if missed > _MISSED and clock.now() - answered > _SILENCE:
                    raise LineLost(f"{line.port}: the motor no longer answers ({error})") from error
            except Interrupted:
                servo.broken_off()
            else:
                missed, answered = 0, replies[0][1]
                servo.replied(batch, values, answered)
            self._tell(clock.now())

    def _tell(self, now: float) -> None:
        if not self._closing.is_set():
            self._on_report(self.servo.report(now))

    def _leave(self, line: SerialLine) -> None:
        """Whatever ended the service: the rod comes to rest, then the drive lets go."""
        with suppress(LineLost):
            line.write(b"\rX\r")
            self._clock.sleep_until(self._clock.now() + _COMING_TO_REST)
            line.write(b"OFF\r")
            self._clock.sleep_until(self._clock.now() + line.duration(4) + 0.002)
        line.close()
