"""Effects of the structure: seals, guides, stops, joints and masses around the fluid."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, shape, size

SEAL_TRAVEL, GUIDE_TRAVEL = 25e-6, 40e-6
"""Travel in m over which the friction of the seal, and that of the guide, changes its direction."""

GUIDE_ROUNDING = 5e-4
"""Distance in m from its centre within which the friction of the guide is rounded off."""

STOP_DEPTH = 5e-3
"""Depth in m at which the force of a Hertzian stop is 5e6 N/m² times the depth squared."""

REBOUND = 0.5
"""Relative increase of a stop's force per inward speed in s/m (Hunt and Crossley)."""

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
        (size("play", 3e-4, 2e-3), shape("resistance", 15e3, 40e3, logarithmic=True)),
        ("play",),
        in_series=True,
    ),
    TrueEffect(
        "seal_friction",
        "Dry friction of the seal",
        (size("coulomb", 40.0, 120.0), shape("stiction", 0.2, 1.0), shape("stribeck_speed", 1e-3, 1e-2, logarithmic=True)),
    ),
    TrueEffect(
        "side_load_friction",
        "Friction that grows away from a centre",
        (size("slope", 1500.0, 3000.0), shape("centre", -5e-3, 5e-3)),
        ("slope", "centre"),
    ),
    TrueEffect("end_stop", "Bump stops", (size("hardness", 1.0, 10.0), shape("limit", 5e-3, 9e-3))),
    TrueEffect("moving_mass", "Mass between load cell and damper", (size("mass", 1.5, 5.0),), ("mass",)),
)


@njit(cache=True, nogil=True)
def bristle_deflection(deflection: float, dx: float, travel: float, level: float) -> float:
    """Return the deflection of bristles (1 at Coulomb friction), which tends to ``level`` in the direction of ``dx``."""
    end = level if dx > 0.0 else -level
    return end + (deflection - end) * math.exp(-abs(dx) / (travel * level))


@njit(cache=True, nogil=True)
def stribeck_factor(p: PlantValues, v: float) -> float:
    """Return the friction at a steady speed over the Coulomb friction."""
    if p.seal_friction_stiction == 0.0:
        return 1.0
    return 1.0 + p.seal_friction_stiction / (1.0 + (v / p.seal_friction_stribeck_speed) ** 2)


@njit(cache=True, nogil=True)
def guide_friction(p: PlantValues, x: float) -> float:
    """Return the magnitude of the guide's friction in N."""
    distance = x - p.side_load_friction_centre
    return p.side_load_friction_slope * (math.sqrt(distance * distance + GUIDE_ROUNDING * GUIDE_ROUNDING) - GUIDE_ROUNDING)


@njit(cache=True, nogil=True)
def stop_force(p: PlantValues, x: float, v: float) -> float:
    """Return the force (N) of the end stops, Hertzian contacts with some loss."""
    if p.end_stop_hardness == 0.0:
        return 0.0
    depth = abs(x) - p.end_stop_limit
    if depth <= 0.0:
        return 0.0
    inwards = v if x > 0.0 else -v
    force = p.end_stop_hardness * 5e6 * math.sqrt(STOP_DEPTH) * depth * math.sqrt(depth) * max(1.0 + REBOUND * inwards, 0.0)
    return force if x > 0.0 else -force


@njit(cache=True, nogil=True)
def joint_offset(offset: float, play: float, force: float, resistance: float, drag: float, step: float) -> float:
    """Return the offset of a joint with play after a step.

    A force beyond the drag squeezes out a film, which becomes slower towards the end of the play.
    """
    if play == 0.0:
        return 0.0
    half = 0.5 * play
    pull = max(abs(force) - drag, 0.0)
    if force < 0.0:
        pull = -pull
    film = 1.0 - offset / half if force > 0.0 else 1.0 + offset / half
    return min(max(offset + step * pull / resistance * max(film, 0.02), -half), half)
