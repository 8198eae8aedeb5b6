"""The option ``--diagnose`` of the tool ``bench``: record and diagnose in turn, and print what each round added."""

import itertools
import sys
from collections.abc import Sequence
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
    """Return the recordings of the rounds of a diagnosis in its folder, and those that ended early."""
    found = [*folder.glob("round_*/*/metadata.yaml"), *folder.glob("round_*/incomplete/*/metadata.yaml")]
    return sorted(path.parent for path in found)


def tell_what_is_kept(folder: Path, by_hand: Sequence[Path] = ()) -> None:
    """Print what an interrupted diagnosis has recorded, and how to go on with it and with measurements that were made by
    hand; nothing where it has recorded nothing.
    """
    bags = [*recorded_in(folder), *by_hand]
    for bag in bags:
        print(f"recorded until then: {bag}", file=sys.stderr)
    if bags:
        added = "".join(f" {bag}" for bag in by_hand)
        print(
            f"go on by the same command with --resume --output {folder}{' --add' if added else ''}{added}", file=sys.stderr
        )


def diagnose_on_bench(client: BenchClient, goal: DiagnoseOnBench.Goal) -> None:
    """Run a diagnosis on the bench, and print its rounds and its answer.

    Where only a measurement by hand separates what is open, a person at a terminal is led through it, and the diagnosis goes
    on with its recording. The process ends with status 1 where the diagnosis could not be finished; what was recorded until
    then is kept.
    """
    by_hand: list[Path] = []
    result = _diagnose(client, goal)
    while result.success:
        _tell(result)
        measured = _measure_until_used(client, goal) if result.ending == "nothing_separates" and sys.stdin.isatty() else None
        if measured is None:
            _tell_next(result, goal)
            return
        run, result = measured
        by_hand.append(run)
    tell_what_is_kept(Path(goal.folder), by_hand)
    print(f"error: {_reason(result)}", file=sys.stderr)
    sys.exit(1)


def _measure_until_used(client: BenchClient, goal: DiagnoseOnBench.Goal) -> tuple[Path, Any] | None:
    """Lead a person through measurements by hand until one is used, or the bench is stopped; return its recording, which is
    then one of the goal, and the result. None where the person ends here.
    """
    while (run := _measurement_by_hand(client, Path(goal.folder))) and _may_move(client):
        runs, goal.runs = list(goal.runs), [*goal.runs, str(run)]
        result = _diagnose(client, goal)
        if result.success or result.bench_failed:
            return run, result
        print(f"{run}: is not used: {_reason(result)}")
        goal.runs = runs
    return None


def _may_move(client: BenchClient) -> bool:
    """Ask whether the bench may move again: a person has worked at it. A stop from then on counts, not one before."""
    print(
        "The diagnosis goes on with it, and may record again: the rod MOVES then. Connect the drive, remove what you have "
        "put in, and step back; reset the bench if you have stopped it. Enter goes on, q ends here:",
        flush=True,
    )
    return client.read_line().lower() not in ("q", "quit")


def _reason(result: Any) -> str:
    return result.message or "the diagnoser failed; look at its log"


def _tell_next(result: Any, goal: DiagnoseOnBench.Goal) -> None:
    """Print what follows from the answer, and where its report is."""
    if result.ending == "nothing_separates":
        print(
            "go on with that measurement by: ros2 run mrd_bench_driver bench, with the same options and "
            f"--resume --output {goal.folder} --add {' '.join([*goal.runs, 'RUN'])}"
        )
    if result.next_command:
        print(f"next command: {result.next_command}")
    print(result.report)


def _diagnose(client: BenchClient, goal: DiagnoseOnBench.Goal) -> Any:
    """Run the diagnosis of a goal, print what each round added, and return its result. A stop from now on ends it."""
    goal.stops = client.stops
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
