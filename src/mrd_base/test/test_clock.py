import subprocess
import sys
import time

import pytest

from mrd_base import BenchClock


def test_real_bench_time_is_unix_time():
    assert BenchClock().now() == pytest.approx(time.time(), abs=0.01)


def test_bench_time_passes_as_fast_as_it_is_scaled():
    clock = BenchClock(20.0)
    began_bench, began = clock.now(), time.perf_counter()
    clock.sleep_until(began_bench + 2.0)
    assert clock.now() - began_bench >= 2.0
    assert time.perf_counter() - began == pytest.approx(clock.wall(2.0), abs=0.05)
    clock.sleep_until(began_bench)
    assert time.perf_counter() - began < 0.2


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_processes_agree_on_the_time(scale):
    program = f"from mrd_base import BenchClock; print(BenchClock({scale}).now())"
    clock = BenchClock(scale)
    before = clock.now()
    other = float(subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout)
    assert before - 0.01 < other < clock.now() + 0.01


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_time_must_pass(scale):
    with pytest.raises(ValueError, match="expected > 0"):
        BenchClock(scale)
