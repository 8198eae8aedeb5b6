"""Faults of the serial line to the motor."""

from faults.campaign import Fault
from faults.plant_faults import in_plant
from mrd_sim.motor import LINE_FAULTS

# From within, a line that is disturbed looks like one on which nothing comes. The servo names it before its state is too
# old for the supervisor, which would blame the node.
_SILENT = "no valid position from the motor for|the motor does not answer"

FAULTS = (
    *(Fault(f"serial line: {what}", in_plant(name), _SILENT) for name, what in LINE_FAULTS.items()),
    Fault("serial line: pulled", in_plant("unplug"), "the motor does not answer", told="the motor|is gone"),
    Fault("motor: reset to 9600 baud", in_plant("reset"), _SILENT, told="the motor was reset"),
)
