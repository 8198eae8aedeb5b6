"""Faults of the coil and its cable."""

from faults.campaign import Fault
from faults.plant_faults import in_plant

FAULTS = (
    Fault("coil: open", in_plant("open_coil"), "the coil current is"),
    Fault("coil: shorted", in_plant("short_coil"), "the coil current is"),
)
