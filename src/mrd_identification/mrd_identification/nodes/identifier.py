"""Identification as a node: the action `identify` offers what the tool ``identify`` offers."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from mrd_base.json_file import make_folder
from mrd_base.nodes.bench_node import run_node
from mrd_base.nodes.graph import IDENTIFY
from mrd_identification.fit import Fit
from mrd_identification.fit_file import write_fit
from mrd_identification.identify import identify
from mrd_identification.low_pass import with_force_filters
from mrd_identification.method import Method, parse_method
from mrd_identification.report import write_report
from mrd_interfaces.action import Identify
from mrd_runs.nodes.analysis_node import AnalysisNode, Offer
from mrd_sim.models import find_model
from mrd_sim.own import own_catalogue


class Identifier(AnalysisNode):
    """Serves the action ``identify``."""

    def __init__(self) -> None:
        super().__init__("identifier", Offer(IDENTIFY, self.check, self.work))

    def check(self, request: Identify.Goal) -> None:
        """Refuse a method or a model that there is not."""
        read_method(request)
        with own_catalogue(request.models_folder):
            find_model(request.model)

    def work(self, request: Identify.Goal, publish: Callable[[Any], None], result: Identify.Result) -> None:
        """Identify the model of the goal and write its files."""
        method = read_method(request)

        def progress(generation: int, nrmse: float) -> None:
            publish(Identify.Feedback(generation=generation, generations=method.total_generations, nrmse=nrmse))

        folder = make_folder(request.output)
        with own_catalogue(request.models_folder, request.effects_folder):
            runs, held_out = with_force_filters(self.runs(request), request.force_filters, "force_filters")
            fit = identify(runs, request.model, held_out=held_out, method=method, progress=progress)
            write_fit(fit, folder)
            write_report(fit, folder)
        _fill(result, fit, folder)


def read_method(request: Identify.Goal) -> Method:
    """Make the method of a goal, in which 0, an empty text and an empty list stand for the default.

    Raises
    ------
    InputError
        For an option that cannot be used.
    """
    given = {field.name: getattr(request, field.name) for field in fields(Method) if field.name != "profile"}
    options: dict[str, Any] = {name: value for name, value in given.items() if value or isinstance(value, bool)}
    return parse_method(**options, profile=not request.no_profile)


def _fill(result: Identify.Result, fit: Fit, folder: Path) -> None:
    result.message = fit.sentence
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
