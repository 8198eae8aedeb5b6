"""Waveforms have the described shapes, are all in the catalogue, and are read back from YAML."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError, from_mapping, to_mapping
from mrd_trajectory.waveforms import CHANNEL_UNITS, WAVEFORMS, Smooth, waveform_table, waveform_type
from mrd_trajectory.waveforms.aprbs import Aprbs
from mrd_trajectory.waveforms.chirp import Chirp
from mrd_trajectory.waveforms.ladder import Ladder
from mrd_trajectory.waveforms.multisine import Multisine
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.ramp import Ramp
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trajectory.waveforms.step import Step
from mrd_trajectory.waveforms.triangle import Triangle

EXAMPLES = {
    "constant": {"level_mm": 3.5},
    "sine": {"amplitude_mm": 5.0, "frequency_hz": 1.5, "offset_mm": -2.0},
    "triangle": {"amplitude_mm": 10.0, "slope_mm_per_s": 80.0},
    "ladder": {"slopes_mm_per_s": [80.0, 5.5], "amplitude_mm": 10.0, "hold_s": 1.5, "offset_mm": 1.0},
    "step": {"start_mm": -5.0, "end_mm": 5.0, "delay_s": 1.0},
    "staircase": {"levels_mm": [0.0, 5.5, -10.0], "hold_s": 0.7},
    "ramp": {"start_mm": -20.0, "end_mm": 20.0, "slope_mm_per_s": 12.5, "dwell_s": 0.3},
    "chirp": {"amplitude_mm": 2.0, "start_hz": 0.5, "end_hz": 5.0, "constant_speed": True},
    "multisine": {"amplitude_mm": 12.0, "lowest_hz": 0.2, "highest_hz": 4.0, "period_s": 5.0, "seed": 3},
    "prbs": {"low_mm": -2.0, "high_mm": 2.0, "bit_s": 0.5, "order": 6, "seed": 4},
    "aprbs": {"low_mm": -9.0, "high_mm": 9.0, "shortest_s": 0.4, "longest_s": 0.9, "count": 5, "seed": 5},
    "trace": {"file": "/somewhere/run.csv", "scale": 0.5},
}


def test_every_waveform_of_the_catalogue_has_an_example():
    assert set(EXAMPLES) == set(WAVEFORMS)


@pytest.mark.parametrize("name", WAVEFORMS)
def test_waveform_is_read_back_from_its_yaml(name):
    waveform = from_mapping(waveform_type(name), EXAMPLES[name], name, units=CHANNEL_UNITS["rod"])
    mapping = to_mapping(waveform, units=CHANNEL_UNITS["rod"])
    assert mapping.items() >= EXAMPLES[name].items()
    assert from_mapping(waveform_type(name), mapping, name, units=CHANNEL_UNITS["rod"]) == waveform


@pytest.mark.parametrize("name", [name for name in WAVEFORMS if name != "trace"])
def test_the_same_fields_give_the_same_shape_and_cover_the_duration(name):
    waveform = from_mapping(waveform_type(name), EXAMPLES[name], name, units=CHANNEL_UNITS["rod"])
    shape, again = waveform.shape(5.0), waveform.shape(5.0)
    if isinstance(shape, Smooth):
        times = np.linspace(0, 5, 1001)
        np.testing.assert_array_equal(shape.motion(times), again.motion(times))
    else:
        np.testing.assert_array_equal(shape.times, again.times)
        np.testing.assert_array_equal(shape.levels, again.levels)
        assert shape.times[0] == 0
        assert (np.diff(shape.times) >= 0).all()


def test_unknown_waveform_lists_the_known_ones():
    with pytest.raises(InputError, match=r"unknown waveform sinus \(known: constant, sine,.*trace\)"):
        waveform_type("sinus")


def test_table_names_the_keys_of_both_channels():
    rows = [row for row in waveform_table() if row.waveform == "triangle"]
    assert [(row.rod_key, row.coil_key) for row in rows] == [
        ("amplitude_mm", "amplitude_mA"),
        ("slope_mm_per_s", "slope_mA_per_s"),
        ("offset_mm", "offset_mA"),
    ]
    assert {row.waveform for row in waveform_table()} == set(WAVEFORMS)
    assert all(row.meaning for row in waveform_table())


@pytest.mark.parametrize(
    "waveform",
    [
        Sine(0.005, 1.5, 0.002),
        Chirp(0.01, 0.3, 4.0),
        Chirp(0.01, 4.0, 0.3, constant_speed=True),
        Chirp(0.01, 2.0, 2.0, constant_speed=True),
        Multisine(0.018, 0.2, 6.0, 5.0, seed=1),
    ],
    ids=["sine", "chirp up", "chirp down", "chirp level", "multisine"],
)
def test_smooth_waveforms_return_their_derivatives(waveform):
    motion = waveform.shape(5.0).motion
    times, h = np.linspace(0.1, 4.9, 400), 1e-4
    _, rate, curvature = motion(times)
    later, earlier = motion(times + h), motion(times - h)
    np.testing.assert_allclose((later[0] - earlier[0]) / (2 * h), rate, atol=1e-5 * np.abs(rate).max())
    np.testing.assert_allclose((later[1] - earlier[1]) / (2 * h), curvature, atol=1e-5 * np.abs(curvature).max())


def test_chirp_of_constant_speed_keeps_its_speed():
    _, rate, _ = Chirp(0.01, 0.5, 8.0, constant_speed=True).shape(20.0).motion(np.linspace(0, 20, 40_001))
    first, last = np.abs(rate[:8000]).max(), np.abs(rate[-8000:]).max()
    assert first == pytest.approx(2 * np.pi * 0.5 * 0.01, rel=0.02)
    assert last == pytest.approx(first, rel=0.02)


@given(order=st.integers(2, 11), seed=st.integers(0, 1000))
def test_prbs_is_a_maximal_length_sequence(order, seed):
    period = 2**order - 1
    bits = Prbs(0.0, 1.0, 0.1, order, seed).bits(2 * period).astype(int)
    once = bits[:period]
    np.testing.assert_array_equal(once, bits[period:])
    assert once.sum() == 2 ** (order - 1)  # balance: one 1 more than 0s
    signs = 2 * once - 1
    spectrum = np.fft.fft(signs)
    correlation = np.fft.ifft(spectrum * spectrum.conj()).real
    # Two-valued autocorrelation: it proves that no shorter period exists.
    np.testing.assert_allclose(correlation, [period, *[-1] * (period - 1)], atol=1e-6)


def test_prbs_seed_selects_the_start():
    starts = {tuple(Prbs(0, 1, 0.1, 8, seed).bits(20)) for seed in range(8)}
    assert len(starts) == 8


def test_prbs_holds_whole_bits():
    shape = Prbs(0.0, 0.15, 0.2, 9, 1).shape(60.0)
    np.testing.assert_allclose(shape.times / 0.2, np.round(shape.times / 0.2), atol=1e-9)
    assert set(shape.levels) == {0.0, 0.15}
    assert (np.diff(shape.levels) != 0).all()


@given(seed=st.integers(0, 10_000), count=st.integers(2, 30))
def test_aprbs_visits_all_levels_for_times_in_bounds(seed, count):
    shape = Aprbs(0.0, 0.4, 0.03, 0.2, count, seed).shape(20.0)
    holds = np.diff(shape.times)
    assert holds.min() >= 0.03 - 1e-12
    assert holds.max() <= 0.2 + 1e-12
    rounds = len(shape.levels) // count
    visits = np.unique(shape.levels[: rounds * count].round(9), return_counts=True)
    np.testing.assert_allclose(visits[0], np.linspace(0, 0.4, count), atol=1e-8)
    assert (visits[1] == rounds).all()


def test_multisine_has_odd_harmonics_only_and_a_low_crest():
    waveform = Multisine(0.018, 0.2, 6.0, 10.0, 1.0, seed=2)
    time = np.arange(2000) * 10.0 / 2000
    level, rate, _ = waveform.shape(10.0).motion(time)
    spectrum = np.abs(np.fft.rfft(level)) / 1000
    lines = np.flatnonzero(spectrum > 1e-9)
    np.testing.assert_array_equal(lines, np.arange(3, 61, 2))
    np.testing.assert_allclose(spectrum[lines] * lines, spectrum[3] * 3)
    assert np.abs(level).max() == pytest.approx(0.018, rel=1e-3)
    assert np.abs(level).max() / level.std() < 2.6
    assert np.abs(rate).max() / rate.std() < 2.6


def test_multisine_without_lines_is_refused():
    with pytest.raises(InputError, match="no odd multiple of 1/period_s = 1 Hz"):
        Multisine(0.01, 1.5, 2.5, 1.0)


def test_corners_and_holds_are_at_the_given_times():
    triangle = Triangle(0.01, 0.05, 0.002).shape(1.0)
    np.testing.assert_allclose(triangle.times[:4], [0, 0.2, 0.6, 0.8])
    np.testing.assert_allclose(triangle.levels[:4], [0.002, 0.012, -0.008, 0.002])
    assert triangle.times[-1] >= 1.0
    ramp = Ramp(-0.01, 0.01, 0.01, 0.5).shape(4.0)
    np.testing.assert_allclose(ramp.times, [0, 0.5, 2.5, 4.0])
    staircase = Staircase((0.0, 0.1, 0.2), 0.5).shape(2.0)
    np.testing.assert_allclose(staircase.times[:4], [0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(staircase.levels[:4], [0, 0.1, 0.2, 0])
    np.testing.assert_allclose(Step(0.0, 0.1, 0.7).shape(2.0).times, [0, 0.7])


@given(
    slopes=st.lists(st.floats(1e-4, 0.2), min_size=1, max_size=8), amplitude=st.floats(1e-3, 0.026), hold=st.floats(0.1, 5)
)
def test_ladder_is_whole_triangles_of_each_slope_within_the_amplitude(slopes, amplitude, hold):
    shape = Ladder(tuple(slopes), amplitude, hold, 0.002).shape(2 * hold * len(slopes))
    lengths, steps = np.diff(shape.times), np.diff(shape.levels)
    turn = np.minimum((shape.times[:-1] + lengths / 2) // hold, 2 * len(slopes) - 1).astype(int)
    within = shape.times[:-1] < 2 * hold * len(slopes) * (1 - 1e-12)
    expected = np.tile(slopes, 2)[turn[within]]
    np.testing.assert_allclose(np.abs(steps / lengths)[within], expected, rtol=1e-6)
    assert np.abs(shape.levels - 0.002).max() <= amplitude * (1 + 1e-9)
    rungs = np.searchsorted(shape.times, hold * np.arange(2 * len(slopes)) - 1e-9)
    np.testing.assert_allclose(shape.times[rungs], hold * np.arange(2 * len(slopes)), atol=1e-9)
    np.testing.assert_allclose(shape.levels[rungs], 0.002)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Ramp(0.0, 0.1, 0.01).shape(5.0),
        lambda: Multisine(0.01, 1.0, 100.0, 1000.0),
        lambda: Aprbs(0.0, 0.1, 0.2, 0.1),
        lambda: Prbs(0.0, 0.1, 1e-3).shape(3600.0),
        lambda: Triangle(1e-9, 0.1).shape(1.0),
        lambda: Ladder((0.1,), 1e-6, 100.0).shape(100.0),
    ],
)
def test_impossible_waveforms_are_refused_in_one_line(wrong):
    with pytest.raises(InputError) as caught:
        wrong()
    assert "\n" not in str(caught.value)
