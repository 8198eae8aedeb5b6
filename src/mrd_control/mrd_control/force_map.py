"""The force of a damper over speed and coil current in steady motion, and its inverse: the current for a force."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim.damper import Damper
from mrd_sim.path import Path

Array = NDArray[np.float64]

SPEEDS = np.geomspace(2e-3, 2.0, 12)
"""m/s, of the map, in both directions. Below the slowest one the force is taken as there."""
CURRENTS = 11
"""Currents of the map."""
STEADY_TRAVEL = 0.02
"""m. Travel at constant speed after which every hysteresis has ended."""
VERTICES = 50
LEAST_RISE = 1e-3
"""Rise of the force from the least to the largest current, over the largest force of the map, without which a damper
cannot be controlled."""


def force_map(damper: Damper, most_current: float) -> Array:
    """Return the force in steady motion through mid-stroke.

    Parameters
    ----------
    damper : Damper
        Its state is not changed.
    most_current : float
        Largest coil current in A.

    Returns
    -------
    ndarray (1 + speeds, 1 + currents)
        Force in N; the first column holds the speeds in m/s, the first row the currents in A.
    """
    speeds = np.concatenate([-SPEEDS[::-1], SPEEDS])
    currents = np.linspace(0.0, most_current, CURRENTS)
    table = np.zeros((1 + len(speeds), 1 + len(currents)))
    table[1:, 0], table[0, 1:] = speeds, currents
    for i, speed in enumerate(speeds):
        travel = np.sign(speed) * np.linspace(-STEADY_TRAVEL, 0.0, VERTICES)
        steps = np.full(VERTICES, STEADY_TRAVEL / VERTICES / abs(speed))
        steps[0] = 0.0
        for j, current in enumerate(currents):
            along = np.full(VERTICES, speed), np.zeros(VERTICES), np.full(VERTICES, current)
            path = Path(steps, travel, *along, np.arange(VERTICES))
            table[1 + i, 1 + j] = damper.model.force(damper.model.without_effects(damper.theta), path)[-1]
    return table


def inverse_map(damper: Damper, most_current: float) -> Array:
    """Return the `force_map` of a damper whose force has an inverse over the coil current.

    Raises
    ------
    InputError
        When the force does not rise with the current.
    """
    table = force_map(damper, most_current)
    currents = table[0, 1:]
    resisting = np.sign(table[1:, :1]) * table[1:, 1:]
    rise = np.diff(resisting, axis=1)
    i, j = np.unravel_index(int(np.argmin(rise)), rise.shape)
    if rise[i, j] < 0.0 or (resisting[:, -1] - resisting[:, 0]).min() < LEAST_RISE * np.abs(resisting).max():
        raise InputError(
            f"model {damper.description} has no inverse: at {table[1 + i, 0]:.3g} m/s its resisting force is "
            f"{resisting[i, j]:.4g} N at {currents[j]:.3g} A and {resisting[i, j + 1]:.4g} N at {currents[j + 1]:.3g} A, "
            "expected a force that rises with the coil current; take a law without force demand, or another fit"
        )
    return table


@njit(cache=True, nogil=True)
def current_for_force(table: Array, speed: float, force: float) -> float:
    """Return the coil current in A with which the damper gives a force in N at a speed in m/s, or comes next to it.

    Zero at rest and where the force has the direction of the motion: a damper cannot give that. ``table`` is from
    `inverse_map`.
    """
    rows, columns = table.shape
    if force * speed <= 0.0:
        return 0.0
    direction = 1.0 if speed > 0.0 else -1.0
    wanted = direction * force
    # Rows run from the fastest negative speed to the fastest positive one; no row is at rest.
    first, last = (1 + (rows - 1) // 2, rows - 1) if direction > 0.0 else (1, (rows - 1) // 2)
    i = first
    while i < last - 1 and table[i + 1, 0] < speed:
        i += 1
    share = min(max((speed - table[i, 0]) / (table[i + 1, 0] - table[i, 0]), 0.0), 1.0)
    below = direction * ((1.0 - share) * table[i, 1] + share * table[i + 1, 1])
    if wanted <= below:
        return 0.0
    for j in range(2, columns):
        above = direction * ((1.0 - share) * table[i, j] + share * table[i + 1, j])
        if wanted <= above:
            return float(table[0, j - 1] + (table[0, j] - table[0, j - 1]) * (wanted - below) / (above - below))
        below = above
    return float(table[0, columns - 1])
