"""Faults of the coil and its cable."""

from faults.campaign import Fault
from faults.plant_faults import in_plant

FAULTS = (
    Fault("coil: open", in_plant("open_coil"), "the coil current is"),
    Fault("coil: shorted", in_plant("short_coil"), "the coil current is"),
    # Without a run, what the supply lets through is named; to end it is for the fuse, or the supply's enable.
    Fault(
        "coil: current without a run",
        in_plant("leak_coil"),
        r"the coil current is 0\.(29|3\d) A, commanded 0\.00 A",
        coil=None,
        recorded=False,
        idle=True,
    ),
)
