"""Diagnose the measured dampers of a folder, whole and in halves: `python docs/tables/measured.py $MRD_DATA REPORTS`.

Prints the table of docs/diagnosis.md, and writes the reports on all runs of a damper to REPORTS.
"""

import argparse
from pathlib import Path

from mrd_diagnosis import diagnose, write_gap_report
from mrd_diagnosis.diagnosis import Diagnosis
from mrd_diagnosis.quantities import format_share
from mrd_identification.json_file import make_folder
from mrd_runs import read_runs

DAMPERS = {"utfsm": "UTFSM, press", "utfpr": "UTFPR, shaking table"}
HEADER = (
    "damper",
    "base model",
    "runs",
    "verdict, named effect",
    "region with most excess error",
    "held-out error before → after (noise), %",
    "nearest effect: share of the gap removed",
    "best other model: share of the gap removed",
)


def row(diagnosis: Diagnosis) -> list[str]:
    """Return the cells of the table that a diagnosis fills."""
    if diagnosis.gap is None:
        return [f"`{diagnosis.verdict}`", "–", "–", "–", "–"]
    places = [region for region in diagnosis.where if region.axis != "run"]
    nearest, models, gap = diagnosis.nearest, diagnosis.alternative_models, diagnosis.gap
    before, after, floor = (100 * error.value for error in (gap.before, gap.after, gap.noise_floor))
    effects = " + ".join(f"`{effect}`" for effect in nearest.effects) if nearest else ""
    return [
        ", ".join([f"`{diagnosis.verdict}`", *(f"`{cause.effect}`" for cause in diagnosis.causes)]),
        f"{format_share(places[0].share.value)} {places[0].label}" if places else "–",
        f"{before:.1f} → {after:.1f} ({floor:.1f})",
        f"{effects}: {format_share(nearest.closed_fraction)}" if nearest else "–",
        f"`{models[0].name}` {format_share(models[0].closed_fraction.value)}" if models else "–",
    ]


def main() -> None:
    """Diagnose, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recorded", type=Path)
    parser.add_argument("reports", type=Path)
    arguments = parser.parse_args()
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    for folder, damper in DAMPERS.items():
        files = sorted(str(file) for file in (arguments.recorded / folder).glob("sine_*.csv"))
        for base in ("bouc_wen", "bingham"):
            for part, some in (("all", files), ("one half", files[::2]), ("the other", files[1::2])):
                diagnosis = diagnose(read_runs(some), base)
                print(f"| {damper} | `{base}` | {part} | {' | '.join(row(diagnosis))} |", flush=True)
                if some is files:
                    write_gap_report(diagnosis, make_folder(f"{arguments.reports}/{folder}_{base}"))


if __name__ == "__main__":
    main()
