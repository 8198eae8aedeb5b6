"""All effects that a plant may have, in the order of their places; those that the catalogue lacks are last."""

from mrd_trials.truth.effects import absent, coil, drive, fluid, sensing, structure
from mrd_trials.truth.effects.true_effect import EffectParameter, TrueEffect

EFFECTS: dict[str, TrueEffect] = {
    effect.id: effect for place in (drive, coil, fluid, structure, sensing, absent) for effect in place.EFFECTS
}
"""Effects by id."""

__all__ = ["EFFECTS", "EffectParameter", "TrueEffect"]
