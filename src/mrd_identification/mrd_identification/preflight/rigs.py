"""Check for runs of different rigs: forces that differ too much at the same speed and current."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mrd_identification.preflight.channels import PRE_YIELD_STROKE, CheckedRun
from mrd_identification.preflight.finding import Finding

Array = NDArray[np.float64]

LARGEST_RATIO = 2.4
"""Largest ratio of forces at the same speed and current that scatter, heat or remanence explain."""
PLACE = 0.05
"""Length, over half the span of all positions, of a place of the stroke, within which the force of a spring hardly
changes."""
ADDED_FORCE = 0.04
"""Force, over half the span of all forces, that is added to both forces before they are compared: remanence may double
a small off-state force."""
UNIT_RATIOS = {1e3: "kN against N", 9.80665: "kgf against N", 4.44822: "lbf against N"}
"""Ratios of forces that a wrong unit explains."""
CELL_SHARE = 0.02
"""Share of the samples of a run from which a cell of speed and current holds a steady force and not a transition."""
CELL_SAMPLES = 20
"""Samples from which the median force of a cell is reliable."""
SPEED_EDGES = np.array([0.2, 0.4, 0.8, 1.6, 3.2, 6.4])
"""Edges, in units of the speed of fast strokes, of the cells, above the speeds at which hysteresis rules the force."""
CURRENT_EDGES = np.array([-np.inf, *np.arange(0.025, 1.0, 0.05), np.inf])
"""Edges, in units of the largest current, of the cells, around its twentieths: setpoints are its simple fractions."""


def check_rigs(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    """Find runs whose forces at the same speed and current differ more than scatter explains."""
    # Short strokes do not leave the pre-yield loop of the damper.
    moving = [checked for checked in runs if checked.stroke > 2 * PRE_YIELD_STROKE * checked.scales.stroke]
    forces = [np.abs(_force_by_cell(checked)) for checked in moving]
    added = ADDED_FORCE * runs[0].scales.force if runs else 0.0
    while len(moving) > 1:
        compared = [_disagreement(force, forces[:index] + forces[index + 1 :], added) for index, force in enumerate(forces)]
        # One wrong run makes other runs look wrong that share cells with it alone, so only the worst run is reported.
        worst = max(range(len(moving)), key=lambda index: compared[index][0])
        disagreeing, ratio = compared[worst]
        if not disagreeing:
            return
        factor = max(ratio, 1 / max(ratio, 1e-9))
        unit = next((f" ({text})" for known, text in UNIT_RATIOS.items() if 0.8 < factor / known < 1.25), "")
        text = (
            f"the force is {ratio:.3g} times that of the other runs at the same speed and current: expected within a factor "
            f"of {LARGEST_RATIO:g}. Check whether this run has another damper, load cell or unit{unit}. Diagnose each rig "
            "separately."
        )
        yield moving.pop(worst).finding("rig", "fault", "force", text)
        forces.pop(worst)


def _force_by_cell(checked: CheckedRun) -> Array:
    """Return half the force in N between extension and compression, (speeds, currents); nan where there are few samples."""
    run = checked.run
    speed = np.digitize(np.abs(run.velocity) / checked.scales.speed, SPEED_EDGES) - 1
    current = np.digitize(np.abs(run.current) / checked.scales.current, CURRENT_EDGES) - 1
    shape = (len(SPEED_EDGES) - 1, len(CURRENT_EDGES) - 1)
    starts = checked.stroke_starts
    start = starts[np.searchsorted(starts, np.arange(len(run)), side="right") - 1]
    # After a reversal the pre-yield loop and the play of joints rule the force, whatever the speed.
    settled = np.abs(run.position - run.position[start]) > PRE_YIELD_STROKE * checked.scales.stroke
    inside = np.flatnonzero(settled & (speed >= 0) & (speed < shape[0]))
    cell, extends = (speed * shape[1] + current)[inside], run.velocity[inside] > 0
    # At a place of the stroke, springs and end stops press equally in both directions, so half the difference lacks them.
    place = np.floor((run.position[inside] - run.position.min()) / (PLACE * checked.scales.stroke)).astype(np.intp)
    group = place * shape[0] * shape[1] + cell
    both = np.intersect1d(group[extends], group[~extends])
    force = np.full(shape, np.nan)
    if not len(both):
        return force
    out, back = (ndimage.median(run.force[inside][way], group[way], both) for way in (extends, ~extends))
    compared = np.isin(group, both)
    half = 0.5 * (out - back)[np.searchsorted(both, group[compared])]
    cell = cell[compared]
    counts = np.bincount(cell, minlength=force.size)
    for index in np.flatnonzero(counts >= 2 * max(CELL_SAMPLES, CELL_SHARE * len(run))):
        force.flat[index] = np.median(half[cell == index])
    return force


def _disagreement(force: Array, forces_of_others: Sequence[Array], added: float) -> tuple[int, float]:
    """Return the number of runs that a run disagrees with, 0 if it agrees with their median, and the ratio of the forces."""
    others = np.stack(forces_of_others)
    shared = np.isfinite(force) & np.isfinite(others).any(axis=0)
    if not shared.any():
        return 0, 1.0
    usual = np.nanmedian(others[:, shared], axis=0)
    ratio, size = (
        float(force[shared] @ usual / max(float(usual @ usual), np.finfo(float).tiny)),
        float(np.sqrt(np.mean(usual**2))),
    )
    if abs(np.log((ratio * size + added) / (size + added))) < np.log(LARGEST_RATIO):
        return 0, ratio
    return int(np.isfinite(others[:, shared]).any(axis=1).sum()), ratio
