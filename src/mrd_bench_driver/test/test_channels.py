"""Volts to SI units and back, tare, clipping."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError, from_mapping, read_node_parameters, to_mapping
from mrd_bench_driver.acquisition.channels import (
    MIN_TARE_SAMPLES,
    ChannelMap,
    CoilOutput,
    InputChannel,
    TemperatureChannel,
    coil_voltage,
    count_clipped,
    tare,
    to_si,
)
from mrd_trajectory.limits import Limits

BENCH = Path(__file__).parents[3] / "config" / "bench.yaml"
LIMITS = Limits(current_min=-0.5, current_max=1.0)


def at_rest(count: int = 200) -> np.ndarray:
    """Volts of a bench at rest whose sensors have offsets, with noise."""
    noise = np.random.default_rng(1).normal(0, 0.004, (4, count))
    return np.array([0.01, 0.2, 2.51, 1.7])[:, None] + noise


def test_volts_become_si_units_as_the_data_sheets_say() -> None:
    # 1.275 V - 0.020 V on the amplified 100 kg cell, 1.2 A through the ACS714-05B, 1 g on the MMA7361L, 5 mm/V.
    channels = ChannelMap(force=InputChannel("ai1", gain=196.133, zero=0.02))
    volts = np.array([[-2.0, 1.0], [1.275, 0.02], [2.722, 2.5], [2.45, 1.65]])
    expected = np.array([[-0.01, 0.005], [246.147, 0.0], [1.2, 0.0], [9.80665, 0.0]])
    np.testing.assert_allclose(to_si(volts, channels), expected, rtol=1e-5, atol=1e-12)


def test_a_tare_zeroes_only_the_channels_marked_for_it() -> None:
    volts = at_rest()
    channels = tare(volts, ChannelMap())
    means = to_si(volts, channels).mean(axis=1)
    assert means[2] == pytest.approx(0, abs=1e-9)
    assert means[3] == pytest.approx(0, abs=1e-9)
    assert channels.position == ChannelMap().position
    assert channels.force == ChannelMap().force


def test_a_tare_does_not_call_a_current_zero() -> None:
    """A supply that leaks 0.2 A reads steadily, too; nor do several tares move the zero by more than one."""
    volts = at_rest()
    volts[2] += 0.2 * 0.185 - 0.01
    with pytest.raises(
        InputError, match=r"coil_current reads 0\.20\d A by its zero_V, \+37\.\d mV \(limit ±20 mV\); make sure"
    ):
        tare(volts, ChannelMap())
    moved = ChannelMap(coil_current=InputChannel("ai2", range=5.0, gain=5.4, zero=2.53, tare=True))
    assert tare(volts, moved).coil_current.zero == pytest.approx(2.537, abs=1e-3)


@pytest.mark.parametrize(("row", "name"), [(0, "position"), (2, "coil_current"), (3, "acceleration")])
def test_a_tare_is_refused_while_something_moves(row: int, name: str) -> None:
    volts = at_rest()
    volts[row] += 0.1 * np.sin(np.arange(volts.shape[1]) / 10)
    with pytest.raises(InputError, match=f"{name} is not at rest"):
        tare(volts, ChannelMap())


def test_a_tare_is_refused_without_a_number_and_with_too_few() -> None:
    volts = at_rest()
    volts[2, 0] = np.nan
    with pytest.raises(InputError, match="coil_current is not at rest"):
        tare(volts, ChannelMap())
    with pytest.raises(InputError, match=f"{MIN_TARE_SAMPLES - 1} samples"):
        tare(at_rest(MIN_TARE_SAMPLES - 1), ChannelMap())


def test_readings_at_either_end_of_the_range_are_counted() -> None:
    volts = np.zeros((4, 5))
    volts[0, :2] = 9.995, -10.4
    volts[1, 0] = 9.98
    volts[2, 0] = -4.996
    assert count_clipped(volts, ChannelMap()).tolist() == [2, 0, 1, 0]


@given(current=st.floats(-10, 10), dead_zone=st.floats(0, 2), gain=st.sampled_from([0.2, -0.5, 3.0]))
def test_the_coil_gets_the_current_within_its_limits(current: float, dead_zone: float, gain: float) -> None:
    coil = CoilOutput(current_per_volt=gain, dead_zone=dead_zone)
    volts = coil_voltage(current, coil, LIMITS)
    assert abs(volts) <= 10
    flows = gain * (abs(volts) - dead_zone) * np.sign(volts) if abs(volts) > dead_zone else 0.0
    assert flows == pytest.approx(min(max(current, -0.5), 1.0), abs=1e-9)


@pytest.mark.parametrize("current", [0.0, float("nan"), float("inf"), -float("inf")])
def test_no_current_and_no_number_are_0_volts(current: float) -> None:
    assert coil_voltage(current, CoilOutput(dead_zone=0.5), LIMITS) == 0.0


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"input": "a0"}, "expected a terminal such as ai0"),
        ({"terminal": "DIF"}, "expected one of DIFF, RSE, NRSE"),
        ({"range_V": 2.0}, "expected one of 10, 5, 1, 0.2"),
        ({"gain": 0.0}, "gain is 0"),
        ({"zero": 0.0}, "unknown key zero; did you mean zero_V"),
        ({"input": "ai1"}, "input ai1 is given to two quantities"),
    ],
)
def test_an_impossible_channel_map_is_refused(change: dict[str, object], line: str) -> None:
    mapping = to_mapping(ChannelMap())
    mapping["position"].update(change)
    with pytest.raises(InputError, match=line):
        from_mapping(ChannelMap, mapping, "bench.yaml: daq: channels")


def test_a_thermometer_is_the_last_channel_and_reads_kelvins() -> None:
    assert [name for name, _ in ChannelMap().items()] == ["position", "force", "coil_current", "acceleration"]
    channels = ChannelMap(temperature=TemperatureChannel("ai5", gain=200.0, zero_celsius=1.25))
    volts = np.vstack([at_rest(3), [1.25, 1.375, 5.0]])
    assert to_si(volts, channels)[-1] == pytest.approx([273.15, 298.15, math.nan], nan_ok=True)
    assert tare(np.vstack([at_rest(), np.full(at_rest().shape[1], 1.4)]), channels).temperature == channels.temperature
    with pytest.raises(InputError, match="input ai4 is given to two quantities"):
        ChannelMap(temperature=TemperatureChannel("ai4"))


def test_the_shipped_channel_map_is_the_default_with_a_thermometer() -> None:
    parameters = read_node_parameters(BENCH, "daq")
    shipped = from_mapping(ChannelMap, parameters["channels"], "channels")
    assert shipped == ChannelMap(temperature=TemperatureChannel("ai5"))
    assert from_mapping(CoilOutput, parameters["coil"], "coil") == CoilOutput()
