"""Bump stops."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

HERTZ, RUBBER, BUFFER = range(3)

DEPTH, FORCE = 5e-3, 125.0
"""Depth in m at which a stop of hardness 1 presses with this force in N."""

REBOUND = 0.5
"""Relative increase of a Hertzian stop's force per inward speed in s/m (Hunt and Crossley)."""

SOFTENING = 8e-3
"""Depth in m over which the force of rubber grows e-fold."""

SEATING = 0.5e-3
"""Depth in m over which a buffer seats."""

HARDNESS, LIMIT = size("hardness", 1.0, 10.0), shape("limit", 5e-3, 9e-3)

EFFECT = TrueEffect(
    "end_stop",
    "Bump stops",
    (
        development("hertz", "contact of exponent 1.5 with some loss (Hertz 1882; Hunt & Crossley 1975)", HARDNESS, LIMIT),
        development("rubber", "force of a rubber stop grows exponentially with its depth (Fung 1967)", HARDNESS, LIMIT),
        evaluation("buffer", "linear buffer that has to seat (Hooke 1678)", HARDNESS, LIMIT),
    ),
)


@njit(cache=True, nogil=True)
def stop_force(p: PlantValues, x: float, v: float) -> float:
    """Return the force (N) of the end stops."""
    if p.end_stop_hardness == 0.0:
        return 0.0
    depth = abs(x) - p.end_stop_limit
    if depth <= 0.0:
        return 0.0
    inwards = v if x > 0.0 else -v
    if p.end_stop_formula == RUBBER:
        share = math.expm1(depth / SOFTENING) / math.expm1(DEPTH / SOFTENING)
    elif p.end_stop_formula == BUFFER:
        share = depth * depth / (depth + SEATING) / DEPTH
    else:
        share = math.pow(depth / DEPTH, 1.5) * max(1.0 + REBOUND * inwards, 0.0)
    force = p.end_stop_hardness * FORCE * share
    return force if x > 0.0 else -force
