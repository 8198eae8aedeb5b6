"""Base of the nodes that analyse runs: one goal at a time, on recorded runs or on the samples that the node receives."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.action import CancelResponse, GoalResponse
from rclpy.task import Future

from mrd_base import InputError, quantity
from mrd_base.nodes.bench_node import BenchNode
from mrd_base.nodes.graph import SAMPLES, Action
from mrd_runs import Run, read_runs
from mrd_runs.read import read_groups
from mrd_runs.sample_buffer import SampleBuffer


@dataclass(frozen=True)
class AnalysisSettings:
    """Parameters of a node that analyses runs."""

    max_blocks: int = quantity(100_000, "", "number of sample blocks kept for an analysis; older ones are dropped", lower=1)
    trusted_folders: str = quantity(
        "", "", "folders of effects or models, separated by colons, that a goal may name: their Python files are executed"
    )


@dataclass(frozen=True)
class Offer:
    """What a node offers by an action.

    Attributes
    ----------
    action : Action
        Its goal has ``effects_folder`` and ``models_folder``, its result ``success`` and ``message``.
    check : callable
        Raises `InputError` for a goal that cannot be worked on, as far as that shows at once.
    work : callable
        Fills a result for a goal; called in the worker thread with the goal, a function that publishes feedback, and the
        result. The function raises `CancelledError` when the goal was cancelled or the node is closing.
    told : callable
        Returns fields of the result, beside its message, for an error that ``work`` has raised.
    """

    action: Action
    check: Callable[[Any], None]
    work: Callable[[Any, Callable[[Any], None], Any], None]
    told: Callable[[Exception], dict[str, Any]] = lambda _error: {}


class CancelledError(Exception):
    """Raised when the client has cancelled the goal or the node is closing."""


class AnalysisNode(BenchNode[AnalysisSettings]):
    """Subscribes to ``samples`` and serves actions, one goal at a time, in a worker thread.

    A goal that comes meanwhile, or that is refused, is rejected with the reason on ``refusals``. A second node of the name
    would take the same goals, and write into the same folders.

    Parameters
    ----------
    name : str
        Default name of the node.
    *offers : Offer

    Attributes
    ----------
    stopping : threading.Event
        Set when the node ends.
    """

    alone = True

    def __init__(self, name: str, *offers: Offer) -> None:
        super().__init__(name, AnalysisSettings)
        self._buffer = SampleBuffer(self.config.max_blocks)
        self._busy = False
        self.stopping = threading.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=name)
        SAMPLES.subscription(self, self._buffer.append, raw=True)
        self._servers = [
            offer.action.server(
                self,
                partial(self._execute, offer),
                goal_callback=partial(self._accept, offer),
                cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            )
            for offer in offers
        ]

    async def _execute(self, offer: Offer, goal: Any) -> Any:
        def publish(feedback: Any) -> None:
            if goal.is_cancel_requested or self.stopping.is_set():
                raise CancelledError
            goal.publish_feedback(feedback)

        result = offer.action.type.Result()
        try:
            await self._in_worker(lambda: offer.work(goal.request, publish, result))
        except (InputError, OSError) as error:
            result = offer.action.type.Result(message=_in_one_line(error), **offer.told(error))
            goal.abort()
        except CancelledError:
            result = offer.action.type.Result(message="cancelled")
            goal.canceled()
        else:
            result.success = True
            goal.succeed()
        finally:
            self._busy = False
        self.get_logger().info(result.message)
        return result

    def _require_trusted(self, request: Any) -> None:
        """Refuse effects and models, which are Python, of a folder that this node was not started with: anybody may send a
        goal.
        """
        trusted = [Path(entry).expanduser().resolve() for entry in self.config.trusted_folders.split(":") if entry]
        for field in ("effects_folder", "models_folder"):
            folder = getattr(request, field)
            if folder and Path(folder).resolve() not in trusted:
                raise InputError(
                    f"{field} is {folder}: its files are executed, so a goal may only name one of the parameter "
                    f"trusted_folders ({', '.join(map(str, trusted)) or 'none'}); start the node with it, or use the tool"
                )

    def _accept(self, offer: Offer, request: Any) -> GoalResponse:
        try:
            if self._busy:
                raise InputError("another goal is being worked on; wait for its end or cancel it")
            self._require_trusted(request)
            offer.check(request)
        except InputError as error:
            self.refuse(offer.action.name, str(error))
            return GoalResponse.REJECT
        self._busy = True
        return GoalResponse.ACCEPT

    async def _in_worker(self, work: Callable[[], None]) -> None:
        done: Future = Future(executor=self.executor)

        def run() -> None:
            try:
                work()
                done.set_result(None)
            except Exception as error:
                done.set_exception(error)

        self._worker.submit(run)
        await done

    def runs(self, request: Any, *others: str) -> list[list[Run]]:
        """Return the runs to fit, the held-out runs, and the runs of ``others`` of a goal.

        Without runs to fit, these are the samples received so far.
        """
        heard = [] if request.runs else [self._buffer.run("live samples").without_start(request.skip)]
        runs, held_out = read_groups([request.runs, request.held_out], request.skip)
        groups = [heard + runs, held_out]
        return groups + [read_runs(getattr(request, name), request.skip) for name in others]

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return no problem, and whether an analysis is running."""
        return "", {"blocks heard": len(self._buffer), "busy": self._busy}

    def close(self) -> None:
        """Cancel the running analysis and wait for its end."""
        self.stopping.set()
        self._worker.shutdown(wait=True, cancel_futures=True)


def _in_one_line(error: InputError | OSError) -> str:
    """Return what went wrong. An `OSError` is most often a disk that is full in the midst of a report."""
    return (
        f"{error.filename or 'files of the result'}: {error.strerror or error}" if isinstance(error, OSError) else str(error)
    )
