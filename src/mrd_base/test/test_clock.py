import subprocess
import sys
import time

import pytest

from mrd_base import BenchClock


def test_real_bench_time_is_unix_time():
    assert BenchClock().now() == pytest.approx(time.time(), abs=0.01)


def test_bench_time_passes_as_fast_as_it_is_scaled(monkeypatch):
    uptime, sleeps = [100.0], []
    monkeypatch.setattr(time, "clock_gettime", lambda _clock: uptime[0])
    monkeypatch.setattr(time, "sleep", sleeps.append)
    clock = BenchClock(20.0)
    start = clock.now()
    uptime[0] += 0.5
    assert clock.now() - start == pytest.approx(10.0)
    clock.sleep_until(start + 12.0)
    clock.sleep_until(start)
    assert sleeps == pytest.approx([0.1])


def test_sleeping_ends_when_the_bench_time_has_come():
    clock = BenchClock(20.0)
    end = clock.now() + 1.0
    clock.sleep_until(end)
    assert clock.now() >= end


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_processes_agree_on_the_time(scale):
    program = f"from mrd_base import BenchClock; print(BenchClock({scale}).now())"
    clock = BenchClock(scale)
    before = clock.now()
    other = float(subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout)
    assert before - 0.01 < other < clock.now() + 0.01


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_time_scale_must_be_positive(scale):
    with pytest.raises(ValueError, match="expected > 0"):
        BenchClock(scale)
