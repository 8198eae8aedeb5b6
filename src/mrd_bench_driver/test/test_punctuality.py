"""A machine that is too slow is named. The bench times are scripted, so that no test can be late."""

from mrd_bench_driver.supervision.punctuality import Punctuality


def noted(*delays: float) -> Punctuality:
    """Return what is known of cycles that came late by these delays in s."""
    punctuality, now = Punctuality(0.04), 1e9
    for delay in delays:
        now += 0.01 + delay
        punctuality.note(now, 0.01)
    return punctuality


def test_a_punctual_machine_has_no_problem() -> None:
    assert noted(*[0.03] * 50).problem(1e9 + 50 * 0.04) == ""


def test_a_late_cycle_is_named_with_numbers_and_a_remedy() -> None:
    assert noted(0.0, 0.09, 0.001, 0.05).problem(0.0) == (
        "this machine is too slow: 2 of 4 cycles came more than 40 ms late, the worst 90 ms; end other programs, or give "
        "the bench a machine of its own"
    )


def test_only_delays_count_and_a_new_run_counts_anew() -> None:
    punctuality = Punctuality(0.02)
    for time in (0.0, 0.01, 0.05, 0.051, 0.06, 5.0):
        punctuality.note(time, 0.01)
    assert (punctuality.cycles, punctuality.late) == (6, 2)
    punctuality.restart()
    for time in (5.01, 5.02):
        punctuality.note(time, 0.01)
    assert punctuality.problem(5.03) == ""


def test_a_pause_that_touches_either_end_of_a_measurement_is_seen() -> None:
    punctuality = noted(0.0, 0.0)
    punctuality.restart()
    punctuality.note(1e9 + 0.32, 0.01)
    assert "1 of 1 cycles came more than 40 ms late, the worst 290 ms" in punctuality.problem(1e9 + 0.32)
    punctuality.restart()
    assert "1 of 1 cycles came more than 40 ms late, the worst 240 ms" in punctuality.problem(1e9 + 0.57)
