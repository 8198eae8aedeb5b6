"""The ground truth: dampers, effects and instruments that share no physics with the models that are fitted.

Signs: the position of a rod that moves out is positive, and so is a force that resists this. All units are SI.
"""

from mrd_trials.truth.alteration import ALTERATIONS, AlteredRun, MeasuredRun, alter
from mrd_trials.truth.damper_forms import DAMPER_FORMS, DamperForm, draw_parameters
from mrd_trials.truth.effects import EFFECTS, EffectParameter, Family, Formula, TrueEffect
from mrd_trials.truth.instruments import Readings, TrueInstruments
from mrd_trials.truth.recording import BenchCommand, RunDeviation, TruePlant, draw_scatter, record

__all__ = [
    "ALTERATIONS",
    "DAMPER_FORMS",
    "EFFECTS",
    "AlteredRun",
    "BenchCommand",
    "DamperForm",
    "EffectParameter",
    "Family",
    "Formula",
    "MeasuredRun",
    "Readings",
    "RunDeviation",
    "TrueEffect",
    "TrueInstruments",
    "TruePlant",
    "alter",
    "draw_parameters",
    "draw_scatter",
    "record",
]
