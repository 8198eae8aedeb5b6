"""Structure: seals, guides, stops, joints and masses around the fluid."""

import math

from numba import njit

from mrd_trials.truth.effects.declare import TrueEffect, Values, size, within

BRISTLE, GUIDE = 25e-6, 40e-6
"""m, travel over which the friction of the seal, and of the guide, turns."""

ROUND = 5e-4
"""m, within which the friction of the guide has its least."""

EVEN_DEPTH = 5e-3
"""m, where a Hertzian stop presses as much as 5e6 N/m² times the depth squared."""

REBOUND = 0.5
"""s/m, share of a stop's force by which a metre per second inwards adds to it (Hunt and Crossley)."""

EFFECTS = (
    TrueEffect(
        "series_compliance",
        "Spring in series with the damper",
        (size("compliance", 4e-7, 2e-6),),
        ("compliance",),
        in_series=True,
    ),
    TrueEffect(
        "joint_play",
        "Free travel in the damper's joint",
        (size("play", 3e-4, 2e-3), within("resistance", 15e3, 40e3, logarithmic=True)),
        ("play",),
        in_series=True,
    ),
    TrueEffect(
        "seal_friction",
        "Dry friction of the seal",
        (size("coulomb", 40.0, 120.0), within("stiction", 0.2, 1.0), within("stribeck_speed", 1e-3, 1e-2, logarithmic=True)),
    ),
    TrueEffect(
        "side_load_friction",
        "Friction that grows away from a centre",
        (size("slope", 1500.0, 3000.0), within("centre", -5e-3, 5e-3)),
        ("slope", "centre"),
    ),
    TrueEffect("end_stop", "Bump stops", (size("hardness", 1.0, 10.0), within("limit", 5e-3, 9e-3))),
    TrueEffect("moving_mass", "Mass between load cell and damper", (size("mass", 1.5, 5.0),), ("mass",)),
)


@njit(cache=True, nogil=True)
def swept(q: float, dx: float, travel: float, level: float) -> float:
    """Deflection of bristles, 1 at Coulomb's friction, that tend to ``level`` in the direction of ``dx``; exact."""
    end = level if dx > 0.0 else -level
    return end + (q - end) * math.exp(-abs(dx) / (travel * level))


@njit(cache=True, nogil=True)
def stribeck(p: Values, v: float) -> float:
    """Friction at a steady speed over Coulomb's."""
    if p.seal_friction_stiction == 0.0:
        return 1.0
    return 1.0 + p.seal_friction_stiction / (1.0 + (v / p.seal_friction_stribeck_speed) ** 2)


@njit(cache=True, nogil=True)
def guided(p: Values, x: float) -> float:
    """N, friction of the guide in either direction."""
    off = x - p.side_load_friction_centre
    return p.side_load_friction_slope * (math.sqrt(off * off + ROUND * ROUND) - ROUND)


@njit(cache=True, nogil=True)
def stopped(p: Values, x: float, v: float) -> float:
    """N, of a Hertzian contact with some loss, at either end."""
    if p.end_stop_hardness == 0.0:
        return 0.0
    depth = abs(x) - p.end_stop_limit
    if depth <= 0.0:
        return 0.0
    inwards = v if x > 0.0 else -v
    force = p.end_stop_hardness * 5e6 * math.sqrt(EVEN_DEPTH) * depth * math.sqrt(depth) * max(1.0 + REBOUND * inwards, 0.0)
    return force if x > 0.0 else -force


@njit(cache=True, nogil=True)
def loose(g: float, play: float, force: float, resistance: float, drag: float, step: float) -> float:
    """Offset of a joint with play after a step: a film is squeezed out ever slower, and a drag must be overcome first."""
    if play == 0.0:
        return 0.0
    half = 0.5 * play
    pull = max(abs(force) - drag, 0.0)
    if force < 0.0:
        pull = -pull
    film = 1.0 - g / half if force > 0.0 else 1.0 + g / half
    return min(max(g + step * pull / resistance * max(film, 0.02), -half), half)
