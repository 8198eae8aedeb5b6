"""Play between two flanks: the formulas that the drive's backlash and the damper's joints share."""

import math

from numba import njit

FILM, ELASTIC, REYNOLDS, SIGMOID = range(4)

LEAST_FILM = 0.02
"""Speed of the crossing at the flank over that at the middle of the play, by a film that becomes thinner."""

FLANK_FORCE = 3000.0
"""Force in N at which worn, elastic flanks give way by another half of the play."""


@njit(cache=True, nogil=True)
def offset_in_play(
    formula: float,
    offset: float,
    play: float,
    force: float,
    resistance: float,
    drag: float,
    turning_force: float,
    step: float,
) -> float:
    """Return the offset (m) from the middle of a play after a step; a force beyond the drag crosses it."""
    if play == 0.0:
        return 0.0
    half = 0.5 * play
    if formula == SIGMOID:
        return half * math.tanh(force / turning_force)
    pull = max(abs(force) - drag, 0.0)
    side = 1.0 if force > 0.0 else -1.0
    gap = max(1.0 - side * offset / half, 0.0)  # what the film has left, 0 to 2 half plays
    if formula == REYNOLDS:
        return side * half * (1.0 - gap / math.sqrt(1.0 + 2.0 * gap * gap * pull * step / (resistance * half)))
    if formula == ELASTIC:
        flank = half * (1.0 + abs(force) / FLANK_FORCE)
        return min(max(offset + side * step * pull / resistance, -flank), flank)
    return min(max(offset + side * step * pull / resistance * max(gap, LEAST_FILM), -half), half)
