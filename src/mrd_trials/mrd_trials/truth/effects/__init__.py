"""All effects that a plant may have, by place; those that the catalogue lacks last."""

from mrd_trials.truth.effects import absent, coil, drive, fluid, sensing, structure
from mrd_trials.truth.effects.declare import Quantity, TrueEffect

EFFECTS: dict[str, TrueEffect] = {
    effect.id: effect for place in (drive, coil, fluid, structure, sensing, absent) for effect in place.EFFECTS
}
"""By id."""

__all__ = ["EFFECTS", "Quantity", "TrueEffect"]
