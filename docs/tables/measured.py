"""Diagnose the measured dampers of a folder, whole and in halves: `python docs/tables/measured.py $MRD_DATA REPORTS`.

Prints the table of docs/diagnosis.md, and writes the reports on all runs of a damper to REPORTS.
"""

import argparse
from pathlib import Path

from mrd_diagnosis import diagnose, write_gap_report
from mrd_diagnosis.diagnosis import Diagnosis
from mrd_diagnosis.report.sentences import share
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
    "best other form: closes",
)


def row(found: Diagnosis) -> list[str]:
    """What the table says of a diagnosis."""
    places = [region for region in found.where if region.axis != "run"]
    near, form = found.nearest, found.forms[0] if found.forms else None
    before, after, floor = (100 * error.value for error in (found.before, found.after, found.floor))
    return [
        ", ".join([f"`{found.verdict}`", *(f"`{cause.effect}`" for cause in found.causes)]),
        f"{share(places[0].share.value)} {places[0].label}" if places else "–",
        f"{before:.1f} → {after:.1f} ({floor:.1f})",
        f"{' + '.join(f'`{effect}`' for effect in near.effects)}: {share(near.closed)}" if near else "–",
        f"`{form.effects[0]}` {share(form.closed.value)}" if form else "–",
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
                found = diagnose(read_runs(some), base)
                print(f"| {damper} | `{base}` | {part} | {' | '.join(row(found))} |", flush=True)
                if some is files:
                    write_gap_report(found, make_folder(f"{arguments.reports}/{folder}_{base}"))


if __name__ == "__main__":
    main()
