"""Limits: files are read strictly, golden dampers become bands."""

from dataclasses import replace
from pathlib import Path

import pytest

from mrd_base import InputError
from mrd_characterisation.characterisation import Value
from mrd_characterisation.limits import Limit, golden_limits, read_limits, resisting

SHIPPED = Path(__file__).resolve().parents[3] / "config/acceptance/rd_8040_1.yaml"


def value(number: float, half: float = 1.0, quantity: str = "peak_force", **conditions) -> Value:
    return Value(quantity, number, number - half, number + half, half, 5, 1, "as told", **conditions)


def test_the_shipped_limits_are_in_si():
    limits = read_limits(SHIPPED)
    assert Limit("seal_drag", 68.0, 92.0) in limits
    rebound = next(limit for limit in limits if limit.quantity == "force_at_speed" and limit.speed == pytest.approx(0.02))
    assert (rebound.lower, rebound.upper, rebound.current, rebound.direction) == (43.0, 63.0, 0.0, "rebound")
    step = next(limit for limit in limits if limit.quantity == "response_time_63")
    assert (step.current_before, step.current, step.upper) == (0.0, pytest.approx(0.393), pytest.approx(0.006))


def test_a_tolerance_in_per_cent_and_a_temperature_are_converted(tmp_path):
    file = tmp_path / "limits.yaml"
    file.write_text(
        "gas_force: [{nominal_N: -50, tolerance_percent: 10}]\n"
        "temperature_largest: [{nominal_degC: 30, tolerance_degC: 5}]\n"
    )
    gas, temperature = read_limits(file)
    assert (gas.lower, gas.upper) == (-55.0, -45.0)
    assert (temperature.lower, temperature.upper) == (pytest.approx(298.15), pytest.approx(308.15))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("gas_froce: [{lower_N: 1}]", "unknown key gas_froce; did you mean gas_force"),
        ("gas_force: [{lower: 1}]", "gas_force[0]: unknown key lower; did you mean lower_N"),
        ("gas_force: [{lower_N: 2, upper_N: 1}]", "gas_force[0]: lower 2 is not below upper 1"),
        ("gas_force: [{lower_N: 2, upper_N: 2}]", "lower 2 is not below upper 2"),
        ("gas_force: [{current_mA: 2}]", "expected lower, upper or both"),
        ("gas_force: [{nominal_N: 2}]", "or nominal with tolerance"),
        ("gas_force: [{nominal_N: 2, tolerance_N: 1, tolerance_percent: 1}]", "or nominal with tolerance"),
        ("gas_force: [{nominal_N: 2, lower_N: 1, tolerance_N: 1}]", "or nominal with tolerance"),
        ("gas_force: [{upper_N: .inf}]", "expected a finite number"),
        ("peak_force: [{upper_N: 1, direction: bump}]", "direction is bump, expected rebound or compression"),
        ("peak_force: [{upper_N: 1, speed_mm_per_s: -3}]", "speed_mm_per_s: found -3"),
        ("peak_force: {upper_N: 1}", "expected a list of bands"),
        ("peak_force: []", "expected a list of bands"),
        ("", "is empty"),
    ],
)
def test_a_bad_file_is_refused_in_one_line(tmp_path, text, told):
    file = tmp_path / "limits.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        read_limits(file)
    assert told in str(error.value)
    assert str(error.value).startswith(str(file))
    assert "\n" not in str(error.value)


def test_a_force_of_compression_counts_as_it_resists():
    seen = resisting(replace(value(-100.0, direction="compression"), lower=-103.0, upper=-99.0))
    assert (seen.value, seen.lower, seen.upper) == (100.0, 99.0, 103.0)
    assert resisting(value(-100.0, quantity="gas_force")).value == -100.0


def test_a_golden_band_is_the_tolerance_around_the_interval_and_at_least_the_scatter():
    (wide,) = golden_limits([value(-100.0, 2.0, direction="compression", speed=0.1)], 0.1)
    assert (wide.lower, wide.upper, wide.direction, wide.speed) == (88.0, 112.0, "compression", 0.1)
    (scattered,) = golden_limits([replace(value(100.0, 2.0), scatter=30.0)], 0.1)
    assert (scattered.lower, scattered.upper) == (68.0, 132.0)


def test_golden_numbers_that_others_cannot_be_compared_with_make_no_limit():
    single = replace(value(100.0), cycles=2, runs=2)
    asymmetry = value(0.1, quantity="asymmetry")
    for golden in ([], [single], [asymmetry]):
        with pytest.raises(InputError, match="no number to compare with"):
            golden_limits(golden, 0.1)
    with pytest.raises(InputError, match="--tolerance"):
        golden_limits([value(100.0)], 0.0)
