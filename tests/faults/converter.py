"""Faults of the DAQ's converter and of the wiring of the sensors."""

from faults.campaign import Ending, Fault
from faults.plant_faults import in_plant

_SENSORS = "LVDT and encoder disagree"

FAULTS = (
    Fault("converter: hangs", in_plant("freeze_daq"), "stale samples", recorded=False),
    Fault("converter: gone", in_plant("lose_daq"), "the converter is gone", recorded=False),
    Fault(
        "converter: blocks are lost",
        in_plant("drop_blocks"),
        "missing",
        Ending.COMPLAINS,
        told=r"\d readings of the converter were lost",
    ),
    Fault("LVDT: saturated", in_plant("saturate_position"), r"ai0 \(position\) reads the end of its range"),
    Fault("load cell: saturated", in_plant("saturate_force"), r"ai1 \(force\) reads the end of its range"),
    Fault("current sensor: saturated", in_plant("saturate_current"), r"ai2 \(coil_current\) reads the end of its range"),
    Fault("LVDT: unplugged", in_plant("disconnect_position"), _SENSORS),
    Fault("current sensor: unplugged", in_plant("disconnect_current"), "the coil current is"),
    Fault("load cell: unplugged", in_plant("disconnect_force"), "", Ending.COMPLETE),
    Fault("thermometer: unplugged", in_plant("disconnect_temperature"), "interlock temperature: .* reads -2[45].* degC"),
    Fault("thermometer: broken", in_plant("saturate_temperature"), "interlock temperature: .* the end of its range"),
    Fault("LVDT and load cell exchanged", in_plant("swap_channels"), _SENSORS),
)
