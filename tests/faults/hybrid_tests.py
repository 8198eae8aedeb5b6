"""These faults break a hybrid test, in mode control: its loop, or what every run needs."""

import dataclasses
import signal
from typing import Any

from std_srvs.srv import Trigger

from faults import motor, people, processes
from faults.campaign import LIVELY, Ending, Fault
from faults.plant_faults import in_plant


def _fault(name: str, *arguments: Any, **fields: Any) -> Fault:
    return Fault(f"hybrid test: {name}", *arguments, hybrid=True, **fields)


FAULTS = (
    _fault("emergency stop", people.press(people.ORDINARY, 1), "emergency stop"),
    _fault("stop", people.call("stop"), "cancelled", Ending.ENDED, told=""),
    _fault("abort_control", people.call("abort_control", Trigger), "the controller aborted", Ending.ENDED, told=""),
    _fault("serial line pulled", in_plant("unplug"), "the motor does not answer", told="the motor|is gone"),
    _fault(
        "converter hangs", in_plant("freeze_daq"), "stale force: no sample for", Ending.ENDED, told="stale", recorded=False
    ),
    _fault("blocks of samples are lost", in_plant("drop_blocks"), "samples were lost; check the daq", Ending.ENDED),
    # The whole sample blocks of 4 ms lie between two reports of the encoder.
    _fault("pinion slips", in_plant("slip"), motor.SENSORS),
    # The balance of energy sums up half a second, and the damper has to give 2 J in it.
    _fault(
        "wires of the load cell exchanged", in_plant("reverse_force"), "the damper seems to have given", rest=1.0, coil=1.0
    ),
    # The loop becomes unstable: it grows until it shows.
    _fault(
        "motor slower than declared",
        in_plant("slow_motor"),
        r"the damper seems to have given|following error|position error too large \(Be\)",
        rest=1.0,
        coil=1.0,
        experiment=LIVELY,
    ),
    *(
        dataclasses.replace(fault, name=f"hybrid test: {fault.name}", hybrid=True)
        for fault in processes.faults_of("controller", ".*(controller|setpoint)", *processes.SIGNALS)
    ),
    *(
        dataclasses.replace(fault, name=f"hybrid test: {fault.name}", hybrid=True)
        for name in ("servo", "daq", "recorder", "supervisor")
        for fault in processes.faults_of(name, f"{processes.CAUSES[name]}|.*stale force", signal.SIGKILL)
    ),
)
