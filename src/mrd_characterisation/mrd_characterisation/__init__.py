"""Characterisation of dampers from recordings: forces over speed, energy, response times, gas force, seal drag."""

from mrd_characterisation.characterisation import QUANTITIES, Characterisation, Value
from mrd_characterisation.characterisation_file import read_characterisation, write_characterisation
from mrd_characterisation.characterise import characterise
from mrd_characterisation.units import View

__all__ = [
    "QUANTITIES",
    "Characterisation",
    "Value",
    "View",
    "characterise",
    "read_characterisation",
    "write_characterisation",
]
