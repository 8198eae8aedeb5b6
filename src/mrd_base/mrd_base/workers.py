"""Processes that compute for another one, and never outlive it."""

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor


def worker_pool(workers: int, niceness: int = 0) -> ProcessPoolExecutor:
    """Return a pool of processes that end with this one, however it ends.

    They are fresh interpreters: a fork would share sockets, threads and the locks that these hold. Ctrl-C reaches every
    process of a terminal; the workers leave the answer to the process that they compute for.

    Parameters
    ----------
    workers : int
        Number of processes.
    niceness : int
        By how much they come after other processes.
    """
    # The first pool starts a process that cleans up, and unblocks SIGINT and SIGTERM here, which a node hears in a thread.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    try:
        return ProcessPoolExecutor(
            workers, multiprocessing.get_context("spawn"), initializer=begin_worker, initargs=(niceness,)
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def begin_worker(niceness: int = 0) -> None:
    """Prepare a process that computes for another one: it ends when that one has ended, whatever it is doing."""
    if niceness:
        os.nice(niceness)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, name="parent", daemon=True).start()


def end_workers(pool: ProcessPoolExecutor) -> None:
    """End the processes of a pool at once, with what they compute at present."""
    processes = list((pool._processes or {}).values())  # public from Python 3.14 on, as terminate_workers
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.kill()
