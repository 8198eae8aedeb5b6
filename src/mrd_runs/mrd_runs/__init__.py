"""What a recording is: the Run, bags, recorder, replay, import."""

from mrd_runs.check import make_run
from mrd_runs.read import read_run, read_runs
from mrd_runs.run import Run

__all__ = ["Run", "make_run", "read_run", "read_runs"]
