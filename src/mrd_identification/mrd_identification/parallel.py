"""Independent computations on all cores of this machine."""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_THREAD_NAME = "analysis"


def in_threads(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Apply ``function`` to every item on all cores, and return the results in the order of the items.

    The compiled models release the interpreter, so threads use all cores and share the data without a copy. A nested call,
    from one of these threads, starts no further threads.
    """
    if threading.current_thread().name.startswith(_THREAD_NAME):
        return [function(item) for item in items]
    with ThreadPoolExecutor(os.cpu_count(), thread_name_prefix=_THREAD_NAME) as workers:
        return list(workers.map(function, items))
