import os
import subprocess
import sys
import threading
import time

import pytest

from mrd_base import BenchClock


def test_bench_time_is_unix_time():
    assert BenchClock().now() == pytest.approx(time.time(), abs=0.01)


def test_sleeping_ends_when_the_bench_time_has_come():
    clock = BenchClock()
    end = clock.now() + 0.05
    clock.sleep_until(end)
    assert clock.now() >= end
    clock.sleep_until(end)
    clock.sleep(0.01)
    assert clock.now() >= end + 0.01


def test_a_wait_ends_in_time_or_when_it_is_woken_or_bytes_come():
    clock = BenchClock()
    waiter = clock.waiter()
    end = clock.now() + 0.02
    assert not waiter.wait(end)
    assert clock.now() >= end
    reader, writer = os.pipe()
    os.write(writer, b"1")
    assert not waiter.wait(clock.now() + 10.0, reader)
    threading.Timer(0.02, waiter.wake).start()
    assert waiter.wait(clock.now() + 10.0)
    assert clock.now() < end + 5.0
    waiter.wake()
    waiter.clear()
    assert not waiter.wait(clock.now())
    waiter.wake()
    assert waiter.wait(clock.now()), "woken before it waits"
    waiter.close()
    os.close(reader)
    os.close(writer)


def test_processes_agree_on_the_time():
    program = "from mrd_base import BenchClock; print(BenchClock().now())"
    clock = BenchClock()
    before = clock.now()
    other = float(subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout)
    assert before - 0.01 < other < clock.now() + 0.01
