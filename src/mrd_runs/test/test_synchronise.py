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
