"""Lead-in: a motion before the first sample that brings a damper into a state in which a recording may begin.

What happened before a recording is unknown. A model that is integrated along a lead-in first has been through a history by
its own dynamics, whatever states it has: hysteresis, elements in series, filters. The histories are of one kind. The rod
slides in one direction until everything is saturated, reverses, and reaches the first sample after a travel, the reach.
Only the reach and the direction matter for what is forgotten within a stroke.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_runs.signals.motion import Motion

Array = NDArray[np.float64]

VERTICES = 12
"""Vertices of each of the pieces of a lead-in."""

REST = 1.0
"""s at rest before the first sample. Filters of sensors and elements that relax are slower in no damper of the catalogue by
much; this is a time of electronics and fluids and does not grow with the damper."""

SURELY_MOVES, MAY_MOVE = 0.1, 1e-3
"""Shares of a run's largest speed at the first sample: above the first the rod surely moves, below the second it rests."""

APPROACH = 0.25
"""Share of the stroke over which the rod slides before it reverses for the last time."""


@dataclass(frozen=True)
class LeadIn:
    """Motion on the vertices before the first sample of a path.

    Attributes
    ----------
    before : ndarray (m,)
        s until the first sample, falling, positive.
    position : ndarray (m,)
        m from the position of the first sample.
    velocity, acceleration : ndarray (m,)
        m/s, m/s².
    current : float
        A at the first vertex beyond that of the first sample, which flows from the second vertex on. It magnetises.
    """

    before: Array
    position: Array
    velocity: Array
    acceleration: Array
    current: float = 0.0


def usual_lead_in(motion: Motion) -> LeadIn | None:
    """Return the lead-in of a run whose start is not known yet: the rod has long moved as it does, or rests unloaded."""
    speed = float(motion.velocity[0])
    if abs(speed) <= SURELY_MOVES * float(np.abs(motion.velocity).max()):
        return None
    approach = APPROACH * float(np.ptp(motion.position))
    return moving_lead_in(speed, approach, approach)


def still_lead_in() -> LeadIn:
    """Return a lead-in without motion: the damper begins at rest and unloaded."""
    still = np.zeros(2)
    return LeadIn(np.array([2.0 * REST, REST]), still, still, still)


def moving_lead_in(velocity: float, reach: float, approach: float) -> LeadIn:
    """Return a lead-in to a first sample at which the rod moves.

    The rod approaches at the same speed in the opposite direction, stops and returns at a constant acceleration.

    Parameters
    ----------
    velocity : float
        m/s of the first sample, not zero.
    reach : float
        m from the reversal to the first sample, positive.
    approach : float
        m travelled before the rod slows down.
    """
    speed, half = abs(velocity), 2.0 * reach / abs(velocity)
    coming = np.linspace(approach / speed, 0.0, VERTICES, endpoint=False)
    turning = np.linspace(-half, half, 2 * VERTICES + 1)[:-1]  # around the reversal
    acceleration = speed / half
    position = np.concatenate([speed * coming, 0.5 * acceleration * turning**2 - reach])
    direction = np.sign(velocity)
    return LeadIn(
        np.concatenate([coming + 2.0 * half, half - turning]),
        direction * position,
        direction * np.concatenate([np.full(VERTICES, -speed), acceleration * turning]),
        direction * np.concatenate([np.zeros(VERTICES), np.full(2 * VERTICES, acceleration)]),
    )


def resting_lead_in(reach: float, approach: float, speed: float) -> LeadIn:
    """Return a lead-in to a first sample at which the rod rests.

    Parameters
    ----------
    reach : float
        m from the last reversal to the first sample; its sign is the direction of this last move.
    approach : float
        m of the move before, in the other direction.
    speed : float
        m/s, the largest of that move. A shorter move has the same acceleration.
    """
    direction = 1.0 if reach >= 0.0 else -1.0
    rest = REST * (1.0 - np.append(0.0, 2.0 ** -np.arange(9.0, 0.0, -1.0)))
    last = _move(direction * abs(reach), approach, speed, 0.0, REST)
    first = _move(-direction * approach, approach, speed, -direction * abs(reach), last[0][0] if reach else REST)
    still = np.zeros_like(rest)
    pieces = [first, *([last] if reach else []), (rest, still, still, still)]
    before, position, velocity, acceleration = (np.concatenate(series) for series in zip(*pieces, strict=True))
    return LeadIn(before, position, velocity, acceleration)


def _move(travel: float, approach: float, speed: float, end: float, before: float) -> tuple[Array, Array, Array, Array]:
    """Return a move along half a cosine: time before the first sample, position, velocity and acceleration.

    It ends at ``end`` in m, ``before`` s before the first sample, which is no vertex of it.
    """
    rate = 2.0 * speed / np.sqrt(abs(travel) * approach)  # rad/s
    angle = np.linspace(0.0, np.pi, VERTICES, endpoint=False)
    return (
        before + (np.pi - angle) / rate,
        end - 0.5 * travel * (1.0 + np.cos(angle)),
        0.5 * travel * rate * np.sin(angle),
        0.5 * travel * rate**2 * np.cos(angle),
    )
