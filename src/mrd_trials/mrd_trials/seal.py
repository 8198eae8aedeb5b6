"""Answers out of reach and out of change: a commitment to each stands beside the recordings, the answers elsewhere.

A commitment is the SHA-256 of the answer's line, salt included: nobody can guess the answer from it, and nobody can change
the answer afterwards without its showing.
"""

import hashlib
import secrets
from collections.abc import Mapping
from pathlib import Path

from mrd_base import InputError
from mrd_trials.records import Answer, read_records, to_json


def salt() -> str:
    """128 random bits, as hex digits; not from the trial's seed, from which anyone could compute them."""
    return secrets.token_hex(16)


def commitment(answer: Answer) -> str:
    """Hex digits that commit to an answer."""
    return hashlib.sha256(to_json(answer).encode()).hexdigest()


def unseal(path: Path, commitments: Mapping[str, str]) -> dict[str, Answer]:
    """Answers of a trial by plant, each checked against its commitment.

    Raises
    ------
    InputError
        Where the file is missing, lacks a plant, or an answer is not the one that was committed to.
    """
    answers = read_records(Answer, path)
    if not answers:
        raise InputError(f"{path}: holds no answers; name the file that make wrote with --answers")
    for plant, expected in commitments.items():
        if plant not in answers:
            raise InputError(f"{path}: has no answer for {plant}, expected one for each plant of the trial")
        if commitment(answers[plant]) != expected:
            raise InputError(f"{path}: the answer for {plant} is not the one committed to; it was changed afterwards")
    return {plant: answers[plant] for plant in commitments}
