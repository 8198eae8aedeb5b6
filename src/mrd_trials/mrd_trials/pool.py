"""The same work for every plant, on several processes, each result as soon as it is there."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
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
    with ProcessPoolExecutor(workers) as pool:
        waiting = [pool.submit(function, *given) for given in arguments]
        try:
            for future in as_completed(waiting):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
