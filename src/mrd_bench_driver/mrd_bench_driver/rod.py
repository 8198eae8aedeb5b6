"""Where the rod is, from position reports that may be late, missing or wrong."""

from collections import deque

from mrd_bench_driver.drive import Target

# Beyond what the rod can travel in m: noise of the time at which a report was taken, compliance of the drive.
_SLACK = 3e-4
# Ratio of the speed that a report may show to the speed known.
_EXCESS = 1.5
# Silence in s over which it may have gone on at that speed; motion without reports ends sooner.
_SILENCE = 0.2
# So many impossible positions in a row that continue each other mean that the register itself has changed.
_CHANGED = 5


class PositionJump(Exception):  # noqa: N818
    """The position register no longer continues what it was: the motor was reset or its origin shifted."""


class Rod:
    """Position and velocity of the rod; refuses positions that it cannot have reached.

    A rod that was not told to move cannot have moved, so that what counts is the speed commanded or seen, not the
    greatest possible.

    Attributes
    ----------
    time, position, velocity : float
        The last report believed: bench time s, m, m/s.
    """

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float]] = deque(maxlen=3)
        self._estimate = (0.0, 0.0)
        self._target: Target | None = None
        self._jumps = 0
        self._refused = (0.0, 0.0)
        self.time = float("-inf")
        self.position = float("nan")
        self.velocity = 0.0

    def place(self, time: float, position: float) -> None:
        """Put the rod at ``position`` m: a first report, or a new origin."""
        self._recent.clear()
        self._target, self._jumps, self.velocity = None, 0, 0.0
        self._accept(time, position)

    def report(self, time: float, position: float) -> bool:
        """Take a position report of bench time ``time``; false when it is not believed.

        Raises
        ------
        PositionJump
            When the reports insist.
        """
        if not self._reachable(self.time, self.position, time, position):
            continues = self._jumps and self._reachable(*self._refused, time, position)
            self._jumps = self._jumps + 1 if continues else 1
            self._refused = (time, position)
            if self._jumps >= _CHANGED:
                raise PositionJump(f"the motor's position jumped from {1e3 * self.position:.2f} to {1e3 * position:.2f} mm")
            return False
        self._jumps = 0
        self._accept(time, position)
        return True

    def predict(self, time: float) -> float:
        """Position in m expected at a bench time, from the last report and the command given."""
        begin, position = self._estimate
        return position + (self._target.travel(begin, time) if self._target and time > begin else 0.0)

    def command(self, target: Target | None) -> None:
        """Take note of the motion command that was sent, or with None that the motion was broken off."""
        if target is not None:
            self._estimate = (target.time, self.predict(target.time))
        self._target = target

    @property
    def commanded_velocity(self) -> float:
        """Velocity in m/s of the last command."""
        return self._target.velocity if self._target else self.velocity

    def _reachable(self, before: float, start: float, time: float, position: float) -> bool:
        speed = abs(self.velocity)
        if self._target is not None:
            speed = max(speed, abs(self._target.velocity), abs(self._target.start))
        return abs(position - start) <= _EXCESS * speed * min(_SILENCE, max(0.0, time - before)) + _SLACK

    def _accept(self, time: float, position: float) -> None:
        self._recent.append((time, position))
        (t0, p0), (t1, p1) = self._recent[0], self._recent[-1]
        if t1 > t0:
            self.velocity = (p1 - p0) / (t1 - t0)
        self.time, self.position = time, position
        self._estimate = (time, position)
