"""Faults of the serial line to the motor."""

from faults.campaign import Fault
from faults.plant_faults import in_plant
from mrd_sim.motor import LINE_FAULTS

# From within, a line that is disturbed looks like one on which nothing comes.
_SILENT = r"no valid position from the motor for|the latest state is \d+ ms old|the motor does not answer"

FAULTS = (
    *(Fault(f"serial line: {what}", in_plant(name), _SILENT) for name, what in LINE_FAULTS.items()),
    Fault("serial line: pulled", in_plant("unplug"), "the motor does not answer", told="the motor|is gone"),
    Fault("motor: reset to 9600 baud", in_plant("reset"), _SILENT, told="the motor was reset"),
)
