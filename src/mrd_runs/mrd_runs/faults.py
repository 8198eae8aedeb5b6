"""Faults of recordings that make every fit worthless: signs that are wrong.

They are checked where a file is imported; before a fit, `mrd_identification.preflight` looks for many more.
"""

from collections.abc import Callable, Sequence

import numpy as np
import scipy

from mrd_base.tool import command
from mrd_runs.run import Run

_FEWEST_TURNS = 3
_WRONG_SIGN_WORK = -0.2
"""Work on the damper over the largest work of the same forces, below which a sign is wrong: it is positive at every usual
delay, and near zero for a spring."""
_TURNED = -0.3
"""Correlation of the velocity with the differences of the position, below which one of them is turned; noise lowers it."""
_SEGMENTS = 200


def find_faults(runs: Sequence[Run]) -> list[str]:
    """Return a clause for each kind of fault that recordings show, with the runs that show it; empty for sound ones."""
    import_ = command("mrd_runs", "import")
    return [
        f"{_named(found, runs)}: {text.format(import_=import_)}"
        for look, text in _CHECKS
        if (found := [run for run in runs if look(run)])
    ]


def relative_work(run: Run) -> float:
    """Return the work done on the damper over the largest work that the same forces and displacements could do, -1 to 1."""
    force = run.force - run.force.mean()
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(run.position)
    # Noise of the position adds work of both signs from sample to sample: sum it over segments before taking magnitudes.
    segments = np.array([segment.sum() for segment in np.array_split(work, min(_SEGMENTS, len(work)))])
    total = float(np.abs(segments).sum())
    return float(segments.sum()) / total if total else 0.0


def _has_wrong_sign(run: Run) -> bool:
    turns = sum(
        len(scipy.signal.find_peaks(sign * run.position, prominence=0.2 * np.ptp(run.position))[0]) for sign in (1, -1)
    )
    return turns >= _FEWEST_TURNS and relative_work(run) < _WRONG_SIGN_WORK


def _has_turned_velocity(run: Run) -> bool:
    if np.ptp(run.velocity) == 0 or np.ptp(run.position) == 0:
        return False
    return float(np.corrcoef(run.velocity, np.gradient(run.position, run.time))[0, 1]) < _TURNED


_CHECKS: tuple[tuple[Callable[[Run], bool], str], ...] = (
    (
        _has_wrong_sign,
        "the damper drives the rod, expected that it resists: the force or the position has the wrong sign "
        "(force > 0 resists extension, position > 0 extends); turn it with `{import_} FILE --flip force --output DIR`",
    ),
    (
        _has_turned_velocity,
        "the velocity falls where the position rises: one of them has the wrong sign; turn it with "
        "`{import_} FILE --flip velocity --output DIR` or position",
    ),
)


def _named(found: Sequence[Run], runs: Sequence[Run]) -> str:
    if len(found) == len(runs) > 1:
        return f"all {len(runs)} runs"
    return ", ".join(run.name for run in found[:5]) + (f" and {len(found) - 5} more runs" if len(found) > 5 else "")
