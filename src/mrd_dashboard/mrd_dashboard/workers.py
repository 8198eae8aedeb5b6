"""Processes that compute for the page what would hold it up, and with it the stop button."""

import asyncio
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import ParamSpec, TypeVar

from mrd_base import InputError

P = ParamSpec("P")
T = TypeVar("T")

_PROCESSES = 2  # one may look at a long recording while somebody waits for a preview


def _begin() -> None:
    """Let the bench and the page come first, and end with the page even if it is killed."""
    os.nice(10)
    page = multiprocessing.parent_process()

    def end_with_page() -> None:
        if page is not None:
            page.join()
            os._exit(1)

    threading.Thread(target=end_with_page, name="page", daemon=True).start()


def _new_pool() -> Executor:
    # Fresh interpreters: a fork of the page would share its sockets and threads.
    context = multiprocessing.get_context("spawn")
    # The first pool starts a process that cleans up, and unblocks SIGINT and SIGTERM here, which a node hears in a thread.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    try:
        return ProcessPoolExecutor(_PROCESSES, context, initializer=_begin)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class Workers:
    """Computes in other processes, which are started again when one of them has died."""

    def __init__(self) -> None:
        self._pool = _new_pool()

    async def run(self, work: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Return the result of a function.

        Raises
        ------
        InputError
            When the process has died; and whatever the function raises.
        """
        pool = self._pool
        try:
            return await asyncio.wrap_future(pool.submit(work, *arguments, **options))
        except BrokenProcessPool:
            if self._pool is pool:
                self._pool = _new_pool()
            raise InputError("the process that computed this has died; there may be too little memory; try again") from None

    def close(self) -> None:
        """End the processes, after what they compute at present."""
        self._pool.shutdown(wait=False, cancel_futures=True)
