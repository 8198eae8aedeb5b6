"""The means of blocks, on a motion whose velocity is known."""

import numpy as np
import pytest

from mrd_bench_driver.acquisition.block_means import BlockMeans

PERIOD, COUNT = 1e-3, 20


def block(start: float, count: int = COUNT) -> np.ndarray:
    """Samples of a rod that accelerates with 2 m/s^2 from rest at time 0."""
    time = start + PERIOD * np.arange(count)
    return np.stack([time**2, 100 + time, 0.1 * np.ones(count), 2.0 * np.ones(count)])


def test_means_are_those_of_the_middle_block_at_its_middle():
    means = BlockMeans()
    assert means.add(5.0, PERIOD, block(5.0)) is None
    assert means.add(5.02, PERIOD, block(5.02)) is None
    found = means.add(5.04, PERIOD, block(5.04))
    middle = 5.02 + 9.5e-3
    assert found.time == pytest.approx(middle)
    assert found.values["position"] == pytest.approx(block(5.02)[0].mean())
    assert found.values["velocity"] == pytest.approx(2 * middle)
    assert found.values["force"] == pytest.approx(100 + middle)
    assert found.values["coil_current"] == pytest.approx(0.1)
    assert found.values["acceleration"] == pytest.approx(2.0)
    assert means.add(5.06, PERIOD, block(5.06)).time == pytest.approx(middle + 0.02)


def test_blocks_of_one_sample_have_a_velocity_too():
    means = BlockMeans()
    found = [means.add(time, 0.04, block(time, 1)) for time in (1.0, 1.04, 1.08)][-1]
    assert (found.time, found.values["velocity"]) == (pytest.approx(1.04), pytest.approx(2.08))


@pytest.mark.parametrize("gap", [0.02, -0.02, 1.0])
def test_no_velocity_is_taken_across_a_gap(gap):
    means = BlockMeans()
    starts = [1.0, 1.02, 1.04, *(1.06 + gap + 0.02 * np.arange(3))]
    found = [means.add(start, PERIOD, block(start)) for start in starts]
    assert [entry is None for entry in found] == [True, True, False, True, True, False]
    assert found[-1].time == pytest.approx(starts[4] + 9.5e-3)
