"""Processes that compute for another one, and never outlive it."""

import multiprocessing
import os
import shutil
import signal
import threading
import time
from collections.abc import Sequence
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
    if parent is not None and parent.pid is not None:
        end_with(parent.pid)


def end_with(parent: int) -> None:
    """End this process at once, whatever it is doing, when its parent, given by its id, has ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def ending_with_parent(command: Sequence[str]) -> list[str]:
    """Return a command whose process receives SIGTERM when the process that runs it ends, also by SIGKILL.

    Where there is no ``setpriv`` (util-linux), it is the command as it was.
    """
    return [*(["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []), *command]


def end_workers(pool: ProcessPoolExecutor) -> None:
    """End the processes of a pool at once, with what they compute at present."""
    processes = list((pool._processes or {}).values())  # public from Python 3.14 on, as terminate_workers
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.kill()
