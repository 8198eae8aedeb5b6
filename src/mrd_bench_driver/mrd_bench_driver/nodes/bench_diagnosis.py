"""The option ``--diagnose`` of the tool ``bench``: record and diagnose in turn, and print what each round added."""

import itertools
import sys
from pathlib import Path
from typing import Any

from mrd_base import InputError
from mrd_base.progress import shown_progress
from mrd_bench_driver.nodes.bench_client import BenchClient
from mrd_interfaces.action import DiagnoseOnBench
from mrd_runs import read_runs

BY_HAND = 12.0
"""Bench time in s of a recording by hand: as long as the other recordings of a diagnosis."""


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

    Where only a measurement by hand separates what is open, a person at a terminal is led through it, and the diagnosis goes
    on with its recording. The process ends with status 1 where the diagnosis could not be finished; what was recorded until
    then is kept.
    """
    result = _diagnose(client, goal)
    if not result.success:
        tell_what_is_kept(Path(goal.folder))
        print(f"error: {result.message or 'the diagnoser failed; look at its log'}", file=sys.stderr)
        sys.exit(1)
    _tell(result)
    while result.ending == "nothing_separates" and sys.stdin.isatty():
        run = _measurement_by_hand(client, Path(goal.folder))
        if not run:
            break
        goal.runs = [*goal.runs, str(run)]
        further = _diagnose(client, goal)
        if further.success:
            result = further
            _tell(result)
        else:
            print(f"{run}: is not used: {further.message or 'the diagnoser failed; look at its log'}")
            goal.runs = goal.runs[:-1]
    if result.ending == "nothing_separates":
        print(
            "go on with that measurement by: ros2 run mrd_bench_driver bench, with the same options and "
            f"--resume --output {goal.folder} --add RUN"
        )
    if result.next_command:
        print(f"next command: {result.next_command}")
    print(result.report)


def _diagnose(client: BenchClient, goal: DiagnoseOnBench.Goal) -> Any:
    """Run the diagnosis of a goal, print what each round added, and return its result."""
    printed = 0
    with shown_progress("diagnosing on the bench") as report:

        def progress(feedback: Any) -> None:
            nonlocal printed
            if feedback.added and feedback.round > printed + 1:
                printed = feedback.round - 1
                print(f"round {printed}: {feedback.added}", flush=True)
            report(f"round {feedback.round}: {feedback.stage}", feedback.fraction)

        return client.diagnose_on_bench(goal, progress)


def _tell(result: Any) -> None:
    rounds = "one round" if result.rounds == 1 else f"{result.rounds} rounds"
    print(f"after {rounds}, {result.duration:.0f} s of bench time: {result.message}")
    print(f"it ends here: {result.why}", flush=True)


def _measurement_by_hand(client: BenchClient, folder: Path) -> Path | None:
    """Ask for the recording of a measurement by hand, or make it; return its path, None where the person ends here."""
    while True:
        print(
            f"Prepare that measurement. Enter records {BY_HAND:g} s with this bench, drive and coil off; or type the path "
            "of a recording that was made elsewhere, or q to end here:",
            flush=True,
        )
        answer = client.read_line()
        if answer.lower() in ("q", "quit"):
            return None
        try:
            if answer:
                read_runs([answer])
                return Path(answer).resolve()
            bags = (folder / "by_hand" / f"measurement_{number}" for number in itertools.count(1))
            bag = next(bag for bag in bags if not bag.exists())
            bag.parent.mkdir(exist_ok=True)
            print("recording: make the measurement now", flush=True)
            client.record_by_hand(bag, BY_HAND)
            print(f"recorded: {bag}", flush=True)
            return bag
        except InputError as error:
            print(error)
