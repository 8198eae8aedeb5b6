"""Plans keep every limit, are continuous and go from rest to rest; the remedies of refusals work."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import assume, event, given, settings
from hypothesis import strategies as st

from mrd_base import InputError, from_mapping
from mrd_trajectory.experiment import Experiment, parse_experiment, read_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan, plan_scaled
from mrd_trajectory.settings import GeneratorSettings, read_settings
from mrd_trajectory.waveforms import Constant
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trajectory.waveforms.triangle import Triangle

LIMITS, ENVELOPE = Limits(), ForceEnvelope()
CONFIG = Path(__file__).parents[3] / "config"


def refusal(*args, **kwargs):
    """Message of the refusal of an experiment; None when it is planned."""
    try:
        planned(*args, **kwargs)
    except InputError as error:
        return str(error)
    return None


def planned(rod=None, coil=None, limits=LIMITS, folder=None, **more):
    mapping = {"name": "t", "duration_s": 4.0, "rate_hz": 100.0, **more}
    mapping |= {key: value for key, value in (("rod", rod), ("coil", coil)) if value}
    return plan(parse_experiment(yaml.safe_dump(mapping), "t.yaml", folder), limits, ENVELOPE)


def numbers(low, high):
    return st.floats(low, high).map(lambda value: float(f"{value:.6g}"))


RODS = st.one_of(
    st.fixed_dictionaries(
        {"waveform": st.just("sine"), "amplitude_mm": numbers(0, 30), "frequency_hz": numbers(0.05, 4)},
        optional={"offset_mm": numbers(-10, 10)},
    ),
    st.fixed_dictionaries(
        {"waveform": st.just("triangle"), "amplitude_mm": numbers(1, 28), "slope_mm_per_s": numbers(1, 220)},
        optional={"offset_mm": numbers(-10, 10)},
    ),
    st.fixed_dictionaries(
        {
            "waveform": st.just("staircase"),
            "levels_mm": st.lists(numbers(-27, 27), min_size=1, max_size=5),
            "hold_s": numbers(0.2, 2),
        }
    ),
    st.fixed_dictionaries(
        {
            "waveform": st.just("ramp"),
            "start_mm": numbers(-25, 25),
            "end_mm": numbers(-25, 25),
            "slope_mm_per_s": numbers(5, 150),
            "dwell_s": numbers(0, 1),
        }
    ),
    st.fixed_dictionaries(
        {
            "waveform": st.just("chirp"),
            "amplitude_mm": numbers(0.5, 15),
            "start_hz": numbers(0.1, 3),
            "end_hz": numbers(0.1, 5),
            "constant_speed": st.booleans(),
        }
    ),
    st.fixed_dictionaries(
        {
            "waveform": st.just("multisine"),
            "amplitude_mm": numbers(1, 25),
            "lowest_hz": numbers(0.1, 1),
            "highest_hz": numbers(2, 5),
            "period_s": st.just(4.0),
            "seed": st.integers(0, 100),
        }
    ),
    st.fixed_dictionaries(
        {
            "waveform": st.just("prbs"),
            "low_mm": numbers(-9, 0),
            "high_mm": numbers(0, 9),
            "bit_s": numbers(0.1, 1),
            "seed": st.integers(0, 9),
        }
    ),
)
COILS = st.one_of(
    st.fixed_dictionaries(
        {"waveform": st.just("prbs"), "low_mA": numbers(0, 100), "high_mA": numbers(100, 500), "bit_s": numbers(0.01, 0.5)}
    ),
    st.fixed_dictionaries(
        {
            "waveform": st.just("sine"),
            "amplitude_mA": numbers(0, 200),
            "frequency_hz": numbers(0.1, 20),
            "offset_mA": numbers(150, 300),
        }
    ),
    st.fixed_dictionaries(
        {
            "waveform": st.just("triangle"),
            "amplitude_mA": st.just(100.0),
            "slope_mA_per_s": numbers(50, 5000),
            "offset_mA": st.just(100.0),
        }
    ),
)


@settings(max_examples=25)
@given(
    rod=RODS,
    coil=COILS,
    transition=st.sampled_from(["linear", "cubic", "quintic"]),
    repeats=st.integers(1, 3),
    duration=numbers(0.5, 6),
)
def test_what_is_accepted_keeps_every_limit_and_is_continuous(rod, coil, transition, repeats, duration):
    settings_ = {"transition": transition, "repeats": repeats, "duration_s": duration}
    refused = refusal(rod, coil, **settings_)
    event(f"{'refused' if refused else 'accepted'} {rod['waveform']}")
    assert "\n" not in (refused or "")
    assume(not refused)
    p = planned(rod, coil, **settings_)
    step = 1e-3
    time = np.arange(-0.05, p.duration + 0.1, step)
    at = p.at(time)
    room = 1 + 1e-5
    assert np.abs(at.position).max() <= LIMITS.reach * room
    assert np.abs(at.velocity).max() <= LIMITS.speed * room
    assert np.abs(at.acceleration).max() <= LIMITS.acceleration * room
    assert at.current.min() >= LIMITS.current_min - 1e-5
    assert at.current.max() <= LIMITS.current_max * room
    assert ENVELOPE.force(np.abs(at.velocity), at.current).max() <= LIMITS.force * room
    # Each is the integral of the next, so nothing jumps; the rounding is that of the finite step.
    np.testing.assert_allclose(np.diff(at.position), at.velocity[:-1] * step, atol=LIMITS.acceleration * step**2)
    np.testing.assert_allclose(np.diff(at.velocity), at.acceleration[:-1] * step, atol=LIMITS.jerk * step**2)
    assert np.abs(np.diff(at.acceleration)).max() <= LIMITS.jerk * step * (1 + 1e-3)
    # At rest at mid-stroke, without current, before and after; without current outside the body.
    outside = (time < 0) | (time > p.duration)
    assert not np.array(at)[:, outside].any()
    start, end = p.body
    assert not at.current[(time < start) | (time >= end)].any()
    np.testing.assert_allclose(p.at(0.0)[:3], 0, atol=1e-6)
    # What the peaks say is what the motion does.
    peaks = {peak.quantity: peak.value for peak in p.peaks}
    assert np.abs(at.position).max() * 1e3 <= peaks["position"] + 1e-9
    assert np.abs(at.velocity).max() * 1e3 <= peaks["speed"] + 1e-6
    assert peaks["speed"] <= np.abs(at.velocity).max() * 1e3 + LIMITS.acceleration * step * 1e3
    assert all(peak.value <= peak.limit * room for peak in p.peaks if peak.quantity != "least current")


def test_the_body_is_the_waveform():
    p = planned({"waveform": "sine", "amplitude_mm": 8.0, "frequency_hz": 1.0}, repeats=2, duration_s=2.25)
    time = np.linspace(0, 2.2, 500)
    w = 2 * np.pi
    for start in (p.body[0], p.body[0] + p.period):
        at = p.at(start + time)
        np.testing.assert_allclose(at.position, 0.008 * np.sin(w * time), atol=1e-9)
        np.testing.assert_allclose(at.velocity, 0.008 * w * np.cos(w * time), atol=1e-7)
        np.testing.assert_allclose(at.acceleration, -0.008 * w**2 * np.sin(w * time), atol=1e-4)


def test_the_lead_in_to_a_gentle_waveform_is_gentle():
    p = planned({"waveform": "staircase", "levels_mm": [20.0], "hold_s": 1.0})
    peaks = {peak.quantity: peak for peak in p.peaks}
    assert peaks["speed"].value == pytest.approx(100, rel=1e-5)
    assert peaks["acceleration"].value <= 2.5 * (1 + 1e-5)


def test_the_lead_in_to_a_fast_waveform_is_faster():
    p = planned({"waveform": "sine", "amplitude_mm": 20.0, "frequency_hz": 1.4})
    assert np.abs(p.at(np.linspace(0, p.body[0], 1000)).velocity).max() > 0.1  # beyond the gentle pace


def test_whole_periods_repeat_without_a_transition():
    p = planned({"waveform": "sine", "amplitude_mm": 8.0, "frequency_hz": 1.0}, repeats=3, duration_s=2.0)
    assert p.period == 2.0
    assert p.body[1] - p.body[0] == 6.0


def test_coil_steps_are_instantaneous_and_come_on_time():
    p = planned(coil={"waveform": "staircase", "levels_mA": [100.0, 300.0, 0.0], "hold_s": 1.0})
    at = p.at(p.body[0] + np.array([-1e-6, 1e-6, 1 - 1e-6, 1 + 1e-6, 2 + 1e-6, 3 + 1e-6, 4 + 1e-6]))
    np.testing.assert_allclose(at.current, [0, 0.1, 0.1, 0.3, 0, 0.1, 0], atol=1e-12)


def test_coil_ramps_are_straight():
    p = planned(coil={"waveform": "ramp", "start_mA": 0.0, "end_mA": 500.0, "slope_mA_per_s": 250.0, "dwell_s": 1.0})
    at = p.at(p.body[0] + np.array([0.5, 1.5, 2.5, 3.5]))
    np.testing.assert_allclose(at.current, [0, 0.125, 0.375, 0.5])


@pytest.mark.parametrize("kind", ["linear", "cubic", "quintic"])
def test_triangle_is_straight_between_rounded_corners(kind):
    p = planned({"waveform": "triangle", "amplitude_mm": 20.0, "slope_mm_per_s": 100.0}, transition=kind)
    at = p.at(p.body[0] + np.linspace(0.25, 0.55, 100))
    np.testing.assert_allclose(at.velocity, -0.1, atol=1e-9)
    assert p.at(p.body[0] + 0.4).position == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("kind", ["linear", "cubic", "quintic"])
def test_rod_step_arrives_and_rests(kind):
    p = planned({"waveform": "step", "start_mm": -10.0, "end_mm": 10.0, "delay_s": 1.0}, transition=kind)
    at = p.at(p.body[0] + np.array([0.5, 1.0, 1.1, 1.5, 3.0]))
    np.testing.assert_allclose(at.position[[0, 1, 3, 4]], [-0.01, -0.01, 0.01, 0.01], atol=1e-9)
    assert at.velocity[2] > 0.05
    assert at.velocity[4] == pytest.approx(0, abs=1e-9)


def test_rod_steps_slow_down_where_the_force_would_be_too_much():
    fast = planned({"waveform": "step", "start_mm": -10.0, "end_mm": 10.0, "delay_s": 1.0})
    slow = planned(
        {"waveform": "step", "start_mm": -10.0, "end_mm": 10.0, "delay_s": 1.0}, {"waveform": "constant", "level_mA": 450.0}
    )
    peaks = {peak.quantity: peak for peak in slow.peaks}
    assert peaks["expected force"].value == pytest.approx(800, rel=1e-3)
    time = fast.body[0] + 1.1
    assert slow.at(time).position < fast.at(time).position


@pytest.mark.parametrize(
    ("rod", "coil", "message"),
    [
        (
            {"waveform": "sine", "amplitude_mm": 32.0, "frequency_hz": 0.5},
            None,
            r"rod: position ±32 mm exceeds ±26 mm; reduce amplitude_mm from 32 to 26$",
        ),
        (
            {"waveform": "sine", "amplitude_mm": 20.0, "frequency_hz": 0.2, "offset_mm": -10.0},
            None,
            r"rod: position ±30 mm exceeds ±26 mm; reduce amplitude_mm from 20 to 17\.33 and offset_mm from -10 to -8\.666",
        ),
        (
            {"waveform": "sine", "amplitude_mm": 25.0, "frequency_hz": 2.0},
            None,
            r"rod: speed 314\.2 mm/s exceeds 200 mm/s; reduce amplitude_mm from 25 to 15\.91, or lower frequency_hz",
        ),
        (
            {"waveform": "sine", "amplitude_mm": 1.0, "frequency_hz": 20.0},
            None,
            r"rod: acceleration 15\.79 m/s² exceeds 10 m/s²; reduce amplitude_mm",
        ),
        (
            {"waveform": "sine", "amplitude_mm": 0.1, "frequency_hz": 40.0},
            None,
            r"rod: jerk 1588 m/s³ exceeds 1000 m/s³; reduce amplitude_mm",
        ),
        (
            {"waveform": "triangle", "amplitude_mm": 10.0, "slope_mm_per_s": 250.0},
            None,
            r"rod: speed 250 mm/s exceeds 200 mm/s; reduce slope_mm_per_s from 250 to 200",
        ),
        (
            None,
            {"waveform": "prbs", "low_mA": 0.0, "high_mA": 1200.0, "bit_s": 0.1},
            r"coil: current 1200 mA exceeds 1000 mA; reduce high_mA from 1200 to 1000",
        ),
        (
            {"waveform": "sine", "amplitude_mm": 10.0, "frequency_hz": 2.0},
            {"waveform": "constant", "level_mA": 500.0},
            r"expected force .*500 mA\) 1069 N exceeds 800 N; reduce level_mA from 500 to 331, or reduce amplitude_mm",
        ),
        (
            {"waveform": "staircase", "levels_mm": [0.0, 40.0], "hold_s": 1.0},
            None,
            r"rod: position ±40 mm exceeds ±26 mm; reduce levels_mm by the factor 0\.65",
        ),
    ],
)
def test_refusals_name_value_limit_and_a_remedy_that_works(rod, coil, message):
    line = refusal(rod, coil)
    assert re.search(message, line)
    # Doing what the message says reveals the next limit at most, never the same again.
    refused_quantities = []
    while line:
        refused_quantities.append(" ".join(line.split()[:2]))
        assert len(set(refused_quantities)) == len(refused_quantities), line
        target = coil if line.startswith("coil") or "_mA from" in line else rod
        for key, value in re.findall(r"(\w+) from \S+ to (-?[\d.]+)", line.split(", or ")[0]):
            target[key] = float(value)
        for factor in re.findall(r"levels_mm by the factor ([\d.]+)", line):
            target["levels_mm"] = [level * float(factor) for level in target["levels_mm"]]
        line = refusal(rod, coil)


@pytest.mark.parametrize(
    ("rod", "message"),
    [
        (
            {"waveform": "staircase", "levels_mm": [0.0, 20.0], "hold_s": 0.1},
            r"rod: the move of 20 mm at 0\.1 s takes .*; raise hold_s",
        ),
        (
            {"waveform": "triangle", "amplitude_mm": 0.1, "slope_mm_per_s": 150.0},
            r"rod: turning at the corners .*; reduce the slope",
        ),
        (
            {"waveform": "ramp", "start_mm": 0.0, "end_mm": 20.0, "slope_mm_per_s": 1.0},
            r"rod: the ramp ends at 20 s, after duration_s 4",
        ),
    ],
)
def test_motions_that_take_too_long_are_refused(rod, message):
    with pytest.raises(InputError, match=message):
        planned(rod)


def test_too_many_periods_are_refused_before_they_fill_the_memory():
    with pytest.raises(InputError, match="coil: 50 Hz for 1000 s are too many periods to plan; reduce duration_s and"):
        planned(coil={"waveform": "sine", "amplitude_mA": 10.0, "frequency_hz": 50.0, "offset_mA": 10.0}, duration_s=1000.0)


def test_a_negative_current_is_refused():
    with pytest.raises(InputError, match="coil: current -50 mA is below 0 mA; change amplitude_mA or offset_mA"):
        planned(coil={"waveform": "sine", "amplitude_mA": 50.0, "frequency_hz": 1.0})


def test_a_force_limit_that_no_motion_keeps_is_named():
    with pytest.raises(InputError, match=r"expected force .*162 N exceeds 100 N; raise limits\.force_N"):
        planned(limits=Limits(force=100.0))


# --- traces


def write_trace(path, columns, rows):
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]), encoding="utf-8")


@pytest.fixture
def trace(tmp_path):
    time = np.arange(0, 5, 0.01)
    rows = np.column_stack([time + 7, 0.01 * np.sin(2 * np.pi * time), 0.2 + 0.1 * np.sign(np.sin(3 * time))])
    write_trace(tmp_path / "trace.csv", ["time_s", "position_m", "current_A"], rows)
    return tmp_path


def test_a_trace_moves_rod_and_coil_as_recorded(trace):
    p = planned({"waveform": "trace", "file": "trace.csv"}, {"waveform": "trace", "file": "trace.csv"}, folder=trace)
    time = np.linspace(0, 3.99, 1000)
    at = p.at(p.body[0] + time)
    np.testing.assert_allclose(at.position, 0.01 * np.sin(2 * np.pi * time), atol=1e-6)
    assert at.current.min() >= 0.1 - 1e-9  # straight between samples: a spline would swing below
    assert at.current.max() <= 0.3 + 1e-9


def test_a_noisy_trace_needs_its_low_pass(trace):
    time = np.arange(0, 5, 0.001)
    position = 0.01 * np.sin(2 * np.pi * time) + np.random.default_rng(0).normal(0, 1e-5, len(time))
    write_trace(trace / "noisy.csv", ["time_s", "position_m"], np.column_stack([time, position]))
    with pytest.raises(InputError, match=r"rod: acceleration .* reduce scale from 1 to"):
        planned({"waveform": "trace", "file": "noisy.csv"}, folder=trace)
    p = planned({"waveform": "trace", "file": "noisy.csv", "cutoff_hz": 10.0}, folder=trace)
    time = np.linspace(0.5, 3.5, 100)
    np.testing.assert_allclose(p.at(p.body[0] + time).position, 0.01 * np.sin(2 * np.pi * time), atol=2e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; expected the header time_s,position_m and samples"),
        ("time_s,x\n0,0\n", r"column position_m is missing \(found: time_s, x\)"),
        ("time_s,position_m\n0,0\n1,0\n2,0\n", "holds 3 samples, expected at least 4"),
        ("time_s,position_m\n0,0\n1,0\n1,0\n2,0\n9,0\n", "line 4: time_s is 1 after 1, expected increasing time"),
        ("time_s,position_m\n0,0\n1,nan\n2,0\n3,0\n9,0\n", "line 3: position_m is nan, expected a finite number"),
        ("time_s,position_m\n0,0\n1,a\n2,0\n3,0\n9,0\n", "line 3: position_m is 'a', expected a number"),
        ("time_s,position_m\n0,0\n1\n2,0\n3,0\n9,0\n", "line 3: has 1 cells, expected 2"),
        ("time_s,position_m\n0,0\n1,0\n2,0\n3,0\n", r"lasts 3 s, less than duration_s 4; reduce duration_s"),
    ],
)
def test_wrong_traces_are_refused_in_one_line(tmp_path, text, message):
    (tmp_path / "wrong.csv").write_text(text)
    with pytest.raises(InputError, match=rf"^rod: .*wrong\.csv: {message}") as caught:
        planned({"waveform": "trace", "file": "wrong.csv"}, folder=tmp_path)
    assert "\n" not in str(caught.value)


def test_a_missing_trace_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"rod: .*none\.csv: cannot be read \(No such file"):
        planned({"waveform": "trace", "file": "none.csv"}, folder=tmp_path)


def test_an_experiment_beyond_the_limits_is_scaled_down_until_it_fits():
    """Of the sizes of 40 mm, the third fits within the reach of 26 mm; of those of 1 m, none does."""
    coil = Constant(0.1)
    fitting = Experiment("t", 4.0, 100.0, Sine(0.010, 0.5), coil)
    assert plan_scaled(fitting, LIMITS, ENVELOPE).experiment == fitting
    large = plan_scaled(Experiment("t", 4.0, 100.0, Sine(0.040, 0.2), coil), LIMITS, ENVELOPE)
    assert large.experiment.rod.amplitude == 0.8**2 * 0.040
    assert large.experiment.coil == coil
    assert plan_scaled(Experiment("t", 4.0, 100.0, Sine(1.0, 0.2), coil), LIMITS, ENVELOPE) is None
    levels = Staircase((0.0, 0.05, 0.1), 1.0)
    steps = plan_scaled(Experiment("t", 4.0, 100.0, Triangle(0.010, 1.3 * LIMITS.speed), levels), LIMITS, ENVELOPE)
    factor = steps.experiment.rod.amplitude / 0.010
    assert factor < 1.0
    assert steps.experiment.rod.slope == factor * 1.3 * LIMITS.speed
    assert steps.experiment.coil == levels
    assert steps.experiment.description == ""


def test_a_current_beyond_its_limit_leaves_the_motion_as_it_is():
    rod, coil = Sine(0.010, 0.5), Staircase((0.0, 1.5 * LIMITS.current_max), 1.0)
    planned = plan_scaled(
        Experiment("t", 4.0, 100.0, rod, coil, description="a sine of 10 mm"),
        LIMITS,
        replace(ENVELOPE, yield_slope=1.0, viscosity_slope=0.0),
    )
    assert planned.experiment.rod == rod
    assert planned.experiment.description == "a sine of 10 mm (current reduced to 64 % to keep the limits)"
    assert planned.experiment.coil.levels == (0.0, 0.8**2 * 1.5 * LIMITS.current_max)


def test_a_force_beyond_its_limit_takes_as_few_reductions_as_possible():
    """Less motion hardly lowers the force of a slow stroke, so the current is reduced alone."""
    rod, coil = Sine(0.020, 0.1), Constant(0.9 * LIMITS.current_max)
    planned = plan_scaled(Experiment("t", 10.0, 100.0, rod, coil), LIMITS, ENVELOPE)
    assert planned.experiment.rod == rod
    assert planned.experiment.coil.level < coil.level


# --- shipped configuration


@pytest.mark.parametrize("path", sorted((CONFIG / "experiments").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_experiments_keep_the_shipped_limits(path):
    shipped = read_settings(CONFIG / "bench.yaml")
    assert plan(read_experiment(path), shipped.limits, shipped.force_envelope).duration > 10


def test_defaults_are_the_shipped_configuration():
    assert read_settings(CONFIG / "bench.yaml") == GeneratorSettings()


def test_a_margin_that_leaves_nothing_of_the_stroke_is_refused():
    with pytest.raises(
        InputError, match=r"bench.yaml: limits: margin_mm: found 1.5, expected less than 1, half of stroke_mm"
    ):
        from_mapping(Limits, {"stroke_mm": 2.0}, "bench.yaml: limits")
    assert from_mapping(Limits, {"stroke_mm": 2.0, "margin_mm": 0.1}, "limits").reach == pytest.approx(0.9e-3)
