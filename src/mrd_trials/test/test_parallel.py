"""Work on several processes."""

import threading

from mrd_trials.parallel import run_in_processes

LOCK = threading.Lock()


def is_free(timeout: float) -> bool:
    return LOCK.acquire(timeout=timeout)


def test_a_lock_that_is_held_here_does_not_block_a_worker():
    with LOCK:
        assert list(run_in_processes(is_free, [(1.0,)], 2)) == [True]
