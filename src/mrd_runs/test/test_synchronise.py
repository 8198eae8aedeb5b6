"""Series of their own times, put onto one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_runs.importing.synchronise import synchronise


def series(rate: float, begin: float, end: float, slope: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(begin, end, 1.0 / rate)
    return time, np.sin(3.0 * time) + slope * time


@pytest.mark.parametrize("quantity", ["current", "temperature"])
@given(st.floats(0.0, 0.8), st.floats(0.0, 0.8), st.floats(200.0, 30000.0))
def test_beyond_its_ends_a_series_keeps_its_value(quantity: str, late: float, early: float, rate: float) -> None:
    """However fast it rises at the ends: nothing is extrapolated."""
    motion = {name: series(1000.0, 0.0, 2.0) for name in ("position", "force")}
    time, values = series(rate, late, 2.0 - early)
    values[0], values[-1] = -5.0, 5.0
    columns, notes = synchronise({**motion, quantity: (time, values)}, None, "file")
    assert np.abs(columns[quantity]).max() <= 5.0 + 1e-9
    before, after = columns["time"] < time[0] - 1e-3, columns["time"] > time[-1] + 1e-3
    np.testing.assert_allclose(columns[quantity][before], -5.0)
    np.testing.assert_allclose(columns[quantity][after], 5.0)
    told = " ".join(notes)
    for word, missing in ("begins", late), ("ends", early):
        if missing > 0.02:
            assert f"{quantity} {word}" in told
        elif missing == 0.0:
            assert word not in told


@pytest.mark.parametrize("channel", ["position", "velocity", "acceleration", "force"])
@pytest.mark.parametrize("rate", [None, 500.0])
@pytest.mark.parametrize("of_channel", [500.0, 2000.0])
def test_a_hole_of_one_channel_stays_a_gap(channel: str, rate: float | None, of_channel: float) -> None:
    given = {name: series(500.0, 0.0, 4.0) for name in ("position", "force")}
    time, values = series(of_channel, 0.0003, 4.0)
    kept = (time < 1.0) | (time > 1.4)
    columns, notes = synchronise({**given, channel: (time[kept], values[kept])}, rate, "file")
    assert np.diff(columns["time"]).max() == pytest.approx(0.4, abs=0.005)
    own = f"those of the {channel}" in notes[0]
    assert any(note.startswith("the longest gap" if own else f"{channel} has 1 hole of up to 0.4") for note in notes)
    begin = 0.002 if rate is None and not own else 0.0003
    for name in ("position", "force", channel):
        np.testing.assert_allclose(columns[name], np.sin(3.0 * (columns["time"] + begin)), atol=2e-3)


@pytest.mark.parametrize("channel", ["acceleration", "velocity"])
def test_a_slow_channel_that_is_not_needed_does_not_slow_down_the_others(channel: str) -> None:
    given = {name: series(1000.0, 0.0, 2.0) for name in ("position", "force")} | {channel: series(20.0, 0.0, 2.0)}
    columns, notes = synchronise(given, None, "file")
    assert len(columns["time"]) == 2000
    assert channel not in columns
    assert any(note.startswith(f"the {channel} is left out: at 20 Hz") for note in notes)
    columns, _ = synchronise(given, None, "file", asked=[channel])
    assert np.median(np.diff(columns["time"])) == pytest.approx(0.05)
    if channel == "velocity":
        columns, _ = synchronise({name: given[name] for name in ("velocity", "force")}, None, "file")
        assert np.median(np.diff(columns["time"])) == pytest.approx(0.05)


def test_a_fast_series_is_not_averaged_over_a_gap_of_the_slowest() -> None:
    time, values = series(100.0, 0.0, 4.0)
    kept = (time < 1.0) | (time > 1.4)
    fast = series(2000.0, 0.0, 4.0)
    columns, notes = synchronise({"position": (time[kept], values[kept]), "force": fast}, None, "file")
    np.testing.assert_allclose(columns["force"], columns["position"], atol=0.01)
    assert any("longest gap" in note for note in notes)


def test_times_of_receipt_in_bursts_are_no_holes() -> None:
    time, values = series(1000.0, 0.0, 2.0)
    bursts = np.ceil(time / 0.008) * 0.008 + 1e-5 * (np.arange(len(time)) % 8)
    columns, notes = synchronise({"position": (time, values), "force": (bursts, values)}, None, "file")
    assert len(columns["time"]) > 1900
    assert not any("hole" in note for note in notes)
