"""Processes that are started for another one end with it, also when it is killed."""

import subprocess
import sys
import time
from pathlib import Path

import psutil

PARENT = """
import subprocess, sys, time
from mrd_base.workers import ending_with_parent, worker_pool

if __name__ == "__main__":
    pool = worker_pool(1)
    pool.submit(time.sleep, 60)
    child = subprocess.Popen(ending_with_parent([sys.executable, "-c", "import time; time.sleep(60)"]))
    print(*pool._processes, child.pid, flush=True)
    time.sleep(60)
"""


def test_workers_and_processes_end_with_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        children = [psutil.Process(int(number)) for number in parent.stdout.readline().split()]
        time.sleep(1.0)
        assert all(child.is_running() for child in children)
        parent.kill()
    _, alive = psutil.wait_procs(children, timeout=10)
    assert len(children) == 2
    assert not alive
