"""Put a diagnosis into the simulator, as the tool ``apply`` does."""

from pathlib import Path

from mrd_base import InputError
from mrd_diagnosis.closure.plant_file import write_plant
from mrd_diagnosis.report.gap_file import read_gap_report
from mrd_identification.correction import correction_of_report


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
    # What the remedy would be can be done on the page.
    corrected = correction_of_report(read_gap_report(report), str(report), remedy="")
    output = write_plant(corrected, plant, report.with_name("plant.yaml"))
    return f"{output}: {corrected.remark} Start the simulated bench with --plant {output}"
