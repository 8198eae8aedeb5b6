"""Processes that compute for the page what would hold it up, and with it the stop button."""

import asyncio
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from typing import ParamSpec, TypeVar

from mrd_base import InputError
from mrd_base.workers import worker_pool

P = ParamSpec("P")
T = TypeVar("T")

_PROCESSES = 2  # one may look at a long recording while somebody waits for a preview
_NICENESS = 10  # the bench and the page come first


class Workers:
    """Computes in other processes, which are started again when one of them has died."""

    def __init__(self) -> None:
        self._pool = worker_pool(_PROCESSES, _NICENESS)

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
                self._pool = worker_pool(_PROCESSES, _NICENESS)
            raise InputError("the process that computed this has died; there may be too little memory; try again") from None

    def close(self) -> None:
        """End the processes, after what they compute at present."""
        self._pool.shutdown(wait=False, cancel_futures=True)
