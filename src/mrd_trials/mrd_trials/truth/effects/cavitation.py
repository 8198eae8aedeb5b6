"""A void behind the piston in compression."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, size

ONSET, ORIFICE, NUCLEATION = range(3)

OPENING, CLOSING = 3000.0, 300.0
"""Viscous resistance in N s/m against the opening of a void beyond the cap, and against its closing."""

ONSET_SHARE = 0.1
"""Share of the cap over which a void begins to open."""

TENSION = 0.1
"""Share of the cap that the fluid bears in addition until a void has formed."""

CAP = size("inverse_cap", 0.0015, 0.005)

EFFECT = TrueEffect(
    "cavitation",
    "Void behind the piston in compression",
    (
        development("onset", "opens gradually within a tenth of the cap", CAP),
        development("orifice", "fills through an orifice: the root of the excess (Bernoulli; Segel & Lang 1981)", CAP),
        evaluation("nucleation", "bears tension until a void has formed (Brennen 1995)", CAP),
    ),
    in_series=True,
)


@njit(cache=True, nogil=True)
def void_after_step(p: PlantValues, void: float, force: float, step: float) -> float:
    """Return the void (m, at most 0) after a step: the gas carries compression up to its cap, and more opens the void."""
    if p.cavitation_inverse_cap == 0.0:
        return 0.0
    cap = 1.0 / p.cavitation_inverse_cap
    if p.cavitation_formula == NUCLEATION and void == 0.0:
        cap *= 1.0 + TENSION
    excess = max(-force - cap, 0.0)  # exactly 0 below the cap: a leak would add up
    if p.cavitation_formula == ORIFICE:
        void -= step / OPENING * cap * (math.sqrt(1.0 + 8.0 * excess / cap) - 1.0)
    elif p.cavitation_formula == NUCLEATION:
        void -= step / OPENING * 2.0 * excess
    else:
        over = excess / (ONSET_SHARE * cap)
        void -= step / OPENING * ONSET_SHARE * cap * over * over / (1.0 + over)
    return min(void + step / CLOSING * max(force, 0.0), 0.0)
