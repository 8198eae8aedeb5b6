"""Faults of motor, gearbox, rack and encoder."""

from faults.campaign import Fault
from faults.plant_faults import in_plant

SENSORS = "LVDT and encoder disagree"

FAULTS = (
    Fault("motor: rod jammed, position error", in_plant("jam"), r"position error too large \(Be\)|following error"),
    Fault("motor: over-temperature", in_plant("overheat"), r"over-temperature \(Bh\)"),
    Fault("motor: supply sags, bus fault", in_plant("low_voltage"), "bus voltage out of range"),
    Fault("motor: travel-limit switch", in_plant("touch_limit"), "positive hardware limit"),
    Fault("encoder stuck", in_plant("stuck_encoder"), f"{SENSORS}|position error too large"),
    Fault("pinion slips", in_plant("slip"), SENSORS),
)
