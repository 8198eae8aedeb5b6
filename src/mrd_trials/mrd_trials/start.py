"""Where a recording begins: at rest, or in mid-motion as most recordings of laboratories do."""

from collections.abc import Sequence

import numpy as np

from mrd_runs import Run

CUT = (0.3, 2.2)
"""Range in s of what is cut off at the start of a recording that begins in mid-motion."""

LARGEST_SHARE = 0.25
"""Share of a recording that is cut off at most."""


def begin_later(runs: Sequence[Run], seed: int | None) -> list[Run]:
    """Return runs without their first part, of another length in each; with the seed None, return them as they are.

    What is cut off a run depends on its place and on the seed alone.
    """
    if seed is None:
        return list(runs)
    cuts = np.random.default_rng(seed).uniform(*CUT, size=len(runs))
    return [run.without_start(min(float(cut), LARGEST_SHARE * run.duration)) for run, cut in zip(runs, cuts, strict=True)]
