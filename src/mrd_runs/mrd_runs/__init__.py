"""Recordings: the Run, bags, recorder, replay, import."""

from mrd_runs.read import read_run, read_runs
from mrd_runs.run import Run
from mrd_runs.validation import make_run

__all__ = ["Run", "make_run", "read_run", "read_runs"]
