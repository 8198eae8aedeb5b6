"""Work on several processes."""

import threading

from mrd_trials.pool import every

LOCK = threading.Lock()


def free(waited: float) -> bool:
    return LOCK.acquire(timeout=waited)


def test_a_lock_that_is_held_here_holds_up_no_worker():
    with LOCK:
        assert list(every(free, [(1.0,)], 2)) == [True]
