"""What is kept of a plant: the answer, what a diagnosis says of it, what one who knows the answer finds.

All of it is plain data, one JSON object a plant, so that a trial can be scored years later by another version.
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

from mrd_base import InputError

Kind = Literal["null", "single", "pair", "absent"]
Ends = tuple[float, float, float]
"""A value and the ends of its 95 % interval; the ends are nan where there is none."""


@dataclass(frozen=True)
class Answer:
    """What a plant is: known to its maker and, once the seal is broken, to the score.

    Attributes
    ----------
    plant : str
    kind : {"null", "single", "pair", "absent"}
    model : str
        The damper model that is to be fitted.
    base, perturbed : str, bool
        Form of the plant's damper, and whether it is another one than the fitted model can take.
    parameters : mapping
        Of that form.
    effects : mapping
        Parameters of each effect of the plant, by id; both of the catalogue and absent from it.
    causes : tuple of str
        Those of them that the catalogue knows: what a diagnosis should name.
    sizes : mapping
        What parameters of the causes amount to in the catalogue's terms, by EFFECT.PARAMETER, where the two mean the same.
    signal_to_floor : float
        Mean square of what the effects add and the fitted model cannot take up, over that of the noise; 0 without effects.
    stratum : str
        Of the signal to floor: ``1-3``, ``3-10``, ``>10``, or empty.
    excitation : str
        ``rich``, ``paper``, ``sine`` or ``replay``.
    rate : float
        Hz.
    seed : int
        Of everything random about the plant.
    salt : str
        Hex digits that keep the commitment from being guessed.
    """

    plant: str
    kind: Kind
    model: str
    base: str
    perturbed: bool
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    causes: tuple[str, ...]
    sizes: Mapping[str, float]
    signal_to_floor: float
    stratum: str
    excitation: str
    rate: float
    seed: int
    salt: str


@dataclass(frozen=True)
class Named:
    """A cause that a diagnosis names, or a candidate that it lists.

    Attributes
    ----------
    effects : tuple of str
    probability : float
    closed : tuple of three floats
        Share of the explainable gap, held out.
    sizes : mapping
        Value and ends of each parameter, by EFFECT.PARAMETER.
    alike : tuple of str
        Effects that the diagnosis says it cannot tell from this one on these runs.
    """

    effects: tuple[str, ...]
    probability: float
    closed: Ends
    sizes: Mapping[str, Ends] = field(default_factory=dict)
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class Bin:
    """Share of the excess error in one bin of one axis."""

    axis: str
    lower: float
    upper: float
    share: float


@dataclass(frozen=True)
class Submission:
    """What the diagnosis says of a plant.

    Attributes
    ----------
    plant : str
    verdict : str
        As of `mrd_diagnosis.diagnosis.Diagnosis`; ``failed`` where it came to none.
    failure : str
        The error in one line.
    causes : tuple of Named
        One effect each; first what is likely to close most.
    candidates : tuple of Named
        Everything tried, best first.
    untestable : tuple of str
    nearest : tuple of str
    floor, before, after : float
        NRMSE, held out.
    closed : tuple of three floats
    where : tuple of Bin
    advice : str
        Text of the experiment that is advised; empty without one.
    parameters : mapping
        Of the model with ``effects``, by name.
    effects : tuple of str
    elapsed : float
        s.
    commitment : str
        To the answer for the plant that was judged: plants of all trials have the same names.
    """

    plant: str
    verdict: str
    failure: str = ""
    causes: tuple[Named, ...] = ()
    candidates: tuple[Named, ...] = ()
    untestable: tuple[str, ...] = ()
    nearest: tuple[str, ...] = ()
    floor: float = float("nan")
    before: float = float("nan")
    after: float = float("nan")
    closed: Ends = (float("nan"), float("nan"), float("nan"))
    where: tuple[Bin, ...] = ()
    advice: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    elapsed: float = float("nan")
    commitment: str = ""


@dataclass(frozen=True)
class Insight:
    """What one who knows the answer finds of a plant and of what was said of it, and what simpler methods say.

    Attributes
    ----------
    plant : str
    closed : float
        Share of the explainable gap that the true causes close, refitted; nan where the catalogue lacks one.
    where : tuple of Bin
        Of the true gap, on the axes and bins of the submission.
    fresh : float
        Share of the gap that the submitted parameters close on runs that no one was given; nan where nothing was named.
    alike : mapping
        By cause: effects that, refitted in its place, close at least nine tenths of what it closes, it among them.
    rankings : mapping
        Effects in the order in which simpler methods put them, by the method's name, best first; ``bic`` and ``in_sample``
        hold "" where they prefer no effect. Empty where they were not asked.
    advised, random : bool or None
        Whether a second diagnosis names the causes, and nothing else, once the advised experiment, or a random safe one, was
        recorded besides; None where no experiment was advised.
    """

    plant: str
    closed: float = float("nan")
    where: tuple[Bin, ...] = ()
    fresh: float = float("nan")
    alike: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    rankings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    advised: bool | None = None
    random: bool | None = None


R = TypeVar("R", Answer, Submission, Insight)

_PARTS: dict[str, Any] = {"causes": Named, "candidates": Named, "where": Bin}


def to_json(record: Answer | Submission | Insight) -> str:
    """One line; equal records give equal lines."""
    return json.dumps(asdict(record), sort_keys=True, separators=(",", ":"))


def from_json(kind: type[R], line: str, where: str) -> R:
    """Back from `to_json`.

    Raises
    ------
    InputError
        For what is no such line, named by ``where``.
    """
    try:
        found = json.loads(line)
        unknown = found.keys() - {entry.name for entry in fields(kind)}
        if unknown:
            raise ValueError(f"unknown field {sorted(unknown)[0]}")
        return kind(**{name: _restored(kind, name, value) for name, value in found.items()})
    except (ValueError, TypeError, AttributeError) as error:
        text = f"{where}: is no {kind.__name__.lower()} ({error}), expected a line that the trials have written"
        raise InputError(text) from None


def add_record(record: Answer | Submission | Insight, path: Path) -> None:
    """Append to a file of records; a last line that was cut off when somebody was killed gives way."""
    if path.exists() and not (kept := path.read_bytes()).endswith(b"\n"):
        os.truncate(path, kept.rfind(b"\n") + 1)
    with path.open("a", encoding="utf-8") as stream:
        stream.write(to_json(record) + "\n")


def read_records(kind: type[R], path: Path) -> dict[str, R]:
    """All records of a file by plant; none where it does not exist. A last line that was cut off is left out."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    if text and not text.endswith("\n"):
        lines.pop()
    found = [from_json(kind, line, f"{path}: line {number}") for number, line in enumerate(lines, 1)]
    return {record.plant: record for record in found}


def completed(
    kind: type[R],
    path: Path,
    plants: Sequence[str],
    work: Callable[[Sequence[str]], Iterable[R]],
    progress: Callable[[int, int], None] = lambda _n, _of: None,
) -> dict[str, R]:
    """Records of some plants: those that a file has, and what work makes of the others, each kept as soon as it is there.

    Parameters
    ----------
    kind : type
        Of the records.
    path : Path
        The file; grows.
    plants : sequence of str
    work : callable
        Makes the records of the plants that are left to do.
    progress : callable
        Called with the number of plants that are done, and of all.
    """
    found = read_records(kind, path)
    done = {plant: found[plant] for plant in plants if plant in found}
    progress(len(done), len(plants))
    for record in work([plant for plant in plants if plant not in done]):
        done[record.plant] = record
        add_record(record, path)
        progress(len(done), len(plants))
    return done


def _restored(kind: type, name: str, value: Any) -> Any:
    """Tuples, and the records within, that JSON knows only as lists and objects."""
    if name in _PARTS and kind is not Answer:
        part = _PARTS[name]
        return tuple(part(**{key: _frozen(entry) for key, entry in item.items()}) for item in value)
    return _frozen(value)


def _frozen(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_frozen(item) for item in value)
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    return value
