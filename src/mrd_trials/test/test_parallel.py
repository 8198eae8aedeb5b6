"""Work on several processes."""

import os
import signal
import subprocess
import sys
import threading
import time

import psutil
import pytest

from mrd_trials.parallel import run_in_processes

LOCK = threading.Lock()


def is_free(timeout: float) -> bool:
    return LOCK.acquire(timeout=timeout)


def test_a_lock_that_is_held_here_does_not_block_a_worker():
    with LOCK:
        assert list(run_in_processes(is_free, [(1.0,)], 2)) == [True]


def stay(seconds: float) -> None:
    print(os.getpid(), flush=True)
    time.sleep(seconds)


PROGRAM = """
import sys
sys.path.insert(0, {folder!r})
from test_parallel import stay
from mrd_trials.parallel import run_in_processes
if __name__ == "__main__":
    list(run_in_processes(stay, [(300.0,), (300.0,)], 2))
"""


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL], ids=lambda number: number.name
)
def test_workers_end_with_the_process_that_they_compute_for(tmp_path, number):
    script = tmp_path / "trial.py"
    script.write_text(PROGRAM.format(folder=os.path.dirname(__file__)))
    command = [sys.executable, script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as parent:
        assert parent.stdout is not None
        workers = [psutil.Process(int(parent.stdout.readline())) for _ in range(2)]
        parent.send_signal(number)
        parent.wait(timeout=60)
        _, alive = psutil.wait_procs(workers, timeout=60)
    assert alive == []
