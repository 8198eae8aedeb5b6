"""Control experiments, the online loop, and the offline twin of a hybrid test."""

import copy
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.interlocks import CONTROL_INTERLOCKS, Tolerances, first_trip
from mrd_bench_driver.supervision.snapshot import Snapshot
from mrd_control.controller import Controller
from mrd_control.experiment import (
    ControlExperiment,
    format_control_experiment,
    parse_control_experiment,
    read_control_experiment,
)
from mrd_control.online import MEMORY, OnlineLoop, Prediction
from mrd_control.twin import check_experiment, run_twin
from mrd_sim.damper import Damper
from mrd_trajectory.limits import Limits

SHIPPED = Path(__file__).resolve().parents[3] / "config/control/hybrid_test.yaml"


@pytest.fixture(scope="module")
def shipped() -> ControlExperiment:
    return read_control_experiment(SHIPPED)


def test_the_text_of_an_experiment_is_complete(shipped):
    text = format_control_experiment(shipped)
    again = parse_control_experiment(text, "again")
    assert format_control_experiment(again) == text
    assert np.array_equal(again.damper.theta, shipped.damper.theta)
    assert np.array_equal(again.base, shipped.base)


def test_the_text_of_an_experiment_with_a_recorded_excitation_needs_no_file(tmp_path):
    """The recording of a test can be reviewed elsewhere, when the file is gone."""
    road = tmp_path / "road.csv"
    time = np.linspace(0.0, 12.0, 301)
    rows = [f"{t:.3f},{0.01 * np.sin(3.0 * t):.9f}" for t in time]
    road.write_text("\n".join(["time_s,position_m", *rows]))
    sweep = "excitation: {excitation: sine_sweep, amplitude_mm: 55, start_hz: 0.5, end_hz: 4}"
    text = SHIPPED.read_text()
    assert sweep in text
    (tmp_path / "test.yaml").write_text(text.replace(sweep, "excitation: {excitation: recorded_profile, file: road.csv}"))
    experiment = read_control_experiment(tmp_path / "test.yaml")
    complete = format_control_experiment(experiment)
    expected = experiment.base
    road.unlink()
    assert np.array_equal(parse_control_experiment(complete, "bag").base, expected)
    assert np.ptp(expected[:, 0]) > 0.015


def test_the_base_moves_as_excited_and_comes_to_rest(shipped):
    free = shipped.excitation.base(shipped.samples, shipped.rate)
    assert np.array_equal(shipped.base[: shipped.counted.stop], free[: shipped.counted.stop])
    assert np.allclose(shipped.base[-1], 0.0)
    # The faded velocity is the derivative of the faded position.
    assert np.gradient(shipped.base[:, 0], 1e-3)[1:-1] == pytest.approx(shipped.base[1:-1, 1], abs=2e-3)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("law: skyhook", "law: skyhok", "skyhok"),
        ("skyhook_viscous: 3000", "skyhok_viscous: 3000", "skyhok_viscous"),
        ("predictor: model", "predictor: oracle", "oracle"),
        ("sprung_mass_kg: 320", "sprung_mass_kg: -320", "sprung_mass_kg: found -320"),
        ("model: bouc_wen", "fit: none.json\n  model: bouc_wen", "expected {fit: FILE}, or {model: ID"),
        ("duration_s: 10", "duration_s: 1", "duration_s: found 1, expected 5"),
        ("name: quarter_car_skyhook", "name: a/b", "letters, digits"),
        ("offset: -45", "offset: [1]", "offset is [1], expected a finite number"),
        ("offset: -45", "offset: true", "offset is True, expected a finite number"),
        ("model: bouc_wen", "model: bouc_wen\n  effects: [coil_lag]", "effects is ['coil_lag'], expected {NAME: VALUE}"),
        ("model: bouc_wen", "model: bouc_wen\n  effects: {coil_lag: 3}", "coil_lag is 3, expected {NAME: VALUE}"),
        ("model: bouc_wen", "model: bouc_wen\n  laws: [tanh]", "laws is ['tanh'], expected a current law"),
        ("model: bouc_wen", "model: bouc_wen\n  laws: {viscous: [1]}", "expected a current law"),
        ("skyhook_viscous: 3000", "skyhook_viscous: much", "skyhook_viscous is 'much', expected a finite number"),
        ("skyhook_viscous: 3000", "skyhook_viscous: [1]", "skyhook_viscous is [1], expected a finite number"),
        ("skyhook_viscous: 3000", "skyhook_viscous: null", "skyhook_viscous is None, expected a finite number"),
        ("skyhook_viscous: 3000", "skyhook_viscous: true", "skyhook_viscous is True, expected a finite number"),
        ("skyhook_viscous: 3000", "skyhook_viscous: .nan", "skyhook_viscous is nan, expected a finite number"),
        ("skyhook_viscous: 3000", f"skyhook_viscous: 1{'0' * 400}", "expected a finite number"),
        ("skyhook_viscous: 3000", "skyhook_viscous: 0", "skyhook_viscous is 0 N s/m, expected 1 to 1e+06"),
        ("gains: {skyhook_viscous: 3000}", "gains: [1]", "gains: found list [1], expected dict"),
        ("system: quarter_car", "system: [quarter_car]", "unknown system ['quarter_car']"),
        ("excitation: sine_sweep", "excitation: {a: 1}", "unknown excitation {'a': 1}"),
        ("amplitude_mm: 55", "amplitude_mm: true", "amplitude_mm: found bool True"),
        (
            "excitation: sine_sweep, amplitude_mm: 55, start_hz: 0.5, end_hz: 4",
            "excitation: recorded_profile, file: a.csv",
            "file a.csv is relative, and its folder is not known here",
        ),
        ("lag_ms: 2 ", "rate_hz: 50\nlag_ms: 2 ", "cycle_ms is 4, expected at least 20, one sample at rate_hz 50"),
    ],
)
def test_bad_input_is_refused_in_one_line(old, new, said):
    text = SHIPPED.read_text()
    assert old in text
    with pytest.raises(InputError) as error:
        parse_control_experiment(text.replace(old, new), "car.yaml")
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("car.yaml")


def test_an_unstable_loop_is_refused_with_the_number_and_what_would_help(shipped):
    stiff = replace(shipped.system, passive_damping=0.0, lever_ratio=1.0)
    late = replace(shipped, system=stiff, delay=0.08, lag=0.0, predictor="none")
    with pytest.raises(
        InputError, match=r"it is stable up to a delay of [\d.]+ ms and has 81.5 ms .*; stable would be a total delay below"
    ):
        check_experiment(late, Limits())


def test_long_blocks_of_samples_cost_margin(shipped):
    """A setpoint of 20 ms is older than one of a sample by 9.5 ms on the average."""
    car = replace(shipped.system, passive_damping=0.0, lever_ratio=0.5)
    calm = replace(shipped.excitation, amplitude=0.004)
    test = replace(shipped, system=car, excitation=calm, predictor="none", lag=0.0, cycle=0.001, most_current=0.1)
    margin, _ = check_experiment(replace(test, delay=0.0), Limits())
    near = replace(test, delay=margin.delay - 0.005)
    assert check_experiment(near, Limits())[0].delay == pytest.approx(margin.delay)
    has = 1e3 * (margin.delay - 0.005 + 0.0095)
    with pytest.raises(InputError, match=f"the hybrid loop is unstable: at .* and has {has:.3g} ms"):
        check_experiment(replace(near, cycle=0.02), Limits())


def test_a_motion_beyond_the_limits_of_the_bench_is_refused(shipped):
    with pytest.raises(InputError, match=r"the offline twin has a force of .* N at .* s, limit ±100 N"):
        check_experiment(shipped, replace(Limits(), force=100.0))
    with pytest.raises(InputError, match=r"most_current_A is 0.4, expected at most 0.2"):
        check_experiment(shipped, replace(Limits(), current_max=0.2))


def test_the_online_loop_is_the_controller_whatever_the_blocks(shipped):
    experiment = replace(shipped, predictor="none", delay=0.0, lag=0.0)
    random = np.random.default_rng(1)
    force, rod = 100.0 * random.standard_normal(240), 1e-3 * random.standard_normal(240)
    alone = Controller(
        experiment.system.linear(),
        experiment.damper,
        experiment.control_law,
        experiment.rate,
        experiment.actuator,
        experiment.gains,
        experiment.most_current,
    )
    _, _, expected = alone.add_block(experiment.base[:241], force, rod)
    for size in (1, 3, 4):
        loop = OnlineLoop(experiment)
        cycles = [loop.add_block(0.001 * k, 0.001, force[k : k + size], rod[k : k + size]) for k in range(0, 240, size)]
        assert np.array_equal(np.concatenate([cycle.commanded for cycle in cycles]), expected[:, 0])
        assert np.array_equal(np.concatenate([cycle.command for cycle in cycles]), expected[:, 1])
        assert cycles[-1].position == expected[-1, 1]
        assert cycles[-1].time == pytest.approx(0.24)


def test_a_system_predicts_its_motion_exactly_while_the_force_stays(shipped):
    loop, ahead = OnlineLoop(replace(shipped, predictor="none", delay=0.0, lag=0.0)), 0.019
    for k in range(3000):
        loop.add_block(0.001 * k, 0.001, np.array([30.0]), np.zeros(1))
    predicted = Prediction(shipped, shipped.base, ahead).motion(loop.state, 30.0, loop.samples)
    for k in range(3000, 3020):
        cycle = loop.add_block(0.001 * k, 0.001, np.array([30.0]), np.zeros(1))
    # The last cycle saw the motion 19 ms later.
    assert cycle.travel[0] == pytest.approx(predicted[0], rel=1e-6)


def test_a_setpoint_of_a_predicted_motion_is_for_later(shipped):
    cycle = OnlineLoop(shipped).add_block(5.0, 0.001, np.zeros(4), np.zeros(4))
    assert cycle.time == pytest.approx(5.004 + shipped.delay)


def test_a_damper_that_gives_energy_shows_in_the_work(shipped):
    given = []
    for sign in (1.0, -1.0):
        loop, speed, works = OnlineLoop(shipped), 0.0, []
        for k in range(4000):
            cycle = loop.add_block(0.001 * k, 0.001, np.array([sign * 400.0 * speed]), np.zeros(1))
            speed, _ = (cycle.travel[0] - given[-1]) / 0.001 if k else 0.0, given.append(cycle.travel[0])
            works.append(cycle.work)
        given.clear()
        assert min(sign * work for work in works) > -0.01
        assert max(sign * work for work in works) > 0.02
    assert MEMORY == 0.5


def late_loop(experiment, delay, limits, tolerances):
    """Run a test whose rod is late by a dead time that nobody compensates; return the first interlock that trips, and when.

    The interlocks see the largest position and force of a block and its speed, as on the bench.
    """
    loop, damper = OnlineLoop(experiment), copy.copy(experiment.damper)
    size, period = round(experiment.block * experiment.rate), 1.0 / experiment.rate
    commands, before = np.zeros(experiment.samples + 1), np.zeros(3)
    for begin in range(0, experiment.samples - size, size):
        k = np.arange(begin, begin + size)
        rod = np.interp(k * period - delay, period * np.arange(len(commands)), commands)
        path = np.concatenate([before, rod])
        speed = (3.0 * path[3:] - 4.0 * path[2:-1] + path[1:-2]) / (2.0 * period)
        force = damper.advance(period, rod, speed, np.zeros(size), np.full(size, 0.2))
        before = path[-3:]
        cycle = loop.add_block(begin * period, period, force, rod)
        commands[k + 1] = cycle.command
        commands[begin + size + 1 :] = commands[begin + size]
        now = Snapshot(
            sample_age=0.0,
            position=rod[np.argmax(np.abs(rod))],
            force=force[np.argmax(np.abs(force))],
            speed=speed.mean(),
            current=0.2,
            servo_age=0.0,
            servo=ServoStatus(connected=True),
            work=cycle.work,
            power=cycle.power,
        )
        if trip := first_trip(now, limits, tolerances, CONTROL_INTERLOCKS):
            return trip, begin * period
    return None, math.inf


@pytest.mark.parametrize("wheel", [40.0, 80.0])
def test_a_loop_that_is_later_than_declared_trips_the_balance_of_energy_first(shipped, wheel):
    """The check before the run believes what is declared; the loop then grows, and no other interlock is quicker."""
    car = replace(shipped.system, unsprung_mass=wheel, passive_damping=0.0, lever_ratio=0.5)
    calm = replace(shipped.excitation, amplitude=0.004, start=1.2, end=1.3)
    test = replace(shipped, system=car, excitation=calm, predictor="none", delay=0.0, lag=0.0)
    test = replace(test, law="constant_current", gains={"current": 0.2}, most_current=0.2)
    margin, _ = check_experiment(test, Limits())
    late = 1.4 * margin.delay
    assert late_loop(test, 0.5 * margin.delay, Limits(), Tolerances()) == (None, math.inf)
    trip, when = late_loop(test, late, Limits(), Tolerances())
    assert trip.interlock == "energy balance"
    # Without this interlock the loop goes on growing, until others trip.
    other, later = late_loop(test, late, Limits(), Tolerances(energy=1e6))
    assert other.interlock in ("stroke", "speed", "force", "power")
    assert later > when


def test_a_passive_damper_gives_less_than_the_balance_of_energy_allows():
    """A gas force of 162 N, more than any in the recorded data, moves a rod with little friction at the worst speed."""
    damper = Damper("bouc_wen", {"yield_force": 50.0, "viscous": 900.0, "stiffness": 0.0, "offset": -162.0})
    speed, period = 112.0 / 1800.0, 1e-3
    work = least = 0.0
    for k in range(800):
        force = damper.advance(period, np.array([speed * k * period]), np.array([speed]), np.zeros(1), np.zeros(1))
        work = math.exp(-period / MEMORY) * work + force[0] * speed * period
        least = min(least, work)
    assert -Tolerances().energy < least < -1.0


@pytest.mark.parametrize(
    ("period", "force", "said"),
    [
        (0.002, [0.0], "samples come at 500 Hz, expected 1000 Hz"),
        (0.001, [0.0] * 20, "blocks of 20 ms, expected at most the cycle of 4 ms"),
        (0.001, [0.0, np.nan], "is not a number"),
    ],
)
def test_samples_that_cannot_be_used_end_the_loop(shipped, period, force, said):
    with pytest.raises(InputError, match=said):
        OnlineLoop(shipped).add_block(0.0, period, np.array(force), np.zeros(len(force)))


def test_the_twin_in_blocks_is_that_of_the_compiled_loop(shipped):
    """Two twins of the same test, by different code; they differ by when the current is sent."""
    in_blocks = run_twin(replace(shipped, cycle=0.001))
    compiled = run_twin(replace(shipped, predictor="none", delay=0.0, lag=0.0))
    kept = shipped.counted
    difference = in_blocks.travel[kept] - compiled.travel[kept]
    assert np.std(difference) < 0.01 * np.std(compiled.travel[kept])
