"""Diagnosis as a node: of recorded runs (action `diagnose`), and of runs that the bench records for it
(`diagnose_on_bench`).
"""

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from mrd_base import InputError
from mrd_base.json_file import make_folder
from mrd_base.nodes.bench_node import run_node
from mrd_base.nodes.graph import DIAGNOSE, DIAGNOSE_ON_BENCH
from mrd_diagnosis.diagnose import BEST_MODEL, diagnose
from mrd_diagnosis.nodes.recording_client import BenchError, RecordingClient
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.report.sentences import next_command
from mrd_diagnosis.sequential.recorded import folder_of_round, read_later_rounds, read_recorded, set_aside_incomplete
from mrd_diagnosis.sequential.report import command_after, write_sequential_report
from mrd_diagnosis.sequential.sequential import BUDGET, Round, diagnose_sequentially
from mrd_identification.fit_file import read_fit
from mrd_identification.low_pass import with_force_filters
from mrd_interfaces.action import Diagnose, DiagnoseOnBench
from mrd_runs import Run, read_runs
from mrd_runs.nodes.analysis_node import AnalysisNode, Offer
from mrd_sim.current import parse_laws
from mrd_sim.models import find_model
from mrd_sim.own import own_catalogue
from mrd_trajectory.plan import Plan
from mrd_trajectory.settings import read_settings


class Diagnoser(AnalysisNode):
    """Serves the actions ``diagnose`` and ``diagnose_on_bench``, one goal at a time."""

    def __init__(self) -> None:
        super().__init__(
            "diagnoser",
            Offer(DIAGNOSE, self.check, self.work),
            Offer(
                DIAGNOSE_ON_BENCH,
                self.check_on_bench,
                self.work_on_bench,
                lambda error: {"bench_failed": isinstance(error, BenchError)},
            ),
        )
        self._bench = RecordingClient(self)

    def check(self, request: Diagnose.Goal) -> None:
        """Refuse a model or current laws that there are not."""
        parse_laws(request.laws, "laws")
        _check_model(request.model, request.models_folder)

    def check_on_bench(self, request: DiagnoseOnBench.Goal) -> None:
        """Refuse a model that there is not, and an empty folder."""
        _check_model(request.model or BEST_MODEL, request.models_folder)
        if not request.folder:
            raise InputError("folder: is empty, expected the folder of recordings and reports")

    def work_on_bench(
        self, request: DiagnoseOnBench.Goal, publish: Callable[[Any], None], result: DiagnoseOnBench.Result
    ) -> None:
        """Record and diagnose in turn, and write the reports of every round. A stop of the bench ends it."""
        stops = self._bench.require_idle()
        if request.stops and request.stops != stops:
            raise BenchError("the bench was stopped since the diagnosis was asked for")
        folder = make_folder(request.folder).resolve()
        bench = read_settings(request.bench or os.environ.get("MRD_BENCH"))
        parameters = read_fit(request.parameters) if request.parameters else None
        further = read_runs(request.runs) if request.runs else []
        # With other recordings, other experiments come next: then the rounds until now are no steps to them.
        earlier, earlier_rounds = read_later_rounds(folder) if further else ([], 0)
        rounds: list[Round] = []
        reached: dict[int, float] = {}

        def progress(number: int, stage: str, fraction: float, moves: bool = False) -> None:
            if not moves:  # the end of a recording tells itself by what it was stopped
                self._bench.require_no_stop_since(stops)
            added = rounds[-1].added if rounds else ""
            reached[number] = fraction = max(fraction, reached.get(number, 0.0))  # the first round records twice
            publish(DiagnoseOnBench.Feedback(round=number, stage=stage, moves=moves, fraction=fraction, added=added))

        def record(number: int, plans: Sequence[Plan]) -> list[Run]:
            def recording(place: int, stage: str, fraction: float) -> None:
                progress(number, stage, 0.5 * (place + fraction) / len(plans), moves=True)

            of_round = folder_of_round(folder, number)
            for bag in set_aside_incomplete(plans, of_round):
                self.get_logger().warning(f"{bag}: does not hold its whole experiment, which is recorded again")
            for place, planned in enumerate(plans):
                if not (of_round / planned.experiment.name).exists():
                    self._bench.record(planned, of_round, request.seed, stops, partial(recording, place))
            return read_recorded(plans, of_round)

        def on_round(of_round: Round) -> None:
            rounds.append(of_round)
            write_gap_report(of_round.diagnosis, make_folder(str(folder_of_round(folder, of_round.number) / "report")))

        with own_catalogue(request.models_folder, request.effects_folder):
            outcome = diagnose_sequentially(
                record,
                request.model or BEST_MODEL,
                bench=bench,
                budget=request.budget or BUDGET,
                further=further,
                earlier=earlier,
                earlier_rounds=earlier_rounds,
                parameters=parameters,
                seed=request.seed,
                on_round=on_round,
                progress=lambda number, stage, fraction: progress(number, stage, 0.5 + 0.5 * fraction),
            )
            page = write_sequential_report(outcome, folder)
            result.next_command = command_after(outcome, folder)
        diagnosis = outcome.diagnosis
        result.message, result.verdict, result.report = diagnosis.sentence, diagnosis.verdict, str(page)
        result.causes = [cause.effect for cause in diagnosis.causes]
        result.probability = [cause.probability for cause in diagnosis.causes]
        result.ending, result.why = outcome.ending, outcome.why
        result.rounds, result.duration = len(outcome.rounds), outcome.duration

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


def _check_model(model: str, folder: str) -> None:
    """Refuse a model that there is not, given the folder of models of one's own."""
    if model != BEST_MODEL:
        with own_catalogue(folder):
            find_model(model)


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis diagnoser``."""
    run_node(Diagnoser, SingleThreadedExecutor)
