"""The same work for every plant on several processes."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from typing import Any, TypeVar

from mrd_base.workers import end_workers, worker_pool

R = TypeVar("R")


def run_in_processes(function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], workers: int) -> Iterator[R]:
    """Yield ``function(*arguments)`` for every tuple of arguments, in the order in which the calls finish.

    With one worker, the calls run in this process, in the order of the arguments.
    """
    if workers <= 1:
        for values in arguments:
            yield function(*values)
        return
    pool = worker_pool(workers)
    try:
        futures = [pool.submit(function, *values) for values in arguments]
        for future in as_completed(futures):
            yield future.result()
    except BaseException:
        # Also where the caller stops: what is computed meanwhile, nobody would hear.
        end_workers(pool)
        raise
    pool.shutdown()
