"""Streaming: schedules, horizons, motion commands, and the estimate of the rod's position."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_bench_driver.servo.rod_estimator import PositionJumpError, RodEstimator
from mrd_bench_driver.servo.smartmotor import Drivetrain, MotorUnits
from mrd_bench_driver.servo.streaming import Horizon, MotionCommand, RodSetpoint, plan_move, plan_streaming, setpoint_error
from mrd_trajectory.limits import Limits

LIMITS = Limits()
UNITS = MotorUnits(Drivetrain())


@pytest.mark.parametrize(
    ("baud_rate", "rate", "with_acceleration"),
    [(115200, 100, True), (57600, 75, True), (38400, 55, True), (19200, 30, True), (9600, 25, False)],
)
def test_rate_that_the_line_carries(baud_rate, rate, with_acceleration):
    schedule = plan_streaming(baud_rate, UNITS, LIMITS, 100.0)
    assert schedule.rate == rate
    assert schedule.with_acceleration is with_acceleration


def test_too_slow_a_line_is_refused():
    with pytest.raises(InputError, match="at least 9600"):
        plan_streaming(4800, UNITS, LIMITS, 100.0)


@given(st.floats(0.002, 0.04), st.floats(0.02, 0.2))
def test_horizon_is_ordered(tick, min_stop):
    horizon = Horizon(tick, min_stop)
    assert tick < horizon.coast < horizon.lead < horizon.stop
    assert horizon.stop <= max(0.2, 3 * tick)


numbers = st.floats(-1, 1, allow_nan=False)


@given(numbers, numbers, numbers, numbers, numbers, st.floats(0.005, 0.04), st.sampled_from([None, 3.3]))
def test_every_command_ends_near_and_soon(position, velocity, acceleration, error, before, tick, fixed):
    desired = RodSetpoint(0.0, position * LIMITS.reach, velocity * LIMITS.speed, acceleration * LIMITS.acceleration)
    rod = desired.position + error * 0.003
    horizon = Horizon(tick, 0.08)
    target = plan_move(desired, rod, before * LIMITS.speed, horizon, 10.0, LIMITS, fixed)
    assert abs(target.position) <= LIMITS.reach
    assert abs(target.velocity) <= LIMITS.speed
    fastest = abs(desired.velocity) + abs(desired.acceleration) * tick
    assert abs(target.position - rod) <= fastest * horizon.lead + 0.003 + 1e-12
    if fixed is None:
        assert (
            max(abs(target.velocity), abs(target.initial_velocity)) / target.acceleration
            <= horizon.stop - horizon.coast + 1e-12
        )


def test_a_standing_setpoint_is_the_target_itself():
    target = plan_move(RodSetpoint(0, 0.01, 0, 0), 0.0098, 0.0, Horizon(0.01, 0.08), 10.0, LIMITS)
    assert target.position == 0.01
    assert target.velocity == pytest.approx(0.002)


def test_travel_of_a_ramp():
    target = MotionCommand(10.0, 1.0, 0.05, 1.0, initial_velocity=0.03)
    assert target.travel(10.0, 10.02) == pytest.approx(0.02 * 0.04)
    assert target.travel(10.02, 10.12) == pytest.approx(0.1 * 0.05)
    assert target.travel(9.0, 10.0) == 0


@pytest.mark.parametrize(
    ("setpoint", "word"),
    [
        (RodSetpoint(0, 0.0261, 0, 0), "reach of ±26.00 mm"),
        (RodSetpoint(0, 0, -0.21, 0), "speed limit of 200.0 mm/s"),
        (RodSetpoint(0, 0, 0, math.inf), "finite"),
        (RodSetpoint(math.nan, 0, 0, 0), "finite"),
    ],
)
def test_setpoints_refused(setpoint, word):
    assert word in setpoint_error(setpoint, LIMITS)


def test_setpoints_at_the_limits_pass():
    assert setpoint_error(RodSetpoint(0, LIMITS.reach, LIMITS.speed, 0), LIMITS) == ""


def test_a_standing_rod_does_not_jump():
    rod = RodEstimator()
    rod.reset(0.0, 0.003)
    assert rod.update(0.01, 0.00301)
    # However long the silence: a rod that was not told to move has not moved.
    assert not rod.update(5.0, 0.005)
    assert rod.position == 0.00301
    assert rod.update(5.01, 0.00301)


def test_a_moving_rod_may_go_on_through_silence():
    rod = RodEstimator()
    rod.reset(0.0, 0.0)
    rod.set_command(MotionCommand(0.0, 0.02, 0.1, 10.0))
    assert rod.update(0.05, 0.005)
    assert rod.velocity == pytest.approx(0.1)
    assert rod.predict(0.06) == pytest.approx(0.006)


@given(st.floats(0.02, 0.2), st.floats(2.0, 10.0), st.floats(0.0, 0.012), st.floats(0.01, 0.02))
def test_a_rod_that_is_stopped_as_it_accelerates_brakes_without_a_jump(speed, acceleration, late, tick):
    """Its replies, which come later, still tell a slow rod."""
    rod = RodEstimator()
    rod.reset(0.0, 0.0)
    ramp = speed / acceleration
    stop = MotionCommand(ramp, 0.0, 0.0, acceleration, speed)  # what the motor does by itself

    def position(time):
        start = MotionCommand(0.0, 1.0, speed, acceleration)
        return start.travel(0.0, min(time, ramp)) + (stop.travel(ramp, time) if time > ramp else 0.0)

    now = 0.0
    while now < ramp:
        rod.set_command(MotionCommand(now, 1.0, acceleration * min(now + tick, ramp), acceleration, acceleration * now))
        now += tick
        if now + late < ramp:
            assert rod.update(now, position(now))
    rod.set_command(None)
    for k in range(30):
        time = ramp + late + tick * k
        assert rod.update(time, position(time))


def test_a_rod_that_was_stopped_does_not_jump_later():
    rod = RodEstimator()
    rod.reset(0.0, 0.0)
    rod.set_command(MotionCommand(0.0, 0.02, 0.1, 10.0))
    rod.set_command(None)
    assert rod.update(0.1, 0.002)
    assert rod.update(0.2, 0.002)
    assert not rod.update(0.3, 0.004)


def test_a_register_that_changed_is_noticed_noise_is_not():
    rod = RodEstimator()
    rod.reset(0.0, 0.0)
    for k in range(20):
        assert not rod.update(0.01 * k, 0.01 + 0.002 * (k % 3))
    for k in range(4):
        rod.update(1 + 0.01 * k, -0.012)
    with pytest.raises(PositionJumpError, match=r"0\.00 to -12\.00 mm"):
        rod.update(1.04, -0.012)


@given(st.lists(st.tuples(st.floats(0.001, 0.05), st.floats(-0.03, 0.03)), max_size=60))
def test_believed_positions_never_jump(reports):
    rod, now = RodEstimator(), 0.0
    rod.reset(now, 0.0)
    for wait, position in reports:
        now += wait
        before, since, speed = rod.position, now - rod.time, abs(rod.velocity)
        try:
            believed = rod.update(now, position)
        except PositionJumpError:
            return
        if believed:
            assert abs(rod.position - before) <= 1.5 * speed * since + 3e-4
        else:
            assert rod.position == before
