"""When the bench must stop, and what it may do next."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError, from_mapping, read_node_parameters
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.errors import RefusedError, TrippedError
from mrd_bench_driver.supervision.interlocks import (
    CONTROL_INTERLOCKS,
    HOMING_INTERLOCKS,
    INTERLOCKS,
    RESET_INTERLOCKS,
    Tolerances,
    check_start_temperature,
    first_trip,
)
from mrd_bench_driver.supervision.modes import TRANSITIONS, BenchMode, Mode
from mrd_bench_driver.supervision.run_requests import control_run, single_run
from mrd_bench_driver.supervision.snapshot import Snapshot
from mrd_trajectory.limits import Limits

BENCH = Path(__file__).parents[3] / "config" / "bench.yaml"
LIMITS, TOLERANCES = Limits(), Tolerances()
HEALTHY = Snapshot(
    sample_age=0.03,
    position=0.01,
    force=100.0,
    speed=0.1,
    current=0.5,
    servo_age=0.02,
    servo=ServoStatus(position=0.01, velocity=0.1, following_error=0.0005, connected=True, homed=True),
)

within = st.builds(
    Snapshot,
    sample_age=st.floats(0, 0.1),
    position=st.floats(-0.02675, 0.02675),
    force=st.floats(-800, 800),
    speed=st.floats(-0.25, 0.25) | st.just(math.nan),
    current=st.floats(-0.1, 1.1),
    temperature=st.floats(213.16, 344.14),
    has_thermometer=st.booleans(),
    servo_age=st.floats(0, 0.15),
    servo=st.builds(
        ServoStatus,
        position=st.floats(-0.02675, 0.02675),
        velocity=st.floats(-0.25, 0.25),
        following_error=st.floats(-0.005, 0.005),
        connected=st.just(True),
        homed=st.just(True),
        message=st.sampled_from(["", "setpoints stopped"]),
    )
    | st.builds(ServoStatus, position=st.floats(), following_error=st.floats(), connected=st.just(True)),
    setpoint_age=st.floats(0, 0.15),
)


def changed(now: Snapshot, **values: object) -> Snapshot:
    """Replace values of a snapshot; ``servo_NAME`` is the field NAME of its servo, which is homed."""
    servo = {name.removeprefix("servo_"): value for name, value in values.items() if name.startswith("servo_")}
    age = {"servo_age": servo.pop("age")} if "age" in servo else {}
    others = {name: value for name, value in values.items() if not name.startswith("servo_")}
    if servo:
        # The numbers of a servo that is not homed do not count and may be anything.
        numbers = {} if now.servo.homed else {"position": 0.0, "following_error": 0.0}
        others["servo"] = dataclasses.replace(now.servo, **{"homed": True, **numbers, **servo})
    return dataclasses.replace(now, **age, **others)


@given(within)
def test_nothing_trips_within_the_limits(now: Snapshot) -> None:
    for interlocks in (INTERLOCKS, HOMING_INTERLOCKS, RESET_INTERLOCKS):
        assert first_trip(now, LIMITS, TOLERANCES, interlocks) is None


BEYOND = {
    "stale samples": {"sample_age": st.floats(0.1401, 1e6) | st.just(math.inf)},
    "lost servo": {"servo_age": st.floats(0.1501, 1e6) | st.sampled_from([math.inf, math.nan])},
    "servo fault": {"servo_fault": st.just(True)},
    "stale setpoint": {"setpoint_age": st.floats(0.1501, 1e6)},
    "position sensors": {"position_difference": st.floats(0.00201, 1) | st.floats(-1, -0.00201)},
    "stroke": {"position": st.floats(0.02676, 1) | st.floats(-1, -0.02676)},
    "speed": {"servo_velocity": st.floats(0.2501, 10) | st.floats(-10, -0.2501)},
    "force": {"force": st.floats(800.1, 1e5) | st.floats(-1e5, -800.1) | st.just(math.nan)},
    "following error": {"servo_following_error": st.floats(0.0051, 1) | st.floats(-1, -0.0051) | st.just(math.nan)},
    "current": {"current": st.floats(1.1001, 10) | st.floats(-10, -0.1001) | st.just(math.nan)},
    "temperature": {
        "has_thermometer": st.just(True),
        "temperature": st.floats(344.16, 1e4) | st.floats(0, 213.14) | st.just(math.nan),
    },
}


@given(now=within, name=st.sampled_from(sorted(BEYOND)), data=st.data())
def test_each_limit_trips_its_interlock_and_says_value_limit_and_remedy(
    now: Snapshot, name: str, data: st.DataObject
) -> None:
    beyond = {field: data.draw(values) for field, values in BEYOND[name].items()}
    trip = first_trip(changed(now, **beyond), LIMITS, TOLERANCES)
    assert trip is not None
    assert trip.interlock == name
    if name != "servo fault":
        assert re.search(r"limit|allowed", trip.message)
        assert "; " in trip.message
        assert "\n" not in trip.message


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"position": -0.0271}, "the rod is at -27.10 mm by the LVDT, limit ±26.75 mm"),
        ({"servo_position": 0.0271}, "the rod is at 27.10 mm by the encoder"),
        ({"speed": -0.3}, "the rod moves at -300 mm/s by the LVDT, limit 250 mm/s"),
        ({"servo_connected": False}, "the motor does not answer; check its power and the serial line"),
        ({"sample_age": math.inf}, "no sample came, limit 140 ms"),
        (
            {"sample_age": -3600.0},
            "the latest sample lies 3.6e+03 s in the future, limit 140 ms; the machine's clock was set",
        ),
        ({"position_difference": 0.0021, "position": 0.05}, "LVDT and encoder disagree by 2.10 mm, limit ±2 mm"),
        ({"servo_fault": True, "servo_message": "motor: over-temperature"}, "motor: over-temperature"),
        ({"servo_fault": True}, "the motor or its driver stopped"),
        ({"servo_stopped": True, "servo_message": "emergency stop"}, "emergency stop"),
        (
            {"setpoint_age": 0.16, "setpoint_lag": 0.2},
            "the latest setpoint is 160 ms old, limit 150 ms; those of the generator are stamped 0.2 s before they come, so "
            "that servo or daq do not follow them; the machine's clock was set",
        ),
        ({"temperature": 358.15, "has_thermometer": True}, "the damper has 85.0 degC, limit 71 degC; let it cool down"),
        (
            {"temperature": 23.15, "has_thermometer": True},
            "the damper's thermometer reads -250 degC, which no damper has, so that the limit of 71 degC cannot be watched",
        ),
        (
            {"temperature": math.nan, "has_thermometer": True},
            "the damper's thermometer is at the end of its range, so that the limit of 71 degC cannot be watched; check the "
            'sensor, its amplifier and wiring; if there is none, set channels.temperature.input: ""',
        ),
        ({"current": -0.2}, "-0.200 A through the coil, allowed -0.100 to 1.100 A"),
    ],
)
def test_a_trip_names_its_source(change: dict[str, Any], line: str) -> None:
    trip = first_trip(changed(HEALTHY, **change), LIMITS, TOLERANCES)
    assert trip is not None
    assert line in trip.message


@given(temperature=st.floats(-273.15, 1e3), has_thermometer=st.booleans())
def test_a_run_starts_within_the_window_of_temperatures(temperature: float, has_thermometer: bool) -> None:
    now = changed(HEALTHY, temperature=temperature + 273.15, has_thermometer=has_thermometer)
    message = check_start_temperature(now, TOLERANCES)
    assert (message == "") == (not has_thermometer or 0.0 <= now.temperature - 273.15 <= 60.0)
    if message and -60 <= temperature <= 220:
        assert "degC, allowed 0 to 60 degC; wait, or change start_temperature_low_degC" in message


def test_without_a_thermometer_nothing_asks_for_a_temperature() -> None:
    assert HEALTHY.has_thermometer is False
    assert first_trip(HEALTHY, LIMITS, TOLERANCES) is None
    assert check_start_temperature(HEALTHY, TOLERANCES) == ""


def test_a_window_that_no_run_fits_into_is_refused() -> None:
    with pytest.raises(InputError, match="start_temperature_low_degC is 50, start_temperature_high_degC 40 and"):
        Tolerances(start_temperature_low=50.0, start_temperature_high=40.0)
    with pytest.raises(InputError, match="temperature_max_degC 50, expected"):
        Tolerances(temperature_max=50.0)


def test_silent_sources_come_before_their_last_values() -> None:
    trip = first_trip(changed(HEALTHY, sample_age=1.0, force=5000.0), LIMITS, TOLERANCES)
    assert trip is not None
    assert trip.interlock == "stale samples"


def test_homing_may_begin_beyond_the_limit_of_the_stroke_but_not_where_the_damper_cannot_be() -> None:
    at_the_end = changed(HEALTHY, position=0.0276, servo_homed=False)
    assert first_trip(at_the_end, LIMITS, TOLERANCES, HOMING_INTERLOCKS) is None
    assert first_trip(at_the_end, LIMITS, TOLERANCES) is not None
    for position in (0.0295, math.nan):
        trip = first_trip(changed(HEALTHY, position=position), LIMITS, TOLERANCES, HOMING_INTERLOCKS)
        assert trip is not None
        assert trip.interlock == "stroke"


def test_homing_does_not_compare_the_position_sensors_because_it_sets_one_by_the_other() -> None:
    assert first_trip(changed(HEALTHY, position_difference=0.01), LIMITS, TOLERANCES, HOMING_INTERLOCKS) is None


def test_a_fault_may_be_reset_beyond_the_stroke_and_with_the_servo_in_fault_but_not_blind() -> None:
    stuck = changed(HEALTHY, position=0.0276, servo_fault=True, servo_following_error=0.01)
    assert first_trip(stuck, LIMITS, TOLERANCES, RESET_INTERLOCKS) is None
    assert first_trip(changed(stuck, servo_connected=False), LIMITS, TOLERANCES, RESET_INTERLOCKS) is not None
    assert first_trip(changed(stuck, sample_age=1.0), LIMITS, TOLERANCES, RESET_INTERLOCKS) is not None


def test_a_bench_that_has_published_nothing_is_not_healthy() -> None:
    assert first_trip(Snapshot(), LIMITS, TOLERANCES) is not None


def test_the_shipped_tolerances_are_the_defaults() -> None:
    parameters = read_node_parameters(BENCH, "supervisor")
    assert from_mapping(Tolerances, parameters["interlocks"], "interlocks") == TOLERANCES


def test_no_setpoint_that_servo_or_daq_ignores_is_a_sign_of_life() -> None:
    timeouts = {node: read_node_parameters(BENCH, node)["setpoint_timeout_ms"] for node in ("servo", "daq", "supervisor")}
    assert timeouts["supervisor"] == min(timeouts.values())


# Modes


@given(st.lists(st.sampled_from(Mode)))
def test_a_fault_is_left_to_idle_only_and_can_always_come(wishes: list[Mode]) -> None:
    changes: list[Mode] = []
    bench = BenchMode(lambda mode: changes.append(mode.current))
    for wish in wishes:
        before = bench.current
        if wish in TRANSITIONS[before]:
            assert before is not Mode.FAULT or wish is Mode.IDLE
            # The rod never passes from one activity to another that nobody armed.
            assert not (before in (Mode.IDENTIFICATION, Mode.CONTROL) and wish.may_move)
            bench.enter(wish, "wish")
            assert bench.current is changes[-1] is wish
        else:
            assert wish is not Mode.FAULT or before is Mode.FAULT
            with pytest.raises(TrippedError if before is Mode.FAULT else RefusedError):
                bench.enter(wish, "wish")
            assert bench.current is changes[-1] is before


def test_every_mode_is_reached_and_left_to_idle() -> None:
    assert {mode for targets in TRANSITIONS.values() for mode in targets} == set(Mode)
    assert all(Mode.IDLE in targets for mode, targets in TRANSITIONS.items() if mode is not Mode.IDLE)


def test_a_refused_mode_says_what_to_do_first_and_the_first_fault_stays() -> None:
    bench = BenchMode(lambda _mode: None)
    bench.enter(Mode.CONTROL, "control")
    with pytest.raises(RefusedError, match="cannot go from control to identification; call stop first"):
        bench.enter(Mode.IDENTIFICATION, "run_experiment")
    with pytest.raises(RefusedError, match=r"in mode control \(control\); call stop first"):
        bench.require_idle()
    assert bench.trip("force")
    assert not bench.trip("speed")
    bench.leave("stopped")
    with pytest.raises(TrippedError, match="force"):
        bench.enter(Mode.HOMING, "home")
    with pytest.raises(TrippedError, match="force"):
        bench.require_no_fault()
    with pytest.raises(RefusedError, match=r"in mode fault \(force\); remove the cause, then call reset_fault"):
        bench.require_idle()


def test_modes_have_the_numbers_of_the_message() -> None:
    messages = pytest.importorskip("mrd_interfaces.msg")
    assert {mode.name: int(mode) for mode in Mode} == {mode.name: getattr(messages.BenchState, mode.name) for mode in Mode}


@pytest.mark.parametrize(
    ("change", "interlock", "said"),
    [
        ({"power": 130.0}, "power", "130 W into the damper, limit 120 W"),
        (
            {"work": -2.5},
            "energy balance",
            "have given 2.5 J within half a second, limit 2 J; the hybrid loop is becoming unstable",
        ),
        ({"work": math.nan}, "energy balance", "have given nan J"),
        ({"setpoint_age": 0.2, "setpoint_source": "controller"}, "stale setpoint", "check the controller"),
    ],
)
def test_a_hybrid_test_has_interlocks_of_its_own(change: dict[str, Any], interlock: str, said: str) -> None:
    assert first_trip(HEALTHY, LIMITS, TOLERANCES, CONTROL_INTERLOCKS) is None
    trip = first_trip(dataclasses.replace(HEALTHY, **change), LIMITS, TOLERANCES, CONTROL_INTERLOCKS)
    assert trip is not None
    assert trip.interlock == interlock
    assert said in trip.message


@pytest.mark.parametrize("text", ["name: a/b", "duration_s: 3", "[1, 2]", "/no/such/file.yaml", "/dev/zero", "name: ["])
def test_a_hybrid_test_without_a_usable_name_is_refused(text: str, tmp_path: Path) -> None:
    assert control_run("name: car", "", 0, tmp_path).name.startswith("car-")
    with pytest.raises(RefusedError) as error:
        control_run(text, "", 0, tmp_path)
    assert "\n" not in str(error.value)


def test_a_goal_that_names_a_device_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match=r"^/dev/zero: is not a file, expected a YAML file$"):
        single_run("/dev/zero", "", 0, tmp_path)
