"""Play, crossed against a film of grease: g' = (F / c) (1 - m g sgn F / (g_0 / 2)), stepped exactly for a constant force."""

from typing import Any

from numba import njit

from mrd_sim.dual import absolute, clip, exp

_LEAST_HALF = 1e-18
"""m. Added to half the play, so that no play needs no case of its own."""

MOST_FILM = 0.98
"""Largest share by which the film may slow the crossing. With 1 the far flank would never be reached."""


@njit(cache=True, nogil=True)
def offset_in_play(before: Any, step: float, pull: Any, play: Any, resistance: Any, film: Any) -> Any:
    """Return the offset from the middle of a play in m after a step in s, from the offset ``before``.

    ``pull`` is the force in N that crosses the play, ``resistance`` that of the film at the middle in N s/m, ``film`` the
    share by which the crossing is slower at the flank, where the film is squeezed out.
    """
    half = 0.5 * play + _LEAST_HALF
    flank = half if pull.real > 0.0 else -half
    # Speed at the end of the step, over that at the middle.
    speed = (1.0 - film * before / flank) * exp(-film * step * absolute(pull) / (resistance * half))
    return clip(flank * (1.0 - speed) / film, -half, half)
