"""Commitments to sealed answers: hashes that stand beside the recordings, while the answers lie elsewhere.

A commitment is the SHA-256 of the line of an answer, its salt included: nobody can guess the answer from the commitment, and
a change of the answer afterwards is detected.
"""

import hashlib
import secrets
from collections.abc import Mapping
from pathlib import Path

from mrd_base import InputError
from mrd_trials.records import GroundTruth, read_records, to_json


def new_salt() -> str:
    """Return 128 random bits as hexadecimal digits; anyone could compute bits that came from the trial's seed."""
    return secrets.token_hex(16)


def commitment(ground_truth: GroundTruth) -> str:
    """Return the hexadecimal digits that commit to an answer."""
    return hashlib.sha256(to_json(ground_truth).encode()).hexdigest()


def open_answers(path: Path, commitments: Mapping[str, str]) -> dict[str, GroundTruth]:
    """Read the sealed answers of a trial by plant, and check each against its commitment.

    Raises
    ------
    InputError
        When the file is missing or lacks a plant, or an answer is not the one that was committed to.
    """
    answers = read_records(GroundTruth, path)
    if not answers:
        raise InputError(f"{path}: holds no answers; name the file that make wrote with --answers")
    for plant, expected in commitments.items():
        if plant not in answers:
            raise InputError(f"{path}: has no answer for {plant}, expected one for each plant of the trial")
        if commitment(answers[plant]) != expected:
            raise InputError(f"{path}: the answer for {plant} is not the one committed to; it was changed afterwards")
    return {plant: answers[plant] for plant in commitments}
