"""Diagnosis as a node: the action `diagnose` does what the tool ``diagnose`` does."""

import os
from collections.abc import Callable
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from mrd_base.nodes.bench_node import run_node
from mrd_base.nodes.graph import DIAGNOSE
from mrd_diagnosis.diagnose import BEST_MODEL, diagnose
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.report.sentences import next_command
from mrd_identification.fit_file import read_fit
from mrd_identification.json_file import make_folder
from mrd_identification.low_pass import with_force_filters
from mrd_interfaces.action import Diagnose
from mrd_runs.nodes.analysis_node import AnalysisNode
from mrd_sim.current import parse_laws
from mrd_sim.models import find_model
from mrd_sim.own import own_catalogue
from mrd_trajectory.settings import read_settings


class Diagnoser(AnalysisNode):
    """Serves the action ``diagnose``."""

    def __init__(self) -> None:
        super().__init__("diagnoser", DIAGNOSE.type, DIAGNOSE.name)

    def check(self, request: Diagnose.Goal) -> None:
        """Refuse a model or current laws that there are not."""
        parse_laws(request.laws, "laws")
        if request.model != BEST_MODEL:
            with own_catalogue(request.models_folder):
                find_model(request.model)

    def work(self, request: Diagnose.Goal, publish: Callable[[Any], None], result: Diagnose.Result) -> None:
        """Diagnose the gap that the goal asks about, and write the report."""

        def progress(stage: str, fraction: float) -> None:
            publish(Diagnose.Feedback(stage=stage, fraction=fraction))

        folder = make_folder(request.output)
        laws = parse_laws(request.laws, "laws")
        parameters = read_fit(request.parameters) if request.parameters else None
        bench = read_settings(request.bench or os.environ.get("MRD_BENCH"))
        with own_catalogue(request.models_folder, request.effects_folder):
            groups = self.runs(request, "reference")
            runs, held_out, reference = with_force_filters(groups, request.force_filters, "force_filters")
            diagnosis = diagnose(
                runs,
                request.model,
                held_out=held_out,
                reference=reference,
                parameters=parameters,
                laws=laws or None,
                effects=tuple(request.effects),
                bench=bench,
                seed=request.seed,
                progress=progress,
            )
            page = write_gap_report(diagnosis, folder.resolve())
            result.next_command = next_command(diagnosis, str(page.parent))
        result.report = str(page)
        result.message = diagnosis.sentence
        result.verdict = diagnosis.verdict
        result.causes = [cause.effect for cause in diagnosis.causes]
        result.probability = [cause.probability for cause in diagnosis.causes]
        result.closed_fraction = diagnosis.gap.closed_fraction.value if diagnosis.gap else float("nan")


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis diagnoser``."""
    run_node(Diagnoser, SingleThreadedExecutor)
