"""Identification as a node: the action `identify` does what the tool ``identify`` does."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from mrd_base.nodes.bench_node import run_node
from mrd_identification.fit import Fit
from mrd_identification.fit_file import write_fit
from mrd_identification.identify import identify
from mrd_identification.json_file import make_folder
from mrd_identification.method import Method
from mrd_identification.report import sentence, write_report
from mrd_interfaces.action import Identify
from mrd_runs.nodes.analysis_node import AnalysisNode


class Identifier(AnalysisNode):
    """Serves the action ``identify``."""

    def __init__(self) -> None:
        super().__init__("identifier", Identify, "identify")

    def work(self, request: Identify.Goal, publish: Callable[[Any], None], result: Identify.Result) -> None:
        """Identify the model that the goal asks for, and write its files."""
        method = _method(request)

        def progress(generation: int, nrmse: float) -> None:
            publish(Identify.Feedback(generation=generation, generations=method.total_generations, nrmse=nrmse))

        folder = make_folder(request.output)
        runs, held_out = self.runs(request)
        fit = identify(runs, request.model, held_out=held_out, method=method, progress=progress)
        write_fit(fit, folder)
        write_report(fit, folder)
        _fill(result, fit, folder)


def _method(request: Identify.Goal) -> Method:
    default = Method()
    return Method(
        population=request.population or default.population,
        generations=request.generations or default.generations,
        seed=request.seed,
        least_squares=request.least_squares,
    )


def _fill(result: Identify.Result, fit: Fit, folder: Path) -> None:
    result.message = sentence(fit)
    result.fit = str((folder / "fit.json").resolve())
    result.report = str((folder / "fit.html").resolve())
    result.parameter = [estimate.parameter.name for estimate in fit.estimates]
    result.unit = [estimate.parameter.unit for estimate in fit.estimates]
    result.value = [estimate.value for estimate in fit.estimates]
    result.lower = [estimate.lower for estimate in fit.estimates]
    result.upper = [estimate.upper for estimate in fit.estimates]
    result.nrmse, result.e2, result.einf = fit.pooled.nrmse, fit.pooled.e2, fit.pooled.einf


def main() -> None:
    """Entry point of ``ros2 run mrd_identification identifier``."""
    run_node(Identifier, SingleThreadedExecutor)
