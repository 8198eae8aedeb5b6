"""Diagnose the measured dampers of a folder around three models, whole and in halves.

`python docs/tables/measured.py $MRD_DATA REPORTS`

Prints the table of docs/diagnosis_measured.md, and writes the reports on all runs of a damper to REPORTS.
"""

import argparse
from pathlib import Path

from mrd_base.json_file import make_folder
from mrd_diagnosis import diagnose, write_gap_report
from mrd_diagnosis.diagnosis import Cause, Diagnosis
from mrd_diagnosis.wording.quantities import format_share
from mrd_runs import read_runs

DAMPERS = {"utfpr": "UTFPR, shaking table", "utfsm": "UTFSM, press", "brfd": "BRFD, band brake"}
MODELS = ("bouc_wen", "modified_bouc_wen", "shear_thinning_bouc_wen")
HEADER = (
    "damper",
    "base model",
    "runs",
    "verdict, causes with their share of the gap",
    "another share in the form of the model",
    "held-out error before → after (noise), %",
    "region with most of the error that remains",
)


def row(diagnosis: Diagnosis) -> list[str]:
    """Return the cells of the table that a diagnosis fills."""
    if diagnosis.gap is None:
        return [f"`{diagnosis.verdict}`", "–", "–", "–"]
    places = [region for region in diagnosis.where if region.axis != "run"]
    gap = diagnosis.gap
    before, after, floor = (100 * error.value for error in (gap.before, gap.after, gap.noise_floor))
    causes = [f"{_named(cause)} {format_share(cause.closed_fraction.value)}" for cause in diagnosis.causes]
    return [
        ", ".join([f"`{diagnosis.verdict}`", *causes]),
        format_share(gap.form_fraction),
        f"{before:.1f} → {after:.1f} ({floor:.1f})",
        f"{format_share(places[0].share.value)} {places[0].label}" if places else "–",
    ]


def _named(cause: Cause) -> str:
    """Return a cause with those that look like it, where it is not named by itself."""
    effects = [cause.effect] if cause.level == "effect" else [member.effect for member in cause.members]
    return " or ".join(f"`{effect}`" for effect in effects)


def main() -> None:
    """Diagnose, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recorded", type=Path)
    parser.add_argument("reports", type=Path)
    arguments = parser.parse_args()
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    for folder, damper in DAMPERS.items():
        files = sorted(str(file) for file in (arguments.recorded / folder).glob("sine_*.csv"))
        for base in MODELS:
            for part, some in (("all", files), ("one half", files[::2]), ("the other", files[1::2])):
                diagnosis = diagnose(read_runs(some), base)
                print(f"| {damper} | `{base}` | {part} | {' | '.join(row(diagnosis))} |", flush=True)
                if some is files:
                    write_gap_report(diagnosis, make_folder(f"{arguments.reports}/{folder}_{base}"))


if __name__ == "__main__":
    main()
