"""Play, crossed against a film of grease: g' = (F / c) (1 - m g sgn F / (g_0 / 2)), stepped exactly for a constant force."""

from typing import Any

from numba import njit

from mrd_sim.dual import absolute, clip, exp

_LEAST = 1e-18  # m, so that no play is no exception

MOST_FILM = 0.98
"""By how much the film may slow the crossing: with all of it the far flank would never be reached."""


@njit(cache=True, nogil=True)
def crossed(before: Any, step: float, pull: Any, play: Any, resistance: Any, film: Any) -> Any:
    """Offset from the middle of a play in m after a step in s, from ``before``.

    ``pull`` is the force in N that crosses it, ``resistance`` that of the film at the middle in N s/m, ``film`` by how much
    slower it is squeezed out at the flank.
    """
    half = 0.5 * play + _LEAST
    flank = half if pull.real > 0.0 else -half
    # Share of its speed at the middle at which the play is crossed in the end.
    speed = (1.0 - film * before / flank) * exp(-film * step * absolute(pull) / (resistance * half))
    return clip(flank * (1.0 - speed) / film, -half, half)
