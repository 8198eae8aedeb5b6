"""Faults of the damper itself."""

from faults.campaign import Fault
from faults.plant_faults import in_plant

# The thermometer needs a tenth of a second to show it.
FAULTS = (
    Fault("damper: overheated", in_plant("hot_damper"), "interlock temperature: the damper has .* degC", rest=0.4, coil=0.4),
)
