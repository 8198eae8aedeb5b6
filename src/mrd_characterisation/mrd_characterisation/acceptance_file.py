"""acceptance.json: the verdict on a damper as a file; and the command that finds the cause of a failure."""

import shlex
from pathlib import Path
from typing import Any

from mrd_base.json_file import finite_or_none, write_json
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
        "reference": {"text": acceptance.reference, "runs": list(acceptance.golden_sources)},
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
    """Return the command that finds the cause of a failure: against the golden runs where they are still there."""
    golden = acceptance.golden_sources
    reference = f" --reference {shlex.join(golden)}" if golden and all(Path(source).exists() for source in golden) else ""
    runs = run_arguments(acceptance.characterisation.runs)
    output = shlex.quote(str(Path(folder) / "diagnosis"))
    return f"{command('mrd_diagnosis', 'diagnose')} {runs}{reference} --output {output}"


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
