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
    "base",
    "runs",
    "verdict, named",
    "most of the excess",
    "unseen error, before → after (noise), %",
    "nearest: closes",
    "best other model: closes",
)


def row(diagnosis: Diagnosis) -> list[str]:
    """Return the cells of the table for a diagnosis."""
    assert diagnosis.gap is not None
    places = [region for region in diagnosis.where if region.axis != "run"]
    near, model = diagnosis.nearest, diagnosis.alternative_models[0] if diagnosis.alternative_models else None
    errors = (diagnosis.gap.before, diagnosis.gap.after, diagnosis.gap.noise_floor)
    before, after, floor = (100 * error.value for error in errors)
    return [
        ", ".join([f"`{diagnosis.verdict}`", *(f"`{cause.effect}`" for cause in diagnosis.causes)]),
        f"{format_share(places[0].share.value)} {places[0].label}" if places else "–",
        f"{before:.1f} → {after:.1f} ({floor:.1f})",
        f"{' + '.join(f'`{effect}`' for effect in near.effects)}: {format_share(near.closed_fraction)}" if near else "–",
        f"`{model.name}` {format_share(model.closed_fraction.value)}" if model else "–",
    ]


def main() -> None:
    """Diagnose every group of runs and print the table."""
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
