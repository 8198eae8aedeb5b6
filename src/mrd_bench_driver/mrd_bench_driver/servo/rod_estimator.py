"""Estimate the position of the rod from the motor's position replies, which may be late, missing or wrong."""

from collections import deque

from mrd_bench_driver.servo.streaming import MotionCommand

# Distance in m that a reply may deviate by even if the rod stands: jitter of the time of reading, compliance of the drive.
_SLACK = 3e-4
# Largest plausible ratio of the speed that a reply implies to the known speed.
_MAX_SPEED_RATIO = 1.5
# Longest gap in s between replies in which the rod can have kept its speed; without a new command it stops sooner.
_MAX_GAP = 0.2
# Number of successive implausible positions, each plausible after the one before, which show that the register has changed.
_JUMP_COUNT = 5


class PositionJumpError(Exception):
    """The position register jumped: the motor was reset, or its origin was shifted."""


class RodEstimator:
    """Estimate position and velocity of the rod, and reject positions that it cannot have reached.

    A rod that was not commanded to move cannot have moved. The bound is therefore the speed commanded or measured, not the
    greatest possible speed. The command before a stop counts for some time: the rod brakes from a speed that the replies,
    which come later, do not tell yet where it has just accelerated.

    Attributes
    ----------
    time, position, velocity : float
        Bench time in s of the last accepted reply, and the position in m and velocity in m/s then.
    """

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float]] = deque(maxlen=3)
        self._prediction_start = (0.0, 0.0)
        self._command: MotionCommand | None = None
        self._stopped: tuple[MotionCommand, float] | None = None  # the last one before a stop, and the time of that
        self._jumps = 0
        self._rejected = (0.0, 0.0)
        self.time = float("-inf")
        self.position = float("nan")
        self.velocity = 0.0

    def reset(self, time: float, position: float) -> None:
        """Set the position in m, after a first reply or with a new origin."""
        self._recent.clear()
        self._command, self._stopped, self._jumps, self.velocity = None, None, 0, 0.0
        self._accept(time, position)

    def update(self, time: float, position: float) -> bool:
        """Process a position in m that was read at a bench time in s; return whether it is accepted.

        Raises
        ------
        PositionJumpError
            If successive replies agree on a position that the rod cannot have reached.
        """
        if not self._reachable(self.time, self.position, time, position):
            consistent = self._jumps and self._reachable(*self._rejected, time, position)
            self._jumps = self._jumps + 1 if consistent else 1
            self._rejected = (time, position)
            if self._jumps >= _JUMP_COUNT:
                raise PositionJumpError(
                    f"the motor's position jumped from {1e3 * self.position:.2f} to {1e3 * position:.2f} mm"
                )
            return False
        self._jumps = 0
        self._accept(time, position)
        return True

    def predict(self, time: float) -> float:
        """Return the position in m expected at a bench time, from the last reply and the last command."""
        begin, position = self._prediction_start
        return position + (self._command.travel(begin, time) if self._command and time > begin else 0.0)

    def set_command(self, command: MotionCommand | None) -> None:
        """Note the motion command that was sent, or None if the motion was stopped."""
        if command is not None:
            self._prediction_start = (command.time, self.predict(command.time))
        elif self._command is not None:
            self._stopped = self._command, self.time
        self._command = command

    @property
    def commanded_velocity(self) -> float:
        """Velocity in m/s of the last command."""
        return self._command.velocity if self._command else self.velocity

    def _reachable(self, start_time: float, start: float, time: float, position: float) -> bool:
        speed = abs(self.velocity)
        command = self._command
        if command is None and self._stopped is not None and time - self._stopped[1] <= _MAX_GAP:
            command = self._stopped[0]
        if command is not None:
            speed = max(speed, abs(command.velocity), abs(command.initial_velocity))
        return abs(position - start) <= _MAX_SPEED_RATIO * speed * min(_MAX_GAP, max(0.0, time - start_time)) + _SLACK

    def _accept(self, time: float, position: float) -> None:
        self._recent.append((time, position))
        (t0, p0), (t1, p1) = self._recent[0], self._recent[-1]
        if t1 > t0:
            self.velocity = (p1 - p0) / (t1 - t0)
        self.time, self.position = time, position
        self._prediction_start = (time, position)
