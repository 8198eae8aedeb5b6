"""Independent pieces of work on the workers of a dask cluster."""

import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from mrd_base import InputError

R = TypeVar("R")

CONNECT_TIMEOUT = 10.0
"""s to reach a scheduler."""


def run_on_cluster(
    scheduler: str,
    function: Callable[..., R],
    arguments: Sequence[tuple[Any, ...]],
    done: Callable[[int], None] = lambda _count: None,
) -> list[R]:
    """``function(*arguments)`` of every tuple, in their order.

    Parameters
    ----------
    scheduler : str
        Address of a dask.distributed scheduler, such as ``tcp://host:8786``. Its workers need the bench installed, not its
        files. A worker that dies costs what it was at: others do that again.
    function : callable
        Importable by name, so that a worker finds it.
    arguments : sequence of tuple
        A tuple of runs that stands in several of them is sent once.
    done : callable
        Called with the number of finished pieces after each.

    Raises
    ------
    InputError
        When nothing answers at the address, or a piece of work goes on killing workers.
    """
    if not re.fullmatch(r"(\w+://)?[^\s/]+:\d+", scheduler):
        raise InputError(f"--scheduler {scheduler}: expected the address of a dask scheduler, such as tcp://host:8786")
    from distributed import Client, as_completed
    from distributed.scheduler import KilledWorker

    try:
        client: Any = Client(scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no dask scheduler answers ({error}); start one first") from None
    with client:
        runs = {id(item): item for each in arguments for item in each if isinstance(item, tuple)}
        # Every worker gets them: what only one holds would die with it.
        sent = dict(zip(runs, client.scatter(list(runs.values()), broadcast=True, hash=False), strict=True)) if runs else {}
        futures = [client.submit(function, *(sent.get(id(item), item) for item in each), pure=False) for each in arguments]
        try:
            for count, _ in enumerate(as_completed(futures, loop=client.loop), 1):
                done(count)
            return list(client.gather(futures))
        except KilledWorker as error:
            raise InputError(f"--scheduler {scheduler}: {error}; look at the memory of its workers") from None
        finally:
            client.cancel(futures)
