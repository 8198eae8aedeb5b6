"""Runs of different rigs."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Finding
from mrd_diagnosis.preflight.channels import SHORT_STROKE, View

Array = NDArray[np.float64]

RIG_RATIO = 2.4
"""Ratio of forces at the same speed and current which no scatter, heat or remanence explains."""
RIG_FORCE = 30.0
"""N added to both before they are compared: remanence may double a small off-state force."""
UNITS = {1e3: "kN against N", 9.80665: "kgf against N", 4.44822: "lbf against N"}
CELL = 0.02
"""Share of a run's samples from which they tell a force, not a transition."""
SPEEDS = np.array([0.02, 0.04, 0.08, 0.16, 0.32, 0.64])
"""m/s; edges of the cells in which forces of runs are compared, above the speeds at which hysteresis rules."""
CURRENTS = np.array([-np.inf, *np.arange(0.05, 3.0, 0.1), np.inf])
"""A; edges around round set-points."""


def _forces(view: View) -> Array:
    """Half the force between out and in stroke, N, (speeds, currents); nan where there are few samples."""
    speed = np.digitize(np.abs(view.run.velocity), SPEEDS) - 1
    current = np.digitize(np.abs(view.run.current), CURRENTS) - 1
    shape = (len(SPEEDS) - 1, len(CURRENTS) - 1)
    found = np.full((2, *shape), np.nan)
    inside = (speed >= 0) & (speed < shape[0])
    cell = np.where(inside, speed * shape[1] + current, -1)
    for side, mask in enumerate((view.run.velocity > 0, view.run.velocity < 0)):
        counts = np.bincount(cell[inside & mask], minlength=shape[0] * shape[1])
        for index in np.flatnonzero(counts >= max(20, CELL * len(speed))):
            found[side].flat[index] = np.median(view.run.force[mask & (cell == index)])
    return np.asarray(0.5 * (found[0] - found[1]))


def rigs(views: Sequence[View]) -> Iterator[Finding]:
    """Runs whose forces at the same speed and current differ beyond any scatter."""
    # Short strokes do not leave the damper's hysteresis.
    moved = [view for view in views if view.stroke > 2 * SHORT_STROKE]
    forces = [np.abs(_forces(view)) for view in moved]
    while len(moved) > 1:
        compared = [_against(forces[:index] + forces[index + 1 :], own) for index, own in enumerate(forces)]
        # One strange run makes others look strange that share cells with it alone.
        worst = max(range(len(moved)), key=lambda index: compared[index][0])
        strangeness, ratio = compared[worst]
        if not strangeness:
            return
        factor = max(ratio, 1 / max(ratio, 1e-9))
        unit = next((f" ({text}?)" for known, text in UNITS.items() if 0.8 < factor / known < 1.25), "")
        yield moved.pop(worst).finding(
            "rig",
            "fault",
            "force",
            f"is {ratio:.3g} times that of the other runs at the same speed and current, expected within a factor "
            f"{RIG_RATIO:g}{unit}; is it another damper, load cell or unit? Diagnose rigs one by one",
        )
        forces.pop(worst)


def _against(others: Sequence[Array], own: Array) -> tuple[int, float]:
    """How many other runs a run's forces (speeds, currents) disagree with in all, and their ratio."""
    rest = np.stack(others)
    shared = np.isfinite(own) & np.isfinite(rest).any(axis=0)
    if not shared.any():
        return 0, 1.0
    usual = np.nanmedian(rest[:, shared], axis=0)
    ratio, size = float(own[shared] @ usual / (usual @ usual + 1e-12)), float(np.sqrt(np.mean(usual**2)))
    if abs(np.log((ratio * size + RIG_FORCE) / (size + RIG_FORCE))) < np.log(RIG_RATIO):
        return 0, ratio
    return int(np.isfinite(rest[:, shared]).any(axis=1).sum()), ratio
