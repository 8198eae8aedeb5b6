"""Counts of verdicts and of named effects: verdicts by kind of plant, confusion of effects."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from mrd_trials.scoring.plant_result import PlantResult, PlantResults, select

VERDICTS = ("no_gap", "explained", "partly_explained", "ambiguous", "unknown_effect", "data_fault", "failed")
EXCITATIONS = ("rich", "black_box", "paper", "sine", "replay", "semireal", "before_after")

KINDS = ("null", "null, another form", "single, weak", "single", "pair", "absent")

_NOT_NAMED = "not named"


@dataclass(frozen=True)
class Counts:
    """Counts by row and column."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]

    @classmethod
    def from_counter(cls, rows: Iterable[str], columns: Iterable[str], counter: Counter[tuple[str, str]]) -> "Counts":
        """Arrange counts by (row, column)."""
        rows, columns = tuple(rows), tuple(columns)
        return cls(rows, columns, tuple(tuple(counter[row, column] for column in columns) for row in rows))


def count_verdicts(results: PlantResults) -> Counts:
    """Count verdicts by excitation and kind of plant."""
    counter = Counter((f"{result.truth.excitation}: {_kind(result)}", result.submission.verdict) for result in results)
    rows = [f"{excitation}: {kind}" for excitation in excitations(results) for kind in KINDS]
    other_verdicts = sorted({verdict for _, verdict in counter} - set(VERDICTS))
    present = {row for row, _ in counter}
    return Counts.from_counter([row for row in rows if row in present], [*VERDICTS, *other_verdicts], counter)


def count_confusion(results: PlantResults) -> Counts:
    """Count what is named first by ground truth, or else the verdict; each cause of a pair has its own row."""
    pairs = select(results, kind="pair")
    entries = [
        *sorted((result.truth.causes[0], _first_named(result)) for result in select(results, kind="single")),
        *sorted((f"{cause}, of a pair", _named_for(result, cause)) for result in pairs for cause in result.truth.causes),
        *sorted((_kind(result), _first_named(result)) for result in results if result.truth.kind in ("null", "absent")),
    ]
    columns = sorted({column for _, column in entries}, key=lambda column: (column in (*VERDICTS, _NOT_NAMED), column))
    return Counts.from_counter(dict.fromkeys(row for row, _ in entries), columns, Counter(entries))


def excitations(results: PlantResults) -> list[str]:
    """Return the excitations that occur, and ``rich``, in their usual order."""
    present = {"rich", *(result.truth.excitation for result in results)}
    return sorted(present, key=lambda name: (EXCITATIONS.index(name) if name in EXCITATIONS else len(EXCITATIONS), name))


def _first_named(result: PlantResult) -> str:
    return next(iter(result.named), result.submission.verdict)


def _named_for(result: PlantResult, cause: str) -> str:
    """Return what stands for one cause of a pair: the cause itself, else a wrong name, else the verdict."""
    if cause in result.named:
        return cause
    without_name = _NOT_NAMED if result.named else result.submission.verdict
    return next((effect for effect in result.named if effect not in result.truth.causes), without_name)


def _kind(result: PlantResult) -> str:
    if result.truth.kind == "null" and result.truth.perturbed:
        return "null, another form"
    return "single, weak" if result.truth.kind == "single" and not result.detectable else result.truth.kind
