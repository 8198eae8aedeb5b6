"""A machine that is too slow is named. The bench times are scripted, so that no test can be late."""

from mrd_base import BenchClock
from mrd_bench_driver.supervision.punctuality import Punctuality, measure_punctuality


class ScriptedClock(BenchClock):
    """A clock that oversleeps by the next of some delays in s."""

    def __init__(self, *delays: float) -> None:
        self._now, self._delays = 1e9, list(delays)

    def now(self) -> float:
        return self._now

    def sleep(self, duration: float) -> None:
        self._now += duration + (self._delays.pop(0) if self._delays else 0.0)


def test_a_punctual_machine_has_no_problem() -> None:
    assert measure_punctuality(ScriptedClock(*[0.03] * 50), 0.04).problem() == ""


def test_a_machine_that_oversleeps_is_named_with_numbers_and_a_remedy() -> None:
    assert measure_punctuality(ScriptedClock(0.0, 0.09, 0.001, 0.05), 0.04).problem() == (
        "this machine is too slow: 2 of 50 cycles came more than 40 ms late, the worst 90 ms; end other programs, or give "
        "the bench a machine of its own"
    )


def test_only_delays_count_and_a_new_run_counts_anew() -> None:
    punctuality = Punctuality(0.02)
    for time in (0.0, 0.01, 0.05, 0.051, 0.06, 5.0):
        punctuality.note(time, 0.01)
    assert (punctuality.cycles, punctuality.late) == (6, 2)
    punctuality.restart()
    for time in (9.0, 9.01):
        punctuality.note(time, 0.01)
    assert punctuality.problem() == ""
