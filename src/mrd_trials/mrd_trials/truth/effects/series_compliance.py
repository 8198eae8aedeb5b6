"""Spring in series with the damper."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

RUBBER, CUBIC, KELVIN = range(3)

COMPLIANCE, HARDENING = size("compliance", 4e-7, 2e-6), shape("hardening_force", 500.0, 2000.0)

EFFECT = TrueEffect(
    "series_compliance",
    "Spring in series with the damper",
    (
        development("rubber", "force grows exponentially with the elongation (Fung 1967)", COMPLIANCE, HARDENING),
        development("cubic", "linear and cubic spring (Duffing 1918)", COMPLIANCE, HARDENING),
        evaluation(
            "kelvin",
            "spring that creeps beside a dashpot (Kelvin 1865, Voigt 1892)",
            COMPLIANCE,
            shape("creep_time", 1e-3, 4e-3),
            shared=("compliance",),
        ),
    ),
    in_series=True,
)

AT_REST = 1e9
"""Step in s after which nothing creeps any more."""


@njit(cache=True, nogil=True)
def series_elongation(p: PlantValues, before: float, force: float, step: float) -> float:
    """Return the elongation (m) of the spring under a force, a step after an elongation ``before``."""
    compliance = p.series_compliance_compliance
    if compliance == 0.0:
        return 0.0
    if p.series_compliance_formula == KELVIN:
        part = step / p.series_compliance_creep_time
        return (before + part * compliance * force) / (1.0 + part)
    hardening = p.series_compliance_hardening_force
    if p.series_compliance_formula == CUBIC:  # y + y³ = force / hardening, y the elongation over compliance * hardening
        y = 2.0 / math.sqrt(3.0) * math.sinh(math.asinh(1.5 * math.sqrt(3.0) * force / hardening) / 3.0)
        return compliance * hardening * y
    return compliance * hardening * math.asinh(force / hardening)
