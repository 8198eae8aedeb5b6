"""Records stored for each plant: its ground truth, the submission of the diagnosis, the evaluation of that submission.

All of it is plain data, one JSON object per line and plant, so that another version can score a trial years later.
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

from mrd_base import InputError
from mrd_base.progress import ignore

Kind = Literal["null", "single", "pair", "absent"]
"""Kind of a plant: without effect, with one or two effects of the catalogue, with an effect that the catalogue lacks."""

IntervalEnds = tuple[float, float, float]
"""A value and the ends of its 95 % interval; ends are nan where there is no interval."""

NAN = float("nan")


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth of a plant, known to `mrd_trials.make` and, once the sealed answers are opened, to the evaluation.

    Attributes
    ----------
    plant : str
    kind : {"null", "single", "pair", "absent"}
    model : str
        Id of the damper model to be fitted.
    base : str
        Id of the plant's damper form.
    perturbed : bool
        Whether the fitted model cannot take that form.
    implied : tuple of str
        Effects of the catalogue that the form contains: naming them is neither right nor wrong.
    parameters : mapping
        Parameters of the form at the reference size.
    effects : mapping
        Parameters of every effect of the plant at the reference size by id, in the catalogue or not.
    formulas : mapping
        Id of the formula of each of these effects.
    causes : tuple of str
        Those effects that are in the catalogue: what a diagnosis should name.
    sizes : mapping
        Parameters of the causes that mean the same in the catalogue, at the size of the plant, by EFFECT.PARAMETER.
    signal_to_floor : float
        Mean square of what the effects add and the fitted model cannot take up, over that of the noise; 0 without effects.
        For effects put into recordings, the squared error that they add to the refitted model's, over that without them.
    stratum : str
        Stratum of that: ``<1``, ``1-3``, ``3-10``, ``>10``, or empty without effects; in recordings, the share of the
        squared error that the effects are.
    excitation : str
        ``rich``, ``paper``, ``sine``, ``replay``, ``semireal`` or ``before_after``.
    rate : float
        Sample rate in Hz.
    seed : int
        Number of the plant, from which everything random about it is drawn.
    salt : str
        Hexadecimal digits that keep the commitment from being guessed.
    background : str
        Plant with the recordings of the same background, untouched; empty for a simulated plant and for the untouched one
        itself. In a comparison, the untouched plant always has other runs after than before.
    size : mapping
        ``force``, ``motion`` and ``current`` of the plant over those at the reference size.
    begins_in_motion : bool
        Whether its recordings begin in mid-motion.
    """

    plant: str
    kind: Kind
    model: str
    base: str
    perturbed: bool
    implied: tuple[str, ...]
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    formulas: Mapping[str, str]
    causes: tuple[str, ...]
    sizes: Mapping[str, float]
    signal_to_floor: float
    stratum: str
    excitation: str
    rate: float
    seed: int
    salt: str
    background: str = ""
    size: Mapping[str, float] = field(default_factory=dict)
    begins_in_motion: bool = False


@dataclass(frozen=True)
class Explanation:
    """A cause that a diagnosis names, or a candidate that it lists.

    Attributes
    ----------
    effects : tuple of str
    probability : float
    closed_fraction : tuple of three floats
        Share of the gap that the effects close on held-out runs.
    sizes : mapping
        Value and interval of each parameter, by EFFECT.PARAMETER.
    indistinguishable : tuple of str
        Effects that, according to the diagnosis, these runs cannot tell from this one.
    level : str
        What is claimed: the effect, its class, or its stage; see `mrd_diagnosis.Cause`.
    members : tuple of str
        The class; empty where the effect is alone in it.
    plausible : tuple of str
        Effects among which the diagnosis expects the cause in nine of ten cases.
    class_probability : float
        That one of the members is the cause.
    """

    effects: tuple[str, ...]
    probability: float
    closed_fraction: IntervalEnds
    sizes: Mapping[str, IntervalEnds] = field(default_factory=dict)
    indistinguishable: tuple[str, ...] = ()
    level: str = "effect"
    members: tuple[str, ...] = ()
    plausible: tuple[str, ...] = ()
    class_probability: float = 0.0

    @property
    def claimed_probability(self) -> float:
        """Probability of what is claimed, the effect or one of the members."""
        return self.class_probability if self.members else self.probability


@dataclass(frozen=True)
class WeighedEffect:
    """An effect with the evidence that was weighed, as in `mrd_diagnosis.diagnosis.WeighedEffect`."""

    effect: str
    members: tuple[str, ...]
    probability: float
    evidence: Mapping[str, float]
    table: Mapping[str, float]


@dataclass(frozen=True)
class GapBin:
    """Share of the gap in one bin of one axis; the ends are those of `mrd_diagnosis.Region`."""

    axis: str
    lower: float
    upper: float
    share: float


@dataclass(frozen=True)
class Submission:
    """Result of the diagnosis for a plant.

    Attributes
    ----------
    plant : str
    verdict : str
        Verdict of the `mrd_diagnosis.Diagnosis`; ``failed`` where it raised an error.
    failure : str
        The error in one line.
    causes : tuple of Explanation
        One effect each; the one that is likely to close most comes first.
    candidates : tuple of Explanation
        Everything that was tried, best first.
    untestable : tuple of str
    nearest : tuple of str
        Effects that an unexplained gap resembles most.
    noise_floor, before, after : float
        Held-out NRMSE.
    closed_fraction : tuple of three floats
    where : tuple of GapBin
    next_experiment : str
        Text of the recommended experiment; empty without one.
    parameters : mapping
        Parameters of the corrected model, by name.
    effects : tuple of str
        Effects of the corrected model.
    elapsed : float
        Duration of the diagnosis in s.
    commitment : str
        Commitment to the answer of the plant that was diagnosed: plants of all trials have the same names.
    weighed : tuple of WeighedEffect
        Effects that were weighed by their evidence, named or not.
    has_place : bool or None
        Whether the diagnosis says in a sentence where the error lies; None where it has no map.
    """

    plant: str
    verdict: str
    failure: str = ""
    causes: tuple[Explanation, ...] = ()
    candidates: tuple[Explanation, ...] = ()
    untestable: tuple[str, ...] = ()
    nearest: tuple[str, ...] = ()
    noise_floor: float = NAN
    before: float = NAN
    after: float = NAN
    closed_fraction: IntervalEnds = (NAN, NAN, NAN)
    where: tuple[GapBin, ...] = ()
    next_experiment: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    elapsed: float = NAN
    commitment: str = ""
    weighed: tuple[WeighedEffect, ...] = ()
    has_place: bool | None = None


@dataclass(frozen=True)
class Evaluation:
    """Evaluation of a plant and its submission against the ground truth, with the results of the baseline methods.

    Attributes
    ----------
    plant : str
    submission : str
        SHA-256 of what was evaluated: the submission, and that on the same recordings without the effects.
    oracle_closure : float
        Share of the gap that a diagnosis with only the true causes as candidates closes; nan where it names none of them. Of
        effects put into recordings: 1.
    closure : float
        Share of the gap that the submitted parameters close on the same runs, 0 without causes. Of effects put into
        recordings: the share of the squared error that they added, on fresh runs, beyond what is closed without them.
    true_map : tuple of GapBin
        Shares of the true gap on the axes and bins of the submission.
    fresh_closure : float
        Share of the gap that they close on runs that the diagnosis was not given, 0 without causes.
    rankings : mapping
        Effects in the order of each baseline method, best first; ``bic`` and ``in_sample`` hold "" where they prefer no
        effect. Empty where the methods were not run.
    advised_resolves, random_resolves : bool or None
        Whether a second diagnosis names the causes and nothing else once the recommended experiment, or a random one, is
        recorded too; None where no experiment was recommended.
    """

    plant: str
    submission: str = ""
    oracle_closure: float = NAN
    closure: float = NAN
    true_map: tuple[GapBin, ...] = ()
    fresh_closure: float = NAN
    rankings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    advised_resolves: bool | None = None
    random_resolves: bool | None = None


@dataclass(frozen=True)
class PolicyAnswer:
    """What a diagnosis says after recordings that were chosen in some way.

    Attributes
    ----------
    policy : {"first", "advised", "random", "fixed"}
        Which recordings: the first ones alone, or with those that the diagnosis advised, random ones, or a fixed set.
    verdict : str
        ``failed`` where the diagnosis raised an error.
    effects : tuple of str
        Effects that are named by themselves.
    classes : tuple of tuple of str
        What is named: each effect, or the members of each class or stage.
    recordings : int
    duration : float
        Bench time in s of the recordings.
    ending : str
        Why the sequential diagnosis ended; empty for the first recordings alone.
    failure : str
        The error in one line.
    """

    policy: str
    verdict: str
    effects: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    recordings: int
    duration: float
    ending: str = ""
    failure: str = ""


@dataclass(frozen=True)
class SequentialOutcome:
    """Answers on one plant; those beside the first one only where this does not name all causes by themselves.

    Attributes
    ----------
    plant : str
    causes, implied : tuple of str
        As in `GroundTruth`.
    signal_to_floor : float
    commitment : str
        Commitment to the answer of the plant.
    answers : tuple of PolicyAnswer
    """

    plant: str
    causes: tuple[str, ...]
    implied: tuple[str, ...]
    signal_to_floor: float
    commitment: str
    answers: tuple[PolicyAnswer, ...]


R = TypeVar("R", GroundTruth, Submission, Evaluation, SequentialOutcome)

_FORMATS: Mapping[type, int] = {Submission: 4, Evaluation: 3, SequentialOutcome: 2}
"""Version of the keys of a line. An answer has none: a commitment is the hash of its line."""

_NAMES: Mapping[type, str] = {
    GroundTruth: "answer",
    Submission: "submission",
    Evaluation: "evaluation",
    SequentialOutcome: "outcome",
}

_ITEMS: Mapping[tuple[type, str], Any] = {
    (Submission, "causes"): Explanation,
    (Submission, "candidates"): Explanation,
    (Submission, "where"): GapBin,
    (Submission, "weighed"): WeighedEffect,
    (Evaluation, "true_map"): GapBin,
    (SequentialOutcome, "answers"): PolicyAnswer,
}
"""Class of the items of a field."""


def to_json(record: GroundTruth | Submission | Evaluation | SequentialOutcome) -> str:
    """Return a record as one line; equal records give equal lines."""
    version = {"format": _FORMATS[type(record)]} if type(record) in _FORMATS else {}
    return json.dumps(version | asdict(record), sort_keys=True, separators=(",", ":"))


def from_json(kind: type[R], line: str, place: str) -> R:
    """Return the record of a line that `to_json` wrote; ``place`` says in error messages where the line stands.

    Raises
    ------
    InputError
        When the line is not such a record.
    """
    try:
        values = json.loads(line)
        found, expected = values.pop("format", None), _FORMATS.get(kind)
        if found != expected:
            raise ValueError(f"format {found}, expected {expected}")
        unknown = values.keys() - {entry.name for entry in fields(kind)}
        if unknown:
            raise ValueError(f"unknown field {sorted(unknown)[0]}")
        return kind(**{name: _restored(_ITEMS.get((kind, name)), value) for name, value in values.items()})
    except (ValueError, TypeError, AttributeError) as error:
        text = f"{place}: is not an {_NAMES[kind]}" if kind is not Submission else f"{place}: is not a submission"
        raise InputError(f"{text} ({error}), expected a line that this version of mrd_trials has written") from None


def append_record(record: GroundTruth | Submission | Evaluation | SequentialOutcome, path: Path) -> None:
    """Append a record to a file; a last line that an interruption has cut off is removed."""
    if path.exists() and not (content := path.read_bytes()).endswith(b"\n"):
        os.truncate(path, content.rfind(b"\n") + 1)
    with path.open("a", encoding="utf-8") as stream:
        stream.write(to_json(record) + "\n")


def read_records(kind: type[R], path: Path) -> dict[str, R]:
    """Read all records of a file by plant; none where it does not exist. A last line that was cut off is left out."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    if text and not text.endswith("\n"):
        lines.pop()
    records = [from_json(kind, line, f"{path}: line {number}") for number, line in enumerate(lines, 1)]
    return {record.plant: record for record in records}


def complete_records(
    kind: type[R],
    path: Path,
    plants: Sequence[str],
    work: Callable[[Sequence[str]], Iterable[R]],
    progress: Callable[[int, int], None] = ignore,
) -> dict[str, R]:
    """Return the records of some plants: those of a file, and new ones, each stored as soon as it is computed.

    Parameters
    ----------
    kind : type
        Class of the records.
    path : Path
        The file; new records are appended.
    plants : sequence of str
    work : callable
        Computes the records of the plants that the file lacks.
    progress : callable
        Called with the number of finished plants and of all plants.
    """
    stored = read_records(kind, path)
    done = {plant: stored[plant] for plant in plants if plant in stored}
    progress(len(done), len(plants))
    for record in work([plant for plant in plants if plant not in done]):
        done[record.plant] = record
        append_record(record, path)
        progress(len(done), len(plants))
    return done


def _restored(item: Any, value: Any) -> Any:
    """Return a value of JSON with its tuples, and with its items as instances of a class where there is one."""
    if item is not None:
        return tuple(item(**{key: _restored(None, entry) for key, entry in values.items()}) for values in value)
    if isinstance(value, list):
        return tuple(_restored(None, entry) for entry in value)
    if isinstance(value, dict):
        return {key: _restored(None, entry) for key, entry in value.items()}
    return value
