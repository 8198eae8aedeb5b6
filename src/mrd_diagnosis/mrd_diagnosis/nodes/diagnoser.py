"""Diagnosis as a node: the action `diagnose` does what the tool ``diagnose`` does."""

from collections.abc import Callable
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from mrd_base.nodes.bench_node import run_node
from mrd_diagnosis.diagnose import diagnose
from mrd_diagnosis.report.page import write_gap_report
from mrd_identification.fit_file import read_fit
from mrd_identification.json_file import make_folder
from mrd_interfaces.action import Diagnose
from mrd_runs.nodes.analysis_node import AnalysisNode


class Diagnoser(AnalysisNode):
    """Serves the action ``diagnose``."""

    def __init__(self) -> None:
        super().__init__("diagnoser", Diagnose, "diagnose")

    def work(self, request: Diagnose.Goal, publish: Callable[[Any], None], result: Diagnose.Result) -> None:
        """Diagnose the gap that the goal asks about, and write the report."""

        def progress(stage: str, fraction: float) -> None:
            publish(Diagnose.Feedback(stage=stage, fraction=fraction))

        folder = make_folder(request.output)
        parameters = read_fit(request.parameters) if request.parameters else None
        runs, held_out = self.runs(request)
        diagnosis = diagnose(
            runs,
            request.model,
            held_out=held_out,
            parameters=parameters,
            effects=tuple(request.effects),
            seed=request.seed,
            progress=progress,
        )
        result.report = str(write_gap_report(diagnosis, folder).resolve())
        result.message = diagnosis.sentence
        result.verdict = diagnosis.verdict
        result.causes = [cause.effect for cause in diagnosis.causes]
        result.probability = [cause.probability for cause in diagnosis.causes]
        result.closed_fraction = diagnosis.gap.closed_fraction.value if diagnosis.gap else float("nan")


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis diagnoser``."""
    run_node(Diagnoser, SingleThreadedExecutor)
