"""Trajectory generator, position loop and mechanics of the simulated motor."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_sim.motor.servo_axis import FOLLOWING_ERROR, RATE, MotorConfig, ServoAxis
from mrd_sim.motor.trajectory import plan_position, plan_velocity

CONFIG = MotorConfig()
positions = st.floats(-1e5, 1e5)
speeds = st.floats(1.0, 2e5)
rates = st.floats(10.0, 1e7)


def travel(plan, position, velocity):
    """End of a plan, and the greatest speed on the way."""
    fastest = abs(velocity)
    for duration, acceleration in plan:
        position += velocity * duration + acceleration * duration**2 / 2
        velocity += acceleration * duration
        fastest = max(fastest, abs(velocity))
    return position, velocity, fastest


@given(positions, st.floats(-2e5, 2e5), positions, speeds, rates, rates)
def test_plan_ends_at_rest_on_the_target(position, velocity, target, speed, up, down):
    plan = plan_position(position, velocity, target, speed, up, down)
    assert np.all(plan[:, 0] >= 0)
    end, rest, fastest = travel(plan, position, velocity)
    scale = max(1.0, abs(target - position), velocity**2 / down)
    assert end == pytest.approx(target, abs=1e-7 * scale)
    assert rest == pytest.approx(0, abs=1e-7 * max(abs(velocity), speed))
    assert fastest <= max(abs(velocity), speed) * (1 + 1e-9)


@given(st.floats(1.0, 1e5), speeds, rates, rates)
def test_rest_to_rest_takes_the_time_of_a_trapezoid(distance, speed, up, down):
    plan = plan_position(0.0, 0.0, -distance, speed, up, down)
    ramps = speed**2 / 2 * (1 / up + 1 / down)
    if ramps <= distance:
        expected = speed / up + speed / down + (distance - ramps) / speed
    else:
        expected = math.sqrt(2 * distance * (1 / up + 1 / down))
    assert plan[:, 0].sum() == pytest.approx(expected, rel=1e-9)


def test_velocity_plan_reverses_by_way_of_rest():
    plan = plan_velocity(-100.0, 50.0, 10.0, 20.0)
    assert plan.tolist() == [[5.0, 20.0], [5.0, 10.0], [math.inf, 0.0]]


def test_commanded_position_is_the_trapezoid_at_every_sample():
    axis = ServoAxis(CONFIG, 0.0, 0.1)
    axis.following_limit = math.inf
    speed, up, down, target = 40000.0, 250000.0, 400000.0, 12345.0
    axis.move_to(target, speed, up, down)
    commanded = []
    while axis.in_progress:
        axis.run(1)
        commanded.append(axis.commanded)
    t = np.arange(1, len(commanded) + 1) / RATE
    t1, t3 = speed / up, speed / down
    t2 = (target - speed * (t1 + t3) / 2) / speed
    end = t1 + t2 + t3
    expected = np.where(
        t < t1, up * t**2 / 2, np.where(t < t1 + t2, speed * (t - t1 / 2), target - down * np.maximum(end - t, 0) ** 2 / 2)
    )
    np.testing.assert_allclose(commanded, expected, rtol=0, atol=1e-6)
    assert commanded[-1] == target
    assert len(commanded) == math.ceil(end * RATE)


def test_actual_position_follows_by_the_lag_and_gives_way_to_the_load():
    axis = ServoAxis(CONFIG, 0.0, 0.1)
    axis.move_at(20000.0, 1e6, 1e6)
    axis.run(4000)
    assert (axis.commanded - axis.position) / 20000.0 == pytest.approx(CONFIG.lag, rel=0.02)
    axis.stop()
    axis.load = 500.0
    axis.run(8000)
    stiffness = CONFIG.inertia * (2 * math.pi * CONFIG.bandwidth) ** 2
    assert (axis.commanded - axis.position) * CONFIG.lead == pytest.approx(500.0 / stiffness, rel=1e-3)


def test_motion_of_the_rod_is_consistent():
    axis = ServoAxis(CONFIG, 0.0, 0.1)
    axis.move_to(15000.0, 30000.0, 1e6, 1e6)
    axis.run(8000)
    position, velocity, acceleration, stop_force = axis.take(8000)
    np.testing.assert_allclose(np.diff(velocity) * RATE, acceleration[1:], atol=1e-9)
    np.testing.assert_allclose(np.diff(position) * RATE, (velocity[1:] + velocity[:-1]) / 2, atol=1e-9)
    assert position[-1] == pytest.approx(15000 * math.pi * 0.064 / (40 * 8000), abs=1e-9)
    assert not stop_force.any()


def test_blocks_do_not_change_the_motion():
    whole, cut = ServoAxis(CONFIG, 0.0, 0.1), ServoAxis(CONFIG, 0.0, 0.1)
    for axis in (whole, cut):
        axis.move_to(9000.0, 30000.0, 1e6, 1e6)
    whole.run(5000)
    for samples in [1, 7, 80] * 60:
        cut.run(samples)
    np.testing.assert_allclose(cut.take(5000), whole.take(5000), rtol=0, atol=1e-7)


def test_a_drive_that_is_off_stands_still_under_load():
    axis = ServoAxis(CONFIG, 0.003, 0.055)
    axis.load = -400.0
    axis.run(8000)
    assert np.ptp(axis.take(8000)[0]) == 0.0


def test_switched_off_at_speed_the_shorted_windings_stop_the_rod():
    axis = ServoAxis(CONFIG, -0.02, 0.055)
    axis.move_at(30000.0, 1e6, 1e6)
    axis.run(4000)
    axis.off()
    axis.run(4000)
    axis.take(4000)
    after = axis.take(4000)
    assert abs(after[1, -1]) < 1e-6
    assert 0 < after[0, -1] - after[0, 0] < 0.001


@pytest.mark.parametrize("direction", [-1, 1])
def test_the_rod_stays_within_the_stroke_and_stands_against_its_end(direction):
    axis = ServoAxis(CONFIG, 0.0, 0.055)
    axis.move_at(direction * 30000.0, 1e6, 1e6)
    fault = 0
    while not fault:
        fault = axis.run(80)
    position, velocity, _, stop_force = axis.take(axis.stored)
    assert fault == FOLLOWING_ERROR
    assert direction * position[-1] == pytest.approx(0.0275)
    assert velocity[-1] == 0.0
    # The error of 1000 counts times the servo's stiffness: 1000 * 0.628 um * 17.7 MN/m, more than the peak force.
    assert direction * stop_force[-1] == pytest.approx(CONFIG.peak_force)


def test_a_jam_builds_up_following_error_until_it_trips():
    axis = ServoAxis(CONFIG, 0.0, 0.055)
    axis.jammed = True
    axis.move_at(20000.0, 1e9, 1e9)
    assert axis.run(8000) == FOLLOWING_ERROR
    # 1000 counts at 20000 counts/s: 50 ms.
    assert axis.stored == pytest.approx(0.05 * RATE, abs=3)
    assert axis.position == 0.0


def test_supply_voltage_bounds_the_speed():
    axis = ServoAxis(MotorConfig(supply_voltage=37.0), -0.4, 1.0)
    axis.following_limit = math.inf
    axis.move_at(2e6, 1e9, 1e9)
    axis.run(16000)
    # 5100 rpm at 48 V without load.
    assert axis.velocity * 60 / 8000 == pytest.approx(5100 * 37 / 48, rel=0.01)
    assert axis.pwm == pytest.approx(1.0, abs=0.02)


def test_work_heats_the_motor_and_rest_cools_it():
    axis = ServoAxis(CONFIG, 0.0, 0.055)
    axis.load = 2000.0
    axis.stop()
    axis.push(0.3)
    axis.jammed = True
    for _ in range(60):
        axis.run(8000)
        axis.take(8000)
    hot = axis.temperature
    axis.off()
    for _ in range(60):
        axis.run(8000)
        axis.take(8000)
    assert CONFIG.ambient < axis.temperature < hot
    assert hot > CONFIG.ambient + 1
