"""Base of the nodes that analyse runs: one action at a time, on recorded runs or on the samples that the node hears."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

from mrd_base import InputError, quantity
from mrd_base.config import bench_time_scale
from mrd_base.nodes.bench_node import RECORDED, BenchNode
from mrd_interfaces.msg import BenchSamples
from mrd_runs import Run, read_runs
from mrd_runs.live import HeardSamples


@dataclass(frozen=True)
class AnalysisSettings:
    """Parameters of a node that analyses runs."""

    time_scale: float = bench_time_scale()
    most_blocks: int = quantity(100_000, "", "blocks of samples kept for an analysis; older ones are forgotten", lower=1)


class CancelledError(Exception):
    """Raised when the client does not want the answer any more."""


class AnalysisNode(BenchNode[AnalysisSettings]):
    """Listens to ``samples`` and serves one action, one goal at a time, in a thread beside the executor's.

    Parameters
    ----------
    name : str
        Default name of the node.
    action : type
        Type of the action. Its goal has ``runs`` and ``held_out``, its result ``success`` and ``message``.
    action_name : str
        Name under which the action is served.
    """

    def __init__(self, name: str, action: Any, action_name: str) -> None:
        super().__init__(name, AnalysisSettings)
        self._action = action
        self._heard = HeardSamples(self.config.most_blocks)
        self._busy = False
        self._stopping = threading.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=name)
        self.create_subscription(BenchSamples, "samples", self._heard.append, RECORDED, raw=True)
        self._server = ActionServer(
            self,
            action,
            action_name,
            self._execute,
            goal_callback=self._accept,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )

    def work(self, request: Any, publish: Callable[[Any], None], result: Any) -> None:
        """Fill ``result`` for ``request``; runs in the worker's thread.

        ``publish`` sends feedback. It raises `CancelledError` when nobody waits for the result any more.
        """
        raise NotImplementedError

    async def _execute(self, goal: Any) -> Any:
        def publish(feedback: Any) -> None:
            if goal.is_cancel_requested or self._stopping.is_set():
                raise CancelledError
            goal.publish_feedback(feedback)

        result = self._action.Result()
        try:
            await self._in_worker(lambda: self.work(goal.request, publish, result))
        except InputError as error:
            result = self._action.Result(message=str(error))
            goal.abort()
        except CancelledError:
            result = self._action.Result(message="cancelled")
            goal.canceled()
        else:
            result.success = True
            goal.succeed()
        finally:
            self._busy = False
        self.get_logger().info(result.message)
        return result

    def _accept(self, _goal: Any) -> GoalResponse:
        if self._busy:
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

    def runs(self, request: Any) -> tuple[list[Run], list[Run]]:
        """Read the runs to fit and the held-out runs of a goal; without runs, take the samples heard so far."""
        if not request.runs:
            return [self._heard.run("live samples")], read_runs(request.held_out)
        every = read_runs([*request.runs, *request.held_out])
        return every[: len(request.runs)], every[len(request.runs) :]

    def diagnose(self) -> tuple[str, dict[str, Any]]:
        """Report the health of the node itself."""
        return "", {"blocks heard": len(self._heard), "busy": self._busy}

    def close(self) -> None:
        """Cancel the analysis that is under way and wait for its end."""
        self._stopping.set()
        self._worker.shutdown(wait=True, cancel_futures=True)
