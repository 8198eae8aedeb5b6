"""The same work for every plant, on several processes, each result as soon as it is there."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

R = TypeVar("R")


def every(function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], workers: int) -> Iterator[R]:
    """``function(*arguments)`` of every tuple, in the order in which they are done.

    With one worker, in this process and in their own order.
    """
    if workers <= 1:
        for given in arguments:
            yield function(*given)
        return
    # Not forked: a copy of a process with threads holds whatever locks these held, and waits for them forever.
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        waiting = [pool.submit(function, *given) for given in arguments]
        try:
            for future in as_completed(waiting):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
