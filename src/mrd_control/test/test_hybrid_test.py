"""Control experiments, the online loop, and the offline twin of a hybrid test."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_control.controller import Controller
from mrd_control.experiment import (
    ControlExperiment,
    format_control_experiment,
    parse_control_experiment,
    read_control_experiment,
)
from mrd_control.online import MEMORY, OnlineLoop, Prediction
from mrd_control.twin import check_experiment, run_twin
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
        ("offset: -45", "offset: [1]", "expected names with numbers"),
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
    with pytest.raises(InputError, match=r"it bears [\d.]+ ms at .* and has 80 ms .*; stable would be a total delay below"):
        check_experiment(late, Limits())


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
    expected = np.array([alone.step(experiment.base[k], experiment.base[k + 1], force[k], rod[k]) for k in range(240)])
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


@pytest.mark.parametrize(
    ("period", "force", "said"),
    [
        (0.002, [0.0], "samples come at 500 Hz, expected 1000 Hz"),
        (0.001, [0.0] * 20, "blocks of 20 ms, expected at most the cycle of 4 ms"),
        (0.001, [0.0, np.nan], "is no number"),
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
