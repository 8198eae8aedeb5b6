"""Independent pieces of work on the workers of a dask cluster."""

import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from mrd_base import InputError
from mrd_base.progress import ignore

R = TypeVar("R")

CONNECT_TIMEOUT = 10.0
"""s, within which a scheduler has to answer."""


def run_on_cluster(
    scheduler: str, function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], done: Callable[[int], None] = ignore
) -> list[R]:
    """Call ``function(*arguments)`` for every tuple on the cluster, and return the results in the order of the tuples.

    Parameters
    ----------
    scheduler : str
        Address of a dask.distributed scheduler, such as ``tcp://host:8786``. Its workers need the software installed, but
        none of the recorded files. The work of a worker that dies is done again by the others.
    function : callable
        A function that a worker can import by its name.
    arguments : sequence of tuple
        A tuple of runs that several of them share is sent once.
    done : callable
        Called after each finished piece of work with the number of finished ones.

    Raises
    ------
    InputError
        When nothing answers at the address, or a piece of work repeatedly kills its worker.
    """
    if not re.fullmatch(r"(\w+://)?[^\s/]+:\d+", scheduler):
        raise InputError(f"--scheduler {scheduler}: expected the address of a dask scheduler, such as tcp://host:8786")
    try:
        from distributed import Client, as_completed
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise InputError("--scheduler: the library of the cluster is not installed; run: pip install distributed") from None

    try:
        client: Any = Client(scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no dask scheduler answers ({error}); start one first") from None
    with client:
        runs = {id(item): item for items in arguments for item in items if isinstance(item, tuple)}
        # Every worker gets the runs: runs that only one worker holds would be lost with it.
        sent = dict(zip(runs, client.scatter(list(runs.values()), broadcast=True, hash=False), strict=True)) if runs else {}
        futures = [client.submit(function, *(sent.get(id(item), item) for item in items), pure=False) for items in arguments]
        try:
            for count, _ in enumerate(as_completed(futures, loop=client.loop), 1):
                done(count)
            return list(client.gather(futures))
        except KilledWorker as error:
            raise InputError(f"--scheduler {scheduler}: {error}; a worker may have run out of memory") from None
        finally:
            client.cancel(futures)
