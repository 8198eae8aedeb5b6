"""Characterisation of simulated dampers whose values are known, from 5 N to 100 kN."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_characterisation import QUANTITIES, Characterisation, Value, characterise
from mrd_characterisation.cycles import dynamic_ranges
from mrd_characterisation.figures import energy_over_speed, force_over_speed
from mrd_characterisation.force_speed import DIRECTIONS


def drawn(damper, seed):
    """A damper of any size; its noise is 0.3 % of its force."""
    random = np.random.default_rng(seed)
    force, stroke = np.exp(random.uniform(np.log([5.0, 5e-3]), np.log([1e5, 0.3])))
    return replace(
        damper,
        force=force,
        stroke=stroke,
        speed=math.pi * stroke / random.uniform(0.3, 1.2),
        current=math.exp(random.uniform(math.log(0.2), math.log(10.0))),
        gas_force=force * random.uniform(0.02, 0.15),
        gas_stiffness=force * random.uniform(0.02, 0.1) / stroke,
        drag=force * random.uniform(0.005, 0.05),
        lag=random.uniform(0.004, 0.025),
        falling=random.uniform(-0.3, 0.6),
        model=("bingham", "linear_viscous")[seed % 2],
    )


def assert_holds(value: Value, truth: float, tolerance: float) -> None:
    """Check that a value is near the truth, or that its interval holds it."""
    assert abs(value.value - truth) <= tolerance or value.lower <= truth <= value.upper, (value, truth)


def only(found: Characterisation, quantity: str) -> Value:
    (value,) = found.select(quantity)
    return value


@pytest.mark.parametrize("seed", range(20))
def test_a_damper_of_any_size_has_the_values_that_it_was_made_with(simulated_damper, seed):
    damper = drawn(simulated_damper, seed)
    found = characterise(damper.set())
    assert_holds(only(found, "gas_force"), damper.gas_force, 0.02 * damper.gas_force)
    assert_holds(only(found, "gas_stiffness"), damper.gas_stiffness, 0.05 * damper.gas_stiffness)
    assert_holds(only(found, "seal_drag"), damper.drag, 0.02 * damper.drag)
    assert only(found, "seal_drag").speed == 0.0
    assert only(found, "stroke_used").value == pytest.approx(damper.stroke, rel=0.02)
    forces = [value for value in found.select("force_at_speed") if value.speed > 0.05 * damper.speed]
    assert len(forces) > 10
    for value in forces:
        resistance, expected = damper.force_at_speed(value.direction, value.speed, value.current)
        assert_holds(value, expected, 0.02 * abs(resistance))
    energies = [value for value in found.select("energy_per_cycle") if value.speed > 0.2 * damper.speed]
    assert len(energies) == 9
    for value in energies:
        expected = damper.energy_of_sine(value.speed, value.current)
        assert value.value == pytest.approx(expected, rel=0.01)
        (equivalent,) = found.select("equivalent_damping", current=value.current, speed=value.speed)
        amplitude = 0.5 * damper.stroke
        assert equivalent.value == pytest.approx(expected / (math.pi * amplitude * value.speed), rel=0.01)
    for share, factor in (("63", 1.0), ("95", math.log(20.0))):
        times = found.select(f"response_time_{share}")
        assert bool(times) == (damper.model == "bingham")
        for value in times:
            lag = damper.lag if value.current > value.current_before else damper.lag * (1.0 + damper.falling)
            assert_holds(value, factor * lag, 1e-3)
        assert all(value.value < 1e-3 for value in found.select(f"current_time_{share}"))


@pytest.fixture(scope="module")
def found(simulated_damper):
    return characterise(simulated_damper.set(), name="SN-1")


def test_forces_energies_and_ratios_of_one_damper(simulated_damper, found):
    damper = simulated_damper
    peak = found.select("peak_force", current=damper.current, direction="compression", speed=damper.speed)[0]
    # At the peak speed in mid-stroke, where the gas pushes against the rod.
    assert peak.value == pytest.approx(-damper.resistance(damper.speed, damper.current) - damper.gas_force, rel=0.01)
    mean = found.select("mean_force", current=0.0, direction="rebound", speed=damper.speed)[0]
    work = 0.25 * math.pi * damper.viscous * damper.speed + damper.drag - damper.gas_force
    assert mean.value == pytest.approx(work, rel=0.02)
    fast = 0.5 * damper.speed
    ratio = only_at(found, "dynamic_range", fast).value
    assert ratio == pytest.approx(damper.resistance(fast, damper.current) / damper.resistance(fast, 0.0), rel=0.01)
    asymmetry = found.select("asymmetry", current=damper.current, speed=fast)[0].value
    assert asymmetry == pytest.approx(-damper.gas_force / damper.resistance(fast, damper.current), rel=0.02)
    assert found.currents == (0.0, 0.4, 1.0)


def only_at(found, quantity, speed):
    (value,) = found.select(quantity, speed=speed)
    return value


def test_every_value_says_what_it_is_and_of_how_much_it_is_the_mean(found):
    for value in found.values:
        assert value.quantity in QUANTITIES
        assert len(value.definition) > 30
        assert value.definition.endswith(".")
        assert value.runs >= 1
        if value.cycles > 1:
            assert value.lower <= value.value <= value.upper
            assert value.scatter >= 0.0


def test_a_speed_without_the_smallest_current_has_no_dynamic_range(found):
    forces = found.select("force_at_speed")
    speed = found.select("dynamic_range")[0].speed
    without = [value for value in forces if value.speed != speed or value.current]
    ranges = {value.speed for value in found.select("dynamic_range")}
    assert {value.speed for value in dynamic_ranges(forces)} == ranges
    assert {value.speed for value in dynamic_ranges(without)} == ranges - {speed}


def test_sines_alone_show_no_gas_no_response_and_no_dynamic_range(simulated_damper):
    found = characterise(simulated_damper.sine("a", 0.2, 0.0))
    assert {"force_at_speed", "energy_per_cycle"} <= {value.quantity for value in found.values}
    assert not found.select("gas_force")
    text = "\n".join(found.limitations)
    assert "Only one steady current, 0 A" in text
    assert "No slow strokes" in text
    assert "the slowest has 200 mm/s" in text
    assert "No current steps at constant speed" in text


def test_one_slow_speed_gives_the_drag_at_it(simulated_damper):
    runs = [simulated_damper.sine("fast", 0.2, 0.0), simulated_damper.triangle("slow", 0.008, 0.0)]
    drag = only(characterise(runs), "seal_drag")
    assert drag.speed == pytest.approx(0.008, rel=0.01)
    assert "8 mm/s" in drag.definition
    assert drag.value == pytest.approx(simulated_damper.resistance(0.008, 0.0), rel=0.02)


def test_random_motion_and_random_current_give_no_cycles(simulated_damper):
    random = np.random.default_rng(3)
    time = np.arange(20_000) / 1000.0
    phases = random.uniform(0.0, 2.0 * np.pi, 9)
    position = sum(
        1.5e-3 * np.sin(2 * np.pi * f * time + phase) for f, phase in zip(np.sqrt(np.arange(1, 10)), phases, strict=True)
    )
    with pytest.raises(InputError, match="random: holds no repeated cycle"):
        characterise(simulated_damper.record("random", position, np.zeros(len(time))))
    current = np.repeat(random.uniform(0.0, 1.0, 400), 50)
    with pytest.raises(InputError, match="no current step at constant speed"):
        characterise(simulated_damper.record("random_current", position, current))


def test_a_current_that_never_settles_is_told(simulated_damper):
    run = simulated_damper.sine("drifting", 0.2, 0.4)
    current = 0.5 + 0.3 * np.sin(2.0 * np.pi * 0.4 * run.time)
    with pytest.raises(InputError, match=r"drifting: the current is steady in none of the \d+ strokes, expected .* 0.8 A"):
        characterise(replace(run, current=current))


def test_a_speed_that_was_not_recorded_is_refused(simulated_damper):
    run = simulated_damper.sine("a", 0.2, 0.0)
    assert {value.speed for value in characterise(run, speeds=[0.07, 0.12]).select("force_at_speed")} == {0.07, 0.12}
    with pytest.raises(InputError, match=r"force at 300 mm/s was not recorded, expected .* 50 to 190 mm/s"):
        characterise(run, speeds=[0.3])
    with pytest.raises(InputError, match="expected a positive speed"):
        characterise(run, speeds=[-0.1])


def test_a_mirrored_recording_exchanges_the_directions(simulated_damper):
    run = simulated_damper.sine("a", 0.2, 0.4)
    mirrored = replace(run, position=-run.position, velocity=-run.velocity, force=-run.force)
    one, two = characterise(run), characterise(mirrored)
    for first, second in (("rebound", "compression"), ("compression", "rebound")):
        forces = [value.value for value in one.select("force_at_speed", direction=first)]
        assert [-value.value for value in two.select("force_at_speed", direction=second)] == pytest.approx(forces, rel=1e-6)


def test_slow_coils_are_told_from_the_fluid(simulated_damper):
    """The current itself rises in 10 ms, and the force follows it."""
    run = simulated_damper.steps()
    lag, slow = 0.01, np.zeros(len(run))
    commanded = np.resize(np.repeat([0.0, 1.0], 250), len(run))
    for k in range(1, len(run)):
        slow[k] = slow[k - 1] + (commanded[k] - slow[k - 1]) * (1.0 - math.exp(-1e-3 / lag))
    damper = replace(simulated_damper, lag=0.005, falling=0.0)
    found = characterise([damper.record("steps", run.position, slow), damper.sine("fast", 0.2, 0.0)])
    for value in found.select("current_time_63"):
        assert value.value == pytest.approx(lag, abs=1e-3)
    for value in found.select("response_time_63"):
        assert 0.0135 < value.value < 0.0185


def test_currents_within_the_noise_of_the_sensor_are_one(simulated_damper):
    runs = [simulated_damper.sine(f"r{k}", 0.2, 0.4 + offset, seed=k) for k, offset in enumerate((0.0, 0.001, -0.002))]
    found = characterise(runs)
    assert found.currents == pytest.approx([0.4], abs=1e-3)
    assert found.select("energy_per_cycle")[0].runs == 3


def test_equal_cycles_are_one_group_whatever_the_speeds_of_other_strokes(simulated_damper):
    """A shorter stroke is a little slower, and the limit of its group lies within the speeds of the longer one."""
    longer = replace(simulated_damper, stroke=1.1 * simulated_damper.stroke)
    runs = [longer.sine(f"r{k}", speed, 0.4, seed=k) for k, speed in enumerate((0.103, 0.105, 0.107))]
    values = characterise([simulated_damper.sine("short", 0.1, 0.4), *runs]).select("energy_per_cycle")
    assert [(value.runs, value.stroke) for value in values] == [
        (1, pytest.approx(0.020, rel=0.02)),
        (3, pytest.approx(0.022, rel=0.02)),
    ]


def test_a_round_speed_is_one_that_both_directions_show(simulated_damper):
    """At the slow end of what the strokes show, the direction that is a little faster does not show it any more."""
    time = np.arange(5000) / 1000.0
    phase = 2.0 * np.pi * time
    position = 0.2 / (2.0 * np.pi) * (np.sin(phase) + 0.0025 * np.sin(2.0 * phase))
    found = characterise(simulated_damper.record("sine", position, np.zeros(len(time))))
    speeds = {direction: [v.speed for v in found.select("force_at_speed", direction=direction)] for direction in DIRECTIONS}
    assert speeds == {direction: [0.1] for direction in DIRECTIONS}


def test_loops_are_closed_and_energies_of_other_strokes_are_not_joined(simulated_damper):
    short = replace(simulated_damper, stroke=0.5 * simulated_damper.stroke)
    sines = [damper.sine(f"{k}", speed, 0.4) for k, damper in enumerate((simulated_damper, short)) for speed in (0.1, 0.2)]
    found = characterise(sines)
    assert len(found.loops) == 4
    for loop in found.loops:
        assert (loop.position[-1], loop.force[-1]) == (loop.position[0], loop.force[0])
    energies, dampings = (
        [trace.x for trace in energy_over_speed([found]).data if trace.yaxis == axis] for axis in ("y", "y2")
    )
    assert energies == [pytest.approx([100.0, 200.0], rel=0.02)] * 2
    assert [len(speeds) for speeds in dampings] == [4]


def test_a_curve_of_few_samples_has_no_gaps(simulated_damper):
    run = simulated_damper.sine("a", 0.2, 0.4)
    slow = {name: getattr(run, name)[::10] for name in ("time", "position", "current", "force", "velocity")}
    curves = force_over_speed([characterise(replace(run, acceleration=None, **slow))]).data
    assert len(curves) == 6
    assert all(None not in curve.y and len(curve.y) > 5 for curve in curves)


def test_summary_and_notebook_name_values_and_limitations(found):
    text = found.summary()
    assert text.startswith("SN-1: ")
    assert "gas force" in text
    assert "note: " in text
    assert "<table>" in found._repr_html_()
    assert len(found.plot().data) > 5
    with pytest.raises(InputError, match="quantity 'gas' is not known, expected one of peak_force"):
        found.select("gas")


def test_short_slow_strokes_show_the_seal_drag_that_they_were_recorded_for(simulated_damper):
    short = replace(simulated_damper, stroke=0.2 * simulated_damper.stroke)
    fast = [simulated_damper.sine("sine", 0.2, level, seed=k) for k, level in enumerate((0.0, 1.0))]
    gas = [simulated_damper.triangle(f"gas_{speed:g}", speed, 0.0) for speed in (0.008, 0.004)]
    drag = [short.triangle(f"drag_{speed:g}", speed, 0.0) for speed in (0.002, 0.001)]
    found = characterise([*fast, *gas, *drag])
    value = only(found, "seal_drag")
    assert "strokes of 1 and 2 and 4 mm/s" in value.definition
    assert only(found, "gas_force").speed == pytest.approx(0.004, rel=0.01)
    assert set(found.gas_curve.runs) == {"gas_0.004", "drag_0.002", "drag_0.001"}
    alone = characterise([*fast, *drag])
    assert only(alone, "seal_drag").value == pytest.approx(simulated_damper.drag, rel=0.02)
    assert not alone.select("gas_force")
    assert any("so no gas force: the slowest" in text for text in alone.limitations)


def slow_pairs(damper, cycles):
    return [damper.sine("fast", 0.2, 0.0), *(damper.triangle(f"s{k}", s, 0.0, cycles) for k, s in enumerate((0.004, 0.008)))]


def test_the_interval_of_the_seal_drag_counts_both_coefficients_of_the_line(simulated_damper):
    """A triangle of 1.5 cycles has two whole strokes, one of 2.5 has four."""
    one_pair = only(characterise(slow_pairs(simulated_damper, 1.5)), "seal_drag")
    assert one_pair.cycles == 2
    assert math.isnan(one_pair.lower)
    assert math.isnan(one_pair.scatter)
    half = [only(characterise(slow_pairs(simulated_damper, cycles)), "seal_drag") for cycles in (2.5, 4.5)]
    assert [value.cycles for value in half] == [4, 8]
    assert half[0].upper - half[0].lower > 1.2 * (half[1].upper - half[1].lower) > 0.0


def test_the_interval_of_the_seal_drag_holds_what_changes_between_runs(simulated_damper):
    runs = [
        replace(simulated_damper, drag=simulated_damper.drag * (1.0 + change)).triangle(f"{speed}_{k}", speed, 0.0, seed=k)
        for speed in (0.004, 0.008)
        for k, change in enumerate((-0.2, 0.0, 0.2))
    ]
    drag = only(characterise([simulated_damper.sine("fast", 0.2, 0.0), *runs]), "seal_drag")
    # Residuals of -4, 0 and 4 N at each of two speeds.
    scatter = math.sqrt(4 * 4.0**2 / 4)
    half = 2.776 * scatter * math.sqrt(1 / 6 + 0.006**2 / (6 * 0.002**2))
    assert drag.scatter == pytest.approx(scatter, rel=0.03)
    assert 0.5 * (drag.upper - drag.lower) == pytest.approx(half, rel=0.03)


def test_no_stroke_counts_in_two_cycles_of_the_gas_force(simulated_damper):
    """Three whole strokes are one cycle and a half."""
    gas = only(characterise(slow_pairs(simulated_damper, 2.0)), "gas_force")
    assert gas.cycles == 1
    assert 0.0 < gas.upper - gas.lower < 0.02 * simulated_damper.force


def test_the_smallest_current_is_the_one_of_the_least_size(simulated_damper):
    """A coil that is driven in both senses has the same yield force in both."""
    speeds, levels = (0.1, 0.2), (-1.0, 0.0, 1.0)
    runs = [
        simulated_damper.sine(f"{s}_{i}", s, abs(i), seed=k)
        for k, (s, i) in enumerate((s, i) for s in speeds for i in levels)
    ]
    runs += [simulated_damper.triangle(f"slow_{s}", s, 0.0) for s in (0.004, 0.008)]
    runs = [replace(run, current=-run.current) if run.name.endswith("-1.0") else run for run in runs]
    found = characterise(runs)
    assert found.currents == (-1.0, 0.0, 1.0)
    assert only(found, "gas_force").current == 0.0
    ratio = found.select("dynamic_range", speed=0.1)[0]
    assert ratio.current == 1.0
    assert ratio.value == pytest.approx(
        simulated_damper.resistance(0.1, 1.0) / simulated_damper.resistance(0.1, 0.0), rel=0.02
    )


def test_strokes_that_are_too_short_for_a_force_at_a_speed_are_told(simulated_damper):
    short = replace(simulated_damper, stroke=0.08 * simulated_damper.stroke)
    found = characterise([simulated_damper.sine("long", 0.2, 0.4), short.sine("short", 0.03, 0.4)])
    assert not found.select("force_at_speed", speed=0.02)
    assert "Strokes of 30 mm/s at 0.4 A show no force at a speed" in "\n".join(found.limitations)
    assert "shorter than 10 % of the longest one" in found.select("force_at_speed")[0].definition


def test_the_interval_of_a_response_time_holds_what_changes_between_runs(simulated_damper):
    lags = (0.010, 0.012, 0.014)
    runs = [replace(simulated_damper, lag=lag, falling=0.0).steps() for lag in lags]
    fast = simulated_damper.sine("fast", 0.2, 0.0)
    found = characterise([fast, *(replace(run, name=f"steps_{k}") for k, run in enumerate(runs))])
    times = found.select("response_time_63")
    assert times
    for time in times:
        assert time.runs == 3
        # Student's t with two degrees of freedom, for a scatter of 2 ms over three runs.
        assert 0.5 * (time.upper - time.lower) == pytest.approx(4.303 * 0.002 / math.sqrt(3.0), rel=0.2)
