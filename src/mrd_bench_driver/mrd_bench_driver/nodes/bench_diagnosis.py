"""The option ``--diagnose`` of the tool ``bench``: record and diagnose in turn, and print what each round added."""

import sys
from pathlib import Path
from typing import Any

from mrd_base.progress import shown_progress
from mrd_bench_driver.nodes.bench_client import BenchClient
from mrd_interfaces.action import DiagnoseOnBench


def recorded_in(folder: Path) -> list[Path]:
    """Return the recordings of the rounds of a diagnosis in its folder."""
    return sorted(path.parent for path in folder.glob("round_*/*/metadata.yaml"))


def tell_what_is_kept(folder: Path) -> None:
    """Print what an interrupted diagnosis has recorded, and how to go on with it."""
    for bag in recorded_in(folder):
        print(f"recorded until then: {bag}", file=sys.stderr)
    print(f"go on by the same command with --resume --output {folder}", file=sys.stderr)


def diagnose_on_bench(client: BenchClient, goal: DiagnoseOnBench.Goal) -> None:
    """Run a diagnosis on the bench, and print its rounds and its answer.

    The process ends with status 1 where it could not be finished; what was recorded until then is kept.
    """
    printed = 0
    with shown_progress("diagnosing on the bench") as report:

        def progress(feedback: Any) -> None:
            nonlocal printed
            if feedback.added and feedback.round > printed + 1:
                printed = feedback.round - 1
                print(f"round {printed}: {feedback.added}", flush=True)
            report(f"round {feedback.round}: {feedback.stage}", feedback.fraction)

        result = client.diagnose_on_bench(goal, progress)
    if not result.success:
        tell_what_is_kept(Path(goal.folder))
        print(f"error: {result.message or 'the diagnoser failed; look at its log'}", file=sys.stderr)
        sys.exit(1)
    rounds = "one round" if result.rounds == 1 else f"{result.rounds} rounds"
    print(f"after {rounds}, {result.duration:.0f} s of bench time: {result.message}")
    print(f"it ends here: {result.why}")
    if result.ending == "nothing_separates":
        print(
            "go on with that measurement by: ros2 run mrd_bench_driver bench, with the same options and "
            f"--resume --output {goal.folder} --add RUN"
        )
    if result.next_command:
        print(f"next command: {result.next_command}")
    print(result.report)
