"""Steps of a current are found where they begin, and none in a current that varies smoothly."""

import numpy as np
import pytest

from mrd_runs.signals.current_steps import current_steps, time_since_step


@pytest.mark.parametrize("rate", [100.0, 250.0, 5000.0])
def test_steps_of_the_current_are_found_where_they_begin(rate):
    at = np.arange(int(4 * rate)) / rate
    stepped = np.where(at < 1.0, 0.1, np.where(at < 2.5, 0.8, 0.4))
    np.testing.assert_allclose(at[current_steps(stepped, rate, 0.8)], [1.0, 2.5], atol=1.5 / rate)
    since = time_since_step(at, stepped, 0.8)
    assert np.all(np.isinf(since[at < 0.9]))
    np.testing.assert_allclose(since[at > 2.6], at[at > 2.6] - 2.5, atol=1.5 / rate)
    assert len(current_steps(0.1 * np.arange(4) / rate, rate, 1.0)) == 0


@pytest.mark.parametrize("frequency", [0.1, 1.0, 5.0, 20.0])
@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_a_smooth_current_has_no_steps(frequency, rate):
    at = np.arange(int(10 * rate)) / rate
    assert len(current_steps(0.5 + 0.5 * np.sin(2 * np.pi * frequency * at), rate, 1.0)) == 0
