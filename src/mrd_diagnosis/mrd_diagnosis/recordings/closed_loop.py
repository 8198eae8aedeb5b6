"""Recordings of hybrid tests, whose motion and current follow from the force."""

import shlex
from collections.abc import Sequence

from mrd_base import InputError
from mrd_base.config import parse_yaml
from mrd_base.tool import command
from mrd_runs import Run


def hybrid_tests(runs: Sequence[Run]) -> list[Run]:
    """Return the runs that are of a hybrid test: only such an experiment has a control law."""
    return [run for run in runs if _has_law(run.info.get("experiment"))]


def _has_law(experiment: object) -> bool:
    if not isinstance(experiment, str):
        return False
    try:
        return "law" in parse_yaml(experiment, "experiment")
    except InputError:
        return False


def closed_loop_notes(runs: Sequence[Run]) -> list[str]:
    """Return what is to know about the recordings of hybrid tests among the runs."""
    names = ", ".join(run.name for run in hybrid_tests(runs))
    if not names:
        return []
    return [
        f"{names}: a closed loop (hybrid test). The damper is identified as in an open one; but its motion is no input, so "
        "that what a cause does to the ride is told by `review`, which runs the offline twin again with it."
    ]


def review_commands(runs: Sequence[Run], corrected: str) -> list[str]:
    """Return the commands that tell what the causes do to the ride of the hybrid tests among the runs.

    ``corrected`` is the gap_report.json, or the plant.yaml of `apply`.
    """
    review = command("mrd_control", "review")
    return [
        f"{review} {shlex.quote(str(run.info['source']))} --diagnosis {corrected} --output DIR"
        for run in hybrid_tests(runs)
        if run.info.get("source")
    ]
