"""Damper tests: what they expand to, that it keeps the limits of a bench of any size, and what they refuse."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_trajectory.damper_tests import DAMPER_TESTS, damper_test_table
from mrd_trajectory.damper_tests.damper_test import rounded_down
from mrd_trajectory.damper_tests.endurance import Endurance, StopWhen, peak_force_change
from mrd_trajectory.experiment import Experiment, read_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import GeneratorSettings, read_settings
from mrd_trajectory.steps import experiments_of, is_damper_test, read_experiments, read_step
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trajectory.waveforms.triangle import Triangle

CONFIG = Path(__file__).parents[3] / "config"
BENCH = read_settings(CONFIG / "bench.yaml")
REQUIRED = {"endurance": {"cycles": 50, "every": 20}}


def write(folder: Path, test: str, **fields: Any) -> Path:
    path = folder / "t.yaml"
    path.write_text(yaml.safe_dump({"name": "t", "test": test, **REQUIRED.get(test, {}), **fields}))
    return path


def expand(folder: Path, test: str, bench: GeneratorSettings = BENCH, **fields: Any) -> list[Experiment]:
    return list(read_experiments(write(folder, test, **fields), bench))


def plan_all(experiments: list[Experiment]) -> list[Plan]:
    return [plan(one, BENCH.limits, BENCH.force_envelope) for one in experiments]


@st.composite
def benches(draw: st.DrawFn) -> GeneratorSettings:
    """Draw benches of 5 N to 400 kN and 1 mm to 0.5 m, with dampers that use a part of the force at rest."""

    def decades(lower: float, upper: float) -> float:
        return 10 ** draw(st.floats(math.log10(lower), math.log10(upper)))

    stroke, force = decades(1e-3, 0.5), decades(5, 4e5)
    speed = stroke * decades(0.2, 20)  # from a fifth of the stroke in a second to twenty of them
    acceleration = max(0.01, speed**2 / stroke * decades(0.1, 30))
    jerk = max(0.1, acceleration**2 / speed * decades(0.1, 10))
    current = decades(0.01, 10)
    limits = Limits(
        stroke, draw(st.floats(0, 0.1)) * stroke, speed, min(acceleration, 200), min(jerk, 1e6), force, 0.0, current
    )
    envelope = ForceEnvelope(
        offset=draw(st.floats(0, 0.3)) * force,
        yield_force=draw(st.floats(0, 0.4)) * force,
        yield_slope=force / current * decades(0.1, 10),
        viscosity=force / speed * decades(0.03, 3),
        viscosity_slope=force / speed / current * decades(0.03, 3),
    )
    return GeneratorSettings(setpoint_rate=100.0, limits=limits, force_envelope=envelope)


@pytest.mark.parametrize("test", DAMPER_TESTS)
@settings(max_examples=5)  # a plan of many turns takes a tenth of a second
@given(bench=benches())
def test_what_a_test_chooses_keeps_the_limits_of_any_bench(test: str, bench: GeneratorSettings) -> None:
    step = DAMPER_TESTS[test](name="t", **REQUIRED.get(test, {}))
    experiments = experiments_of(step, bench)
    assert len({one.name for one in experiments}) == len(experiments)
    for experiment in dict.fromkeys(replace(one, name="t", description="") for one in experiments):
        peaks = plan(experiment, bench.limits, bench.force_envelope).peaks
        assert all(peak.value <= peak.limit * (1 + 1e-6) for peak in peaks if peak.quantity != "least current")
        amplitude = experiment.rod.amplitude
        assert amplitude > 0.05 * bench.limits.reach or test == "speed_sweep"


@given(st.floats(1e-9, 1e9))
def test_a_chosen_level_is_never_rounded_up(value: float) -> None:
    assert 0.99 * value < rounded_down(value) <= value * (1 + 1e-9)


def test_the_shipped_acceptance_test_is_short_and_keeps_the_shipped_limits() -> None:
    files = sorted((CONFIG / "experiments/acceptance").glob("*.yaml"))
    experiments = [one for file in files for one in read_experiments(file, BENCH)]
    plans = plan_all(experiments)
    assert len({one.name for one in experiments}) == len(experiments)
    # An idle machine runs the simulated bench somewhat faster than real time, and homes before each run.
    assert sum(planned.duration for planned in plans) < 145
    kinds = [type(read_step(file)) for file in files]
    assert kinds == [DAMPER_TESTS[name] for name in ("warm_up", "gas_force", "seal_drag", "speed_sweep", "response_time")]


@pytest.mark.parametrize("test", ["speed_sweep", "response_time"])
def test_a_current_that_the_limits_allow_is_chosen_and_may_be_given(tmp_path: Path, test: str) -> None:
    limits = replace(BENCH.limits, current_max=20.0)
    envelope = replace(BENCH.force_envelope, yield_slope=1.0, viscosity_slope=0.0)
    bench = replace(BENCH, limits=limits, force_envelope=envelope)
    assert "20000 mA" in expand(tmp_path, test, bench)[-1].description
    assert "20000 mA" in expand(tmp_path, test, bench, currents_mA=[20000])[-1].description


def test_a_warm_up_has_a_cycle_in_each_pass(tmp_path: Path) -> None:
    (one,) = expand(tmp_path, "warm_up", cycles=30, until={"settled_percent": 1}, speed_mm_per_s=60, amplitude_mm=10)
    assert one.repeats == 30
    assert one.until is not None
    assert one.rod == Sine(0.01, 0.06 / (2 * math.pi * 0.01))
    assert one.duration == pytest.approx(1 / one.rod.frequency)
    (timed,) = expand(tmp_path, "warm_up", time_s=60, speed_mm_per_s=60, amplitude_mm=10)
    assert 60 <= timed.repeats * timed.duration < 60 + timed.duration


def test_slow_strokes_go_over_the_stroke_without_current_at_two_speeds(tmp_path: Path) -> None:
    gas, drag = expand(tmp_path, "gas_force"), expand(tmp_path, "seal_drag")
    assert all(isinstance(one.rod, Triangle) and one.coil.level == 0.0 for one in gas + drag)
    assert [one.rod.slope for one in gas] == [gas[0].rod.slope, gas[0].rod.slope / 2]
    assert gas[0].rod.amplitude == pytest.approx(0.97 * BENCH.limits.reach, rel=2e-3)
    assert drag[0].rod.slope < gas[1].rod.slope
    planned = plan(gas[0], BENCH.limits, BENCH.force_envelope)
    assert np.ptp(planned.at(planned.times()).position) > 0.95 * 2 * BENCH.limits.reach


@pytest.mark.parametrize("motion", ["sine", "triangle"])
def test_a_sweep_has_all_currents_at_each_speed(tmp_path: Path, motion: str) -> None:
    speeds, currents = [20, 100], [0, 50, 150]
    found = expand(tmp_path, "speed_sweep", speeds_mm_per_s=speeds, currents_mA=currents, motion=motion, cycles=4)
    for one, speed in zip(found, speeds, strict=True):
        planned = plan(one, BENCH.limits, BENCH.force_envelope)
        setpoints = planned.at(np.arange(*planned.body, 1e-3))
        assert np.abs(setpoints.velocity).max() == pytest.approx(1e-3 * speed, rel=1e-3)
        for current in currents:
            velocity = setpoints.velocity[np.isclose(setpoints.current, 1e-3 * current)]
            # Four whole cycles and that of the step have ten strokes, each half in both directions.
            assert np.mean(velocity > 0) == pytest.approx(0.5, abs=0.01)
            assert 9 <= np.count_nonzero(np.diff(np.sign(velocity))) <= 11


def test_the_current_is_switched_while_the_rod_moves_at_constant_speed(tmp_path: Path) -> None:
    (one,) = expand(tmp_path, "response_time", currents_mA=[200], cycles=3)
    planned = plan(one, BENCH.limits, BENCH.force_envelope)
    time = np.arange(*planned.body, 1e-3)
    setpoints = planned.at(time)
    steps = np.flatnonzero(np.diff(setpoints.current))
    assert len(steps) == 12  # two on and two off in each cycle
    assert np.abs(setpoints.velocity[steps]) == pytest.approx(one.rod.slope)
    assert np.count_nonzero(np.diff(setpoints.current) > 0) == 6


def test_an_endurance_test_is_characterised_before_and_after_each_block(tmp_path: Path) -> None:
    found = expand(tmp_path, "endurance", cycles=50, every=20, current_mA=100)
    names = [one.name.removeprefix("t_") for one in found]
    blocks = [(f"{n:03d}_cycles", f"{n:03d}_characterisation") for n in (1, 2, 3)]
    assert names == ["000_characterisation", *(name for block in blocks for name in block)]
    assert [one.repeats for one in found if one.name.endswith("cycles")] == [20, 20, 10]
    assert {one.coil for one in found if one.name.endswith("characterisation")} == {
        Staircase((0.0, 0.1), found[0].duration / 2)
    }


@given(change=st.floats(-0.9, 3.0), force=st.floats(1.0, 4e5), limit=st.floats(0.01, 1.0))
def test_a_change_of_the_peak_force_beyond_the_limit_ends_an_endurance_test(
    change: float, force: float, limit: float
) -> None:
    mapping = {"name": "t", "cycles": 2, "every": 1, "stop_when": StopWhen(limit)}
    test = Endurance(**mapping)
    wave = force * np.sin(np.arange(4000) / 50)
    recorded = {"t_000_characterisation": wave, "t_001_characterisation": (1 + change) * wave}
    assert peak_force_change(*recorded.values()) == pytest.approx(change, abs=1e-6)
    if abs(abs(change) - limit) > 1e-6:
        reason = test.reason_to_stop("t_001_characterisation", recorded.__getitem__)
        assert bool(reason) == (abs(change) > limit)
    assert test.decides
    assert test.reason_to_stop("t_000_characterisation", recorded.__getitem__) == ""
    assert test.reason_to_stop("t_001_cycles", recorded.__getitem__) == ""
    assert not Endurance(name="t", cycles=2, every=1).decides


def test_a_single_disturbed_sample_is_no_peak() -> None:
    force = 100 * np.sin(np.arange(4000) / 50)
    disturbed = force.copy()
    disturbed[7] = 1e4
    assert abs(peak_force_change(force, disturbed)) < 1e-3


@pytest.mark.parametrize(
    ("test", "fields", "line"),
    [
        ("speed_sweeps", {}, "unknown test speed_sweeps; did you mean speed_sweep?"),
        ("speed_sweep", {"cycles": 1}, "cycles: found 1, expected 2 to 1000"),
        ("response_time", {"cycles": 1}, "cycles: found 1, expected 2 to 1000"),
        ("gas_force", {"cycles": 1}, "cycles: found 1, expected 2 to 1000"),
        ("warm_up", {"cycles": 3, "until": {"settled_percent": 2}}, "cycles: found 3 cycles, expected at least 4 beside"),
        ("warm_up", {"cycles": 9, "until": {"settled_percent": 0}}, "settled_percent: found 0, expected 0.0001 to 100"),
        ("warm_up", {"cycles": 9, "time_s": 9}, "cycles and time_s are both given"),
        ("speed_sweep", {"speeds_mm_per_s": [20, 300]}, "speeds_mm_per_s: found 300, expected at most 200, the limit of"),
        ("warm_up", {"speed_mm_per_s": 300}, "speed_mm_per_s: found 300, expected at most 200"),
        ("speed_sweep", {"currents_mA": [0, 1500]}, "currents_mA: found 1500, expected at most 1000, the limit of"),
        ("speed_sweep", {"currents_mA": [-10, 0]}, "currents_mA: found -10, expected at least 0"),
        ("warm_up", {"current_mA": 1500}, "current_mA: found 1500, expected at most 1000"),
        ("speed_sweep", {"speeds_mm_per_s": [190], "currents_mA": [600]}, "exceeds 800 N; reduce"),
        ("speed_sweep", {"motion": "square"}, "motion: found 'square', expected sine or triangle"),
        ("gas_force", {"amplitude_mm": 30}, "amplitude_mm: found 30, expected at most 26, the reach of the bench"),
        ("gas_force", {"speeds_mm_per_s": [5]}, "speeds_mm_per_s: found one speed, expected two or more"),
        ("response_time", {"currents_mA": [0, 100]}, "currents_mA: found 0, expected currents that differ from 0"),
        ("endurance", {"cycles": 10, "every": 20}, "every: found 20, expected at most the 10 of cycles"),
        ("endurance", {"cycles": 10**6, "every": 1}, "makes 1000000 blocks, expected at most 999"),
        ("endurance", {"stop_when": {"peak_force_percent": 0}}, "peak_force_percent: found 0, expected 0.0001 to 1000"),
        ("warm_up", {"cycle": 5}, "unknown key cycle; did you mean cycles?"),
        ("warm_up", {"name": "a b"}, "name: found 'a b', expected 1 to 64 letters"),
    ],
)
def test_an_unusable_test_is_refused_in_one_line(tmp_path: Path, test: str, fields: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError, match=line) as caught:
        plan_all(expand(tmp_path, test, **fields))
    assert "\n" not in str(caught.value)


def test_a_damper_that_exceeds_the_limit_at_rest_leaves_no_level() -> None:
    weak = GeneratorSettings(limits=Limits(force=5.0))
    with pytest.raises(InputError, match=r"limits\.force_N: found 5, expected more than the 162 N"):
        experiments_of(DAMPER_TESTS["speed_sweep"](name="t"), weak)


def test_an_ordinary_experiment_is_a_step_of_its_own(tmp_path: Path) -> None:
    paper = CONFIG / "experiments/paper.yaml"
    assert read_experiments(paper, BENCH) == [read_experiment(paper)]
    assert not is_damper_test(paper)
    assert not is_damper_test(tmp_path / "none.yaml")
    assert is_damper_test(write(tmp_path, "warm_up"))
    with pytest.raises(InputError, match="is a damper test, which may have several experiments"):
        read_experiment(tmp_path / "t.yaml")


def test_every_parameter_is_in_the_table() -> None:
    rows = damper_test_table()
    assert {row.test for row in rows} == set(DAMPER_TESTS)
    assert all(row.key and row.meaning for row in rows)
    assert ("endurance", "every", "required") in {row[:3] for row in rows}
