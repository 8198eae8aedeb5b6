"""Identification and diagnosis as a node: the same as the tools', from recorded runs or from the samples that it hears."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future

from mrd_base import InputError, quantity
from mrd_base.config import bench_time_scale
from mrd_base.nodes.bench_node import RECORDED, BenchNode, run_node
from mrd_identification.fit_file import make_folder, read_fit, write_fit
from mrd_identification.gap.diagnose import diagnose
from mrd_identification.gap.report import write_gap_report
from mrd_identification.identify import Fit, Method, identify
from mrd_identification.report import sentence, write_report
from mrd_interfaces.action import Diagnose, Identify
from mrd_interfaces.msg import BenchSamples
from mrd_runs import Run, read_runs
from mrd_runs.live import HeardSamples


@dataclass(frozen=True)
class IdentifierSettings:
    """Parameters of the identifier node."""

    time_scale: float = bench_time_scale()
    most_blocks: int = quantity(100_000, "", "blocks of samples kept for a fit; older ones are forgotten", lower=1)


class CancelledError(Exception):
    """The client does not want the answer any more."""


class Identifier(BenchNode[IdentifierSettings]):
    """Listens to ``samples`` and serves ``identify`` and ``diagnose``, one at a time, beside the executor's thread."""

    def __init__(self) -> None:
        super().__init__("identifier", IdentifierSettings)
        self._heard = HeardSamples(self.config.most_blocks)
        self._busy = False
        self._stopping = threading.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="fit")
        self.create_subscription(BenchSamples, "samples", self._heard.append, RECORDED, raw=True)
        self._servers = [self._serve("identify", Identify, self._identify), self._serve("diagnose", Diagnose, self._explain)]

    def _serve(self, name: str, action: Any, work: Callable[[Any, Callable[[Any], None], Any], None]) -> ActionServer:
        """An action whose ``work(request, publish, result)`` fills the result in the worker's thread.

        ``publish`` takes feedback, and raises `CancelledError` when nobody waits for the result any more.
        """

        async def execute(goal: Any) -> Any:
            def publish(feedback: Any) -> None:
                if goal.is_cancel_requested or self._stopping.is_set():
                    raise CancelledError
                goal.publish_feedback(feedback)

            result = action.Result()
            try:
                await self._in_worker(lambda: work(goal.request, publish, result))
            except InputError as error:
                result = action.Result(message=str(error))
                goal.abort()
            except CancelledError:
                result = action.Result(message="cancelled")
                goal.canceled()
            else:
                result.success = True
                goal.succeed()
            finally:
                self._busy = False
            self.get_logger().info(result.message)
            return result

        return ActionServer(
            self, action, name, execute, goal_callback=self._accept, cancel_callback=lambda _goal: CancelResponse.ACCEPT
        )

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

    def _identify(self, request: Identify.Goal, publish: Callable[[Any], None], result: Identify.Result) -> None:
        method = _method(request)
        generations = method.generations * (method.seeds if method.polish else 1)

        def progress(generation: int, nrmse: float) -> None:
            publish(Identify.Feedback(generation=generation, generations=generations, nrmse=nrmse))

        folder = make_folder(request.output)
        runs, held_out = self._runs(request)
        fit = identify(runs, request.model, held_out=held_out, method=method, progress=progress)
        write_fit(fit, folder)
        write_report(fit, folder)
        _fill(result, fit, folder)

    def _explain(self, request: Diagnose.Goal, publish: Callable[[Any], None], result: Diagnose.Result) -> None:
        def progress(stage: str, fraction: float) -> None:
            publish(Diagnose.Feedback(stage=stage, fraction=fraction))

        folder = make_folder(request.output)
        parameters = read_fit(request.parameters) if request.parameters else None
        runs, held_out = self._runs(request)
        found = diagnose(
            runs,
            request.model,
            held_out=held_out,
            parameters=parameters,
            effects=tuple(request.effects),
            seed=request.seed,
            progress=progress,
        )
        result.report = str(write_gap_report(found, folder).resolve())
        result.message = found.sentence
        result.verdict = found.verdict
        result.causes = [cause.effect for cause in found.causes]
        result.probability = [cause.probability for cause in found.causes]
        result.closed_fraction = found.closed.value

    def _runs(self, request: Identify.Goal | Diagnose.Goal) -> tuple[list[Run], list[Run]]:
        """Runs to fit and runs to judge by: recorded ones, or what was heard."""
        if not request.runs:
            return [self._heard.run("live samples")], read_runs(request.held_out)
        every = read_runs([*request.runs, *request.held_out])
        return every[: len(request.runs)], every[len(request.runs) :]

    def diagnose(self) -> tuple[str, dict[str, Any]]:
        """Health of the node itself."""
        return "", {"blocks heard": len(self._heard), "fitting": self._busy}

    def close(self) -> None:
        self._stopping.set()
        self._worker.shutdown(wait=True, cancel_futures=True)


def _method(request: Identify.Goal) -> Method:
    default = Method()
    return Method(
        population=request.population or default.population,
        generations=request.generations or default.generations,
        seed=request.seed,
        polish=request.polish,
    )


def _fill(result: Identify.Result, fit: Fit, folder: Path) -> None:
    judge = fit.pooled_held_out or fit.pooled_fitted
    result.message = sentence(fit)
    result.fit = str((folder / "fit.json").resolve())
    result.report = str((folder / "fit.html").resolve())
    result.parameter = [estimate.parameter.name for estimate in fit.estimates]
    result.unit = [estimate.parameter.unit for estimate in fit.estimates]
    result.value = [estimate.value for estimate in fit.estimates]
    result.lower = [estimate.lower for estimate in fit.estimates]
    result.upper = [estimate.upper for estimate in fit.estimates]
    result.nrmse, result.e2, result.einf = judge.nrmse, judge.e2, judge.einf


def main() -> None:
    """Entry point of ``ros2 run mrd_identification identifier``."""
    run_node(Identifier, SingleThreadedExecutor)
