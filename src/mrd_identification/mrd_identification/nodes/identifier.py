"""Identification as a node: the same fit as the tool's, from recorded runs or from the samples that it hears."""

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
from mrd_identification.fit_file import make_folder, write_fit
from mrd_identification.identify import Fit, Method, identify
from mrd_identification.report import sentence, write_report
from mrd_interfaces.action import Identify
from mrd_interfaces.msg import BenchSamples
from mrd_runs import read_runs
from mrd_runs.live import HeardSamples


@dataclass(frozen=True)
class IdentifierSettings:
    """Parameters of the identifier node."""

    time_scale: float = bench_time_scale()
    most_blocks: int = quantity(100_000, "", "blocks of samples kept for a fit; older ones are forgotten", lower=1)


class CancelledError(Exception):
    """The client does not want the fit any more."""


class Identifier(BenchNode[IdentifierSettings]):
    """Listens to ``samples`` and serves ``identify``, one fit at a time, beside the executor's thread."""

    def __init__(self) -> None:
        super().__init__("identifier", IdentifierSettings)
        self._heard = HeardSamples(self.config.most_blocks)
        self._busy = False
        self._stopping = threading.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="fit")
        self.create_subscription(BenchSamples, "samples", self._heard.append, RECORDED, raw=True)
        self._server = ActionServer(
            self,
            Identify,
            "identify",
            self._execute,
            goal_callback=self._accept,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )

    def _accept(self, _goal: Identify.Goal) -> GoalResponse:
        if self._busy:
            return GoalResponse.REJECT
        self._busy = True
        return GoalResponse.ACCEPT

    async def _execute(self, goal: Any) -> Identify.Result:
        request: Identify.Goal = goal.request
        method = _method(request)
        generations = method.generations * (method.seeds if method.polish else 1)

        def progress(generation: int, nrmse: float) -> None:
            if goal.is_cancel_requested or self._stopping.is_set():
                raise CancelledError
            goal.publish_feedback(Identify.Feedback(generation=generation, generations=generations, nrmse=nrmse))

        result = Identify.Result()
        try:
            fit, folder = await self._in_worker(lambda: self._fit(request, method, progress))
        except InputError as error:
            result.message = str(error)
            goal.abort()
        except CancelledError:
            result.message = "cancelled"
            goal.canceled()
        else:
            _fill(result, fit, folder)
            goal.succeed()
        finally:
            self._busy = False
        self.get_logger().info(result.message)
        return result

    async def _in_worker(self, work: Callable[[], Any]) -> Any:
        done: Future = Future(executor=self.executor)

        def run() -> None:
            try:
                done.set_result(work())
            except Exception as error:
                done.set_exception(error)

        self._worker.submit(run)
        return await done

    def _fit(
        self, request: Identify.Goal, method: Method, progress: Callable[[int, float], None]
    ) -> tuple[Fit, Path]:
        folder = make_folder(request.output)
        if request.runs:
            every = read_runs([*request.runs, *request.held_out])
            runs, held_out = every[: len(request.runs)], every[len(request.runs) :]
        else:
            runs, held_out = [self._heard.run("live samples")], read_runs(request.held_out)
        fit = identify(runs, request.model, held_out=held_out, method=method, progress=progress)
        write_fit(fit, folder)
        write_report(fit, folder)
        return fit, folder

    def diagnose(self) -> tuple[str, dict[str, Any]]:
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
    result.success = True
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
