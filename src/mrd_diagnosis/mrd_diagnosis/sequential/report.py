"""Report of a sequential diagnosis: what each round recorded and added, and why it ended."""

import json
from pathlib import Path
from typing import Any

from mrd_base.version import VERSION
from mrd_diagnosis.report.sentences import next_command, next_step
from mrd_diagnosis.sequential.recorded import folder_of_round
from mrd_diagnosis.sequential.sequential import Round, SequentialDiagnosis
from mrd_diagnosis.wording.effect_names import effect_name
from mrd_diagnosis.wording.quantities import format_probability
from mrd_identification.report import render

ENDINGS = {
    "data_fault": "the recordings have a fault",
    "no_gap": "there is no gap",
    "cause_known": "the cause is known",
    "nothing_separates": "no recording separates what is open",
    "not_in_catalogue": "no effect of the catalogue explains the gap",
    "budget": "the budget is used up",
}
"""Why a sequential diagnosis ended, as a clause."""


def write_sequential_report(outcome: SequentialDiagnosis, folder: Path) -> Path:
    """Write diagnosis.json and diagnosis.html, which leads to the gap report of each round; return the path of the page."""
    text = json.dumps(to_json(outcome), indent=1, ensure_ascii=False) + "\n"
    (folder / "diagnosis.json").write_text(text, encoding="utf-8")
    diagnosis = outcome.diagnosis
    return render(
        "diagnosis",
        folder,
        "mrd_diagnosis",
        runs=diagnosis.runs,
        title="Diagnosis on the bench",
        headline=[
            ("rounds" if len(outcome.rounds) > 1 else "round", str(len(outcome.rounds))),
            ("recordings", str(sum(len(of_round.runs) for of_round in outcome.rounds))),
            ("bench time", f"{outcome.duration:.0f} s"),
        ],
        sentence=diagnosis.sentence,
        next_step=next_step(diagnosis),
        next_command=command_after(outcome, folder),
        ending=ending_clause(outcome),
        why=outcome.why,
        rounds=[_row(of_round) for of_round in outcome.rounds],
    )


def ending_clause(outcome: SequentialDiagnosis) -> str:
    """Return why a sequential diagnosis ended, as a clause."""
    if outcome.ending == "cause_known" and outcome.diagnosis.verdict == "partly_explained":
        return "the cause of a part of the gap is known"
    return ENDINGS[outcome.ending]


def command_after(outcome: SequentialDiagnosis, folder: Path) -> str:
    """Return the commands that follow from the last diagnosis, one a line; empty where none do."""
    return next_command(outcome.diagnosis, str(folder_of_round(folder, len(outcome.rounds)) / "report"))


def to_json(outcome: SequentialDiagnosis) -> dict[str, Any]:
    """Return what diagnosis.json holds."""
    diagnosis = outcome.diagnosis
    return {
        "format": 1,
        "version": VERSION,
        "verdict": diagnosis.verdict,
        "sentence": diagnosis.sentence,
        "causes": [cause.effect for cause in diagnosis.causes],
        "ending": outcome.ending,
        "why": outcome.why,
        "bench_time_s": outcome.duration,
        "rounds": [
            {
                "recordings": [run.name for run in of_round.runs],
                "bench_time_s": of_round.duration,
                "verdict": of_round.diagnosis.verdict,
                "candidates": of_round.candidates,
                "added": of_round.added,
                "report": f"{folder_of_round(Path(), of_round.number)}/report/gap_report.json",
            }
            for of_round in outcome.rounds
        ],
    }


def _row(of_round: Round) -> dict[str, Any]:
    candidates = [
        (effect_name(effect), format_probability(probability)) for effect, probability in of_round.candidates.items()
    ]
    return {
        "number": of_round.number,
        "recordings": [run.name for run in of_round.runs],
        "duration": f"{of_round.duration:.0f} s",
        "candidates": candidates,
        "added": of_round.added,
        "report": f"{folder_of_round(Path(), of_round.number)}/report/gap_report.html",
    }
