"""The truth: dampers, effects and instruments of their own, that share no physics with the models that are fitted.

Signs: a rod that moves out is positive, so is a force that resists it. SI throughout.
"""

from mrd_trials.truth.bases import BASES, Base, draw
from mrd_trials.truth.effects import EFFECTS, Quantity, TrueEffect
from mrd_trials.truth.instruments import Instruments, Recorded
from mrd_trials.truth.plant import Motion, Plant, record

__all__ = [
    "BASES",
    "EFFECTS",
    "Base",
    "Instruments",
    "Motion",
    "Plant",
    "Quantity",
    "Recorded",
    "TrueEffect",
    "draw",
    "record",
]
