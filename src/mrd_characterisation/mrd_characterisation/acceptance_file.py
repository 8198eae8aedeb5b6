"""acceptance.json: the verdict on a damper as a file; and the command that finds the cause of a failure."""

import hashlib
import math
import shlex
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from mrd_base import InputError
from mrd_base.json_file import finite_or_none, read_json, write_json
from mrd_base.tool import command
from mrd_base.version import VERSION
from mrd_characterisation.acceptance import Acceptance, Check
from mrd_runs.read import run_arguments
from mrd_runs.summary import run_json

SCHEMA = "mrd-acceptance/1"


def to_json(acceptance: Acceptance, next_command: str | None = None) -> dict[str, Any]:
    """Return the content of acceptance.json; numbers that are not finite become null."""
    test = acceptance.test
    return {
        "schema": SCHEMA,
        "sentence": acceptance.sentence,
        "verdict": acceptance.verdict,
        "serial": test.serial,
        "date": test.date.isoformat() if test.date else None,
        "rig": test.rig,
        "operator": test.operator,
        "temperature_K": list(test.temperature) if test.temperature else None,
        "reference": {
            "text": acceptance.reference,
            "runs": list(acceptance.golden_sources),
            "limits_sha256": _limits_hash(acceptance),
        },
        "runs": [run_json(run) for run in acceptance.characterisation.runs],
        "checks": [_check(check) for check in acceptance.by_outcome],
        "next_command": next_command,
        "version": VERSION,
    }


def write_acceptance(acceptance: Acceptance, folder: str | Path) -> Path:
    """Write acceptance.json into ``folder`` and return its path; the file is complete or absent."""
    next_command = diagnose_command(acceptance, folder) if acceptance.verdict == "fail" else None
    return write_json(to_json(acceptance, next_command), "mrd_characterisation", "acceptance", folder)


def diagnose_command(acceptance: Acceptance, folder: str | Path) -> str:
    """Return the command that finds the cause of a failure: against recordings of a good damper where there are some."""
    return _diagnose_command(acceptance, folder, _good_damper(acceptance, folder)[1])


def _diagnose_command(acceptance: Acceptance, folder: str | Path, good: Sequence[str]) -> str:
    reference = f" --reference {shlex.join(good)}" if good else ""
    runs = run_arguments(acceptance.characterisation.runs)
    output = shlex.quote(str(Path(folder) / "diagnosis"))
    return f"{command('mrd_diagnosis', 'diagnose')} {runs}{reference} --output {output}"


def cause_text(acceptance: Acceptance, folder: str | Path) -> str:
    """Return how to find the cause of a failure: the command, and what it compares the damper with."""
    name, good = _good_damper(acceptance, folder)
    against = f", as a difference from {name}" if good else ""
    text = f"To find the cause{against}: {_diagnose_command(acceptance, folder, good)}"
    return text if good else f"{text}\n{_ALONE}"


_ALONE = (
    "note: This compares the recordings with a model that is fitted to them, which takes up much of what makes a damper "
    "fail, as a loss of gas. Add --reference and the recordings of a good damper "
    "by the same test, to find what differs from it."
)


def _good_damper(acceptance: Acceptance, folder: str | Path) -> tuple[str, Sequence[str]]:
    """Return words and recordings of the golden damper, else of the latest one beside that passed by the same limits."""
    if _are_there(acceptance.golden_sources):
        return "the golden damper", acceptance.golden_sources
    place = Path(folder).resolve()
    # Beside this folder as `accept` writes it, or beside the recordings in which it is, as `bench` writes it.
    beside = {*place.parent.glob("*/acceptance.json"), *place.parent.parent.glob(f"*/{place.name}/acceptance.json")}
    limits, latest = _limits_hash(acceptance), -math.inf
    found: tuple[str, Sequence[str]] = ("", ())
    for file in sorted(beside - {place / "acceptance.json"}):
        try:
            test = read_json(file, "mrd_characterisation", "acceptance", SCHEMA)
        except InputError:
            continue
        runs = [run["source"] or "" for run in test["runs"]]
        # Without a date, it is older than any with one.
        date = datetime.fromisoformat(test["date"]).timestamp() if test["date"] else 0.0
        alike = test["verdict"] == "pass" and test["reference"].get("limits_sha256") == limits
        if alike and date > latest and _are_there(runs):
            latest, found = date, (f"{test['serial']}, which passed", tuple(runs))
    return found


def _limits_hash(acceptance: Acceptance) -> str:
    """Return a text that is the same for the same limits: files of limits of several products may have one name."""
    limits = sorted({repr(check.limit) for check in acceptance.checks})
    return hashlib.sha256("\n".join(limits).encode()).hexdigest()


def _are_there(sources: Sequence[str]) -> bool:
    return bool(sources) and all(source and Path(source).exists() for source in sources)


def _check(check: Check) -> dict[str, Any]:
    limit, value = check.limit, check.value

    def condition(name: str) -> Any:
        # That of the limit where it has one: it is the same in all tests against these limits.
        return getattr(limit, name) if getattr(limit, name) is not None else getattr(value, name, None)

    return {
        "quantity": limit.quantity,
        "unit": limit.unit,
        "current": condition("current"),
        "current_before": condition("current_before"),
        "direction": condition("direction"),
        "speed": condition("speed"),
        "stroke": condition("stroke"),
        "outcome": check.outcome,
        "value": None if value is None else finite_or_none(value.value),
        "ci95": [finite_or_none(end) for end in check.interval],
        "lower": finite_or_none(limit.lower),
        "upper": finite_or_none(limit.upper),
        "excess": finite_or_none(check.excess),
        "cycles": 0 if value is None else value.cycles,
        "definition": "" if value is None else value.definition,
    }
