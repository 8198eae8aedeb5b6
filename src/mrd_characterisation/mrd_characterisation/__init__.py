"""Characterisation of dampers from recordings: forces over speed, energy, response times, gas force, seal drag."""

from mrd_characterisation.characterisation import QUANTITIES, Characterisation, Value
from mrd_characterisation.characterise import characterise

__all__ = ["QUANTITIES", "Characterisation", "Value", "characterise"]
