"""Put a diagnosis into the simulator, as the tool ``apply`` does."""

import math
from pathlib import Path

from mrd_base import InputError
from mrd_diagnosis.correction import correction, write_plant
from mrd_diagnosis.report.gap_file import read_gap_report


def apply_report(report: Path, plant: str) -> str:
    """Write the plant file with the damper that a diagnosis found beside its report; return one line.

    Parameters
    ----------
    report : Path
        gap_report.json.
    plant : str
        Plant file of the simulated bench, of which only the damper changes; "" on a real bench.

    Raises
    ------
    InputError
        Without a plant file, or where the diagnosis proves no effect.
    """
    if not plant:
        raise InputError("this bench has no simulator; start the page with the parameter plant, a plant.yaml")
    content = read_gap_report(report)
    refitted = content["corrected"] or {"parameters": {}, "effects": []}
    closed = content["gap"]["closed_fraction"]["value"] if content["gap"] else None
    corrected = correction(
        content["verdict"],
        content["model"],
        content["laws"],
        refitted["parameters"],
        refitted["effects"],
        closed_fraction=math.nan if closed is None else closed,
        where=str(report),
        remedy="",  # what it advises can be done on the page
    )
    output = write_plant(corrected, plant, report.with_name("plant.yaml"))
    return f"{output}: {corrected.remark} Start the simulated bench with --plant {output}"
