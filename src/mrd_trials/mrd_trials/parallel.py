"""The same work for every plant on several processes."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

R = TypeVar("R")


def run_in_processes(function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], workers: int) -> Iterator[R]:
    """Yield ``function(*arguments)`` for every tuple of arguments, in the order in which the calls finish.

    With one worker, the calls run in this process, in the order of the arguments.
    """
    if workers <= 1:
        for values in arguments:
            yield function(*values)
        return
    # Not forked: a copy of a process with threads holds the locks that these hold, and waits for them forever.
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        futures = [pool.submit(function, *values) for values in arguments]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
