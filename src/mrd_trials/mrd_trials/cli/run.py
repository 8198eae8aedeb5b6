"""Let the diagnosis judge the plants of a trial."""

import argparse
from collections import Counter
from pathlib import Path

from mrd_base import run_tool
from mrd_trials.cli.options import add_trial, add_workers, progress, workers_of
from mrd_trials.run import frozen, run


def main() -> None:
    """Entry point of ``ros2 run mrd_trials run``."""
    run_tool(work)


def work() -> None:
    """Parse, diagnose, report."""
    parser = argparse.ArgumentParser(
        prog="run", description="Diagnose every plant of a trial, one verdict each; goes on where it was interrupted."
    )
    add_trial(parser)
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="where the verdicts go")
    parser.add_argument("--seed", type=int, default=0, help="of every diagnosis (default %(default)s)")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="work on the dask cluster of this scheduler")
    add_workers(parser)
    arguments = parser.parse_args()
    with progress("diagnosing") as show:
        found = run(
            arguments.trial,
            arguments.output,
            frozen(arguments.seed),
            workers=workers_of(arguments),
            scheduler=arguments.scheduler,
            progress=show,
        )
    counts = Counter(each.verdict for each in found.values())
    print(", ".join(f"{verdict}: {count}" for verdict, count in counts.most_common()))
    for each in found.values():
        if each.failure:
            print(f"{each.plant} failed: {each.failure}")
