"""The first recordings of a sequential diagnosis: short, and within the limits of the bench."""

from mrd_base import InputError
from mrd_diagnosis.experiment_design.experiment_library import library, sizes_of_bench
from mrd_trajectory.plan import Plan
from mrd_trajectory.settings import GeneratorSettings

FIRST_SET = ("large_random_current", "whole_stroke_current", "speed_ladder", "steps_at_two_speeds")
"""Experiments of the library that show most effects together: everything at once, with two equal periods that give the
noise; the whole stroke at all currents; slow and fast strokes; steps of the current.
"""


def first_set(bench: GeneratorSettings) -> list[Plan]:
    """Return the experiments that are recorded before anything is known about the damper.

    The first of them is the one on which the recordings are checked for faults.

    Raises
    ------
    InputError
        For a bench whose limits none of them keeps.
    """
    plans = {planned.experiment.name: planned for planned in library(bench, sizes_of_bench(bench), FIRST_SET)}
    chosen = [plans[name] for name in FIRST_SET if name in plans]
    if not chosen:
        raise InputError("limits: found none of the first experiments within them, expected at least one; check bench.yaml")
    return chosen
