"""Who may move rod and coil, and when the lease is void."""

import dataclasses
import math

from hypothesis import given
from hypothesis import strategies as st

from mrd_base.lease import Lease, LeaseWatch, Mode, is_later

OWN = Lease(100.0, "one", 90.0, Mode.IDENTIFICATION, 7)


def watch(lease: Lease = OWN) -> LeaseWatch:
    watch = LeaseWatch(0.15)
    assert watch.renew(lease, lease.time) == ""
    return watch


def test_of_two_supervisors_the_later_one_ends() -> None:
    """Where the clock of the machine was set back between their starts, the earlier one ended."""
    assert is_later("a", 5.0, "b", 3600.0)
    assert not is_later("b", 3600.0, "a", 5.0)
    assert not is_later("a", 5.0, "a", 5.1), "its own lease"
    assert not is_later("b", 5.0, "a", math.nan), "a stranger's message"


@given(st.floats(0, 1e6), st.floats(-0.9, 0.9))
def test_of_two_supervisors_that_start_together_exactly_one_ends(age: float, more: float) -> None:
    assert is_later("a", age, "b", age + more) != is_later("b", age + more, "a", age)


def test_nobody_moves_anything_without_a_lease() -> None:
    lease = LeaseWatch(0.15)
    assert lease.reason_not_to_move(100.0).startswith("no supervisor watches")
    assert lease.reason_not_to_follow(0, 100.0)
    assert not lease.is_lost(100.0), "nothing moved"
    assert not lease.reason_not_to_change(100.0)


def test_each_mode_permits_what_it_needs() -> None:
    may_move = {mode for mode in Mode if not watch(dataclasses.replace(OWN, mode=mode)).reason_not_to_move(100.0)}
    assert may_move == {Mode.HOMING, Mode.IDENTIFICATION, Mode.CONTROL}
    may_follow = {mode for mode in Mode if not watch(dataclasses.replace(OWN, mode=mode)).reason_not_to_follow(7, 100.0)}
    assert may_follow == {Mode.IDENTIFICATION, Mode.CONTROL}
    may_change = {mode for mode in Mode if not watch(dataclasses.replace(OWN, mode=mode)).reason_not_to_change(100.0)}
    assert may_change == {Mode.IDLE, Mode.FAULT}


def test_setpoints_need_the_number_of_the_lease() -> None:
    lease = watch()
    assert lease.reason_not_to_follow(7, 100.0) == ""
    assert lease.reason_not_to_follow(0, 100.0) == "it carries lease 0, not 7"
    assert [lease.was_granted(number) for number in (7, 0, 6)] == [True, False, False]
    none = watch(dataclasses.replace(OWN, number=0))
    assert none.reason_not_to_follow(0, 100.0), "no number is none"
    # Those that were under way when the lease ended are no stranger's.
    lease.renew(dataclasses.replace(OWN, time=100.04, mode=Mode.IDLE, number=0), 100.04)
    assert lease.reason_not_to_follow(7, 100.04) == "the bench is in mode idle; call home, control or run_experiment of one"
    assert lease.was_granted(7)


def test_a_run_of_one_kind_permits_none_of_the_other_to_start() -> None:
    watch = LeaseWatch(0.15)
    assert watch.reason_not_to_start("controller", 100.0) == ""  # nobody is there who would follow it
    watch.renew(dataclasses.replace(OWN, source="generator"), 100.0)
    assert watch.reason_not_to_start("generator", 100.0) == ""
    assert "the bench is in mode identification; call stop of one" in watch.reason_not_to_start("controller", 100.0)
    assert watch.reason_not_to_start("controller", 101.0) == ""


def test_a_controller_does_not_join_in_where_somebody_controls_by_hand() -> None:
    """The supervisor would not apply the interlocks of a hybrid test."""
    by_hand = watch(dataclasses.replace(OWN, mode=Mode.CONTROL))
    assert by_hand.reason_not_to_follow(7, 100.0) == ""
    assert "the bench is in mode control; call stop of one" in by_hand.reason_not_to_start("controller", 100.0)


def test_a_lease_is_void_once_it_is_not_renewed() -> None:
    lease = watch()
    assert not lease.is_lost(100.149)
    assert lease.is_lost(100.151)
    assert lease.reason_not_to_move(100.151).startswith("no supervisor watches")
    lease.forget()
    assert not lease.is_lost(100.2), "it is answered once"
    # A supervisor that falls silent on an idle bench stops nothing.
    assert not watch(dataclasses.replace(OWN, mode=Mode.IDLE)).is_lost(200.0)


def test_neither_old_nor_future_stamps_renew_it() -> None:
    lease = watch()
    lease.renew(dataclasses.replace(OWN, time=100.01), 100.2)
    assert lease.is_lost(100.2)
    lease.renew(dataclasses.replace(OWN, time=1e9), 100.3)
    assert not lease.is_lost(100.4)
    assert lease.is_lost(100.5)


def test_a_second_supervisor_does_not_take_it() -> None:
    lease = watch()
    other = Lease(100.05, "two", 99.0, Mode.CONTROL, 8)
    assert lease.renew(other, 100.05) == "the lease of two is refused: one holds the bench; stop one of them"
    assert lease.lease.holder == "one"
    assert lease.renew(dataclasses.replace(other, time=100.3), 100.3) == ""
    assert lease.lease.holder == "two"


def test_a_stop_holds_until_the_procedure_ends() -> None:
    lease = watch()
    lease.revoke(100.0)
    assert lease.reason_not_to_follow(7, 100.0).startswith("somebody called a stop")
    # Neither a renewal nor the next step of the same procedure takes it back.
    lease.renew(dataclasses.replace(OWN, time=100.04), 100.04)
    assert lease.reason_not_to_move(100.04).startswith("somebody called a stop")
    lease.renew(dataclasses.replace(OWN, time=100.08, number=8), 100.08)
    assert lease.reason_not_to_follow(8, 100.08).startswith("somebody called a stop")
    lease.renew(dataclasses.replace(OWN, time=100.12, mode=Mode.IDLE, number=0), 100.12)
    lease.renew(dataclasses.replace(OWN, time=100.16, number=9), 100.16)
    assert lease.reason_not_to_follow(9, 100.16) == ""


def test_a_stop_before_the_homing_begins_is_not_lost() -> None:
    """The bench is in mode homing, which has no number, and the supervisor has not yet asked the servo to home."""
    lease = watch(dataclasses.replace(OWN, mode=Mode.HOMING, number=0))
    lease.revoke(100.0)
    assert lease.reason_not_to_move(100.0).startswith("somebody called a stop")


def test_a_stop_of_an_idle_bench_holds_for_a_procedure_whose_lease_is_under_way() -> None:
    idle = dataclasses.replace(OWN, mode=Mode.IDLE, number=0)
    lease = watch(idle)
    lease.revoke(100.0)
    lease.renew(dataclasses.replace(OWN, time=100.03), 100.03)
    assert lease.reason_not_to_move(100.03).startswith("somebody called a stop")
    lease.renew(dataclasses.replace(OWN, time=100.07), 100.07)
    assert lease.reason_not_to_move(100.07).startswith("somebody called a stop")
    lease.renew(dataclasses.replace(idle, time=100.1), 100.1)
    lease.revoke(100.1)
    lease.renew(dataclasses.replace(OWN, time=100.15), 100.15)
    assert lease.reason_not_to_move(100.15) == ""
