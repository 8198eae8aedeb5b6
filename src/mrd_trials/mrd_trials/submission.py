"""Submission of the installed diagnosis: its verdict on one plant."""

import hashlib
import inspect
import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from mrd_base import InputError
from mrd_base.version import VERSION
from mrd_diagnosis import BEST_MODEL, Diagnosis, Interval, diagnose, where_sentence
from mrd_runs import Run
from mrd_sim.simulators.recorded import RecordedSimulator
from mrd_trials.excitation import BEFORE_AFTER, BLACK_BOX
from mrd_trials.records import Explanation, GapBin, IntervalEnds, Submission, WeighedEffect
from mrd_trials.trial_folder import PublicPlant

DIAGNOSIS_PACKAGES = ("mrd_base", "mrd_runs", "mrd_trajectory", "mrd_sim", "mrd_identification", "mrd_diagnosis")
"""Packages whose code decides what a diagnosis says."""

OWN_SOURCES = ("size.py", "submission.py")
"""Files of this package that decide what a diagnosis is asked."""

DIAGNOSER_FILE = "diagnoser.json"

Method = Callable[..., Diagnosis]
"""A function that takes what `mrd_diagnosis.diagnose` takes, and returns what it returns."""


@dataclass(frozen=True)
class Diagnoser:
    """Code and options of a diagnosis, recorded so that everybody can check them.

    Attributes
    ----------
    version : str
    code, catalogue : str
        SHA-256 of the sources of `DIAGNOSIS_PACKAGES` and `OWN_SOURCES`, and of the effects among them.
    seed : int
        Seed of every diagnosis.
    model : str
        Damper model around which every plant is diagnosed; empty where it is the one that the trial names.
    method, method_code : str
        Name of the function that diagnoses, and SHA-256 of the module that has it.
    """

    version: str
    code: str
    catalogue: str
    seed: int
    model: str = ""
    method: str = ""
    method_code: str = ""

    def with_method(self, method: Method) -> "Diagnoser":
        """Return the diagnoser with the function that diagnoses.

        Raises
        ------
        InputError
            When no file has its source.
        """
        try:
            code = hashlib.sha256(Path(inspect.getfile(method)).read_bytes()).hexdigest()
        except (TypeError, OSError):
            raise InputError(f"method {method!r}: no file has its source, expected a function of a module") from None
        return replace(self, method=f"{method.__module__}.{method.__qualname__}", method_code=code)


def installed_diagnoser(seed: int = 0, model: str = "") -> Diagnoser:
    """Return the diagnoser that is installed here."""
    roots = {name: Path(_origin(name)).parent for name in DIAGNOSIS_PACKAGES}
    own = [Path(__file__).with_name(name) for name in OWN_SOURCES]
    code, catalogue = _hash_sources([*roots.values(), *own]), _hash_sources([roots["mrd_sim"] / "effects"])
    return Diagnoser(VERSION, code, catalogue, seed, model).with_method(diagnose)


def reserve_folder(diagnoser: Diagnoser, output: Path) -> None:
    """Reserve a folder for the verdicts of one diagnoser; the folder is made where it does not exist.

    Raises
    ------
    InputError
        When it holds verdicts of another diagnoser.
    """
    output.mkdir(parents=True, exist_ok=True)
    path = output / DIAGNOSER_FILE
    text = json.dumps(vars(diagnoser), indent=1) + "\n"
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise InputError(
            f"{output}: holds verdicts of another diagnoser, see {path}; the code or the options changed since: "
            "name another --output, or go back to that version"
        )
    path.write_text(text, encoding="utf-8")


def diagnoser_of_verdicts(output: Path) -> dict[str, Any]:
    """Return what a folder says of the diagnoser of its verdicts, as the fields of `Diagnoser`; empty without verdicts."""
    path = output / DIAGNOSER_FILE
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}


def model_of_verdicts(output: Path) -> str:
    """Return the damper model around which all verdicts of a folder are; empty where it is the one that the trial names."""
    return str(diagnoser_of_verdicts(output).get("model", ""))


def diagnose_plant(
    plant: PublicPlant,
    runs: Sequence[Run],
    seed: int = 0,
    effects: Sequence[str] = (),
    reference: Sequence[Run] = (),
    method: Method = diagnose,
) -> Submission:
    """Diagnose one plant; an error is a submission too.

    Parameters
    ----------
    plant : PublicPlant
    runs : sequence of Run
    seed : int
    effects : sequence of str
        Effects of the catalogue that are candidates, all by default.
    reference : sequence of Run
        Recordings from before, where the question is what has changed since; or those of the plant's simulator.
    method : callable
        What diagnoses; takes what `mrd_diagnosis.diagnose` takes.
    """
    start = time.monotonic()
    is_black_box = plant.excitation == BLACK_BOX
    compared: dict[str, Any] = {"reference": reference} if reference and not is_black_box else {}
    if is_black_box:
        compared = {"simulator": RecordedSimulator(reference)}
    try:
        diagnosis = method(
            runs, BEST_MODEL if is_black_box else plant.model, effects=effects, bench=plant.size.bench, seed=seed, **compared
        )
    except Exception as error:  # every error counts as a failure of the diagnosis
        return failed_submission(plant, error, time.monotonic() - start)
    return submission_of(plant, diagnosis)


def failed_submission(plant: PublicPlant, error: Exception, elapsed: float = 0.0) -> Submission:
    """Return what is stored of a plant that could not be diagnosed within ``elapsed`` seconds."""
    text = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return Submission(plant.plant, "failed", failure=text, elapsed=elapsed, commitment=plant.commitment)


def check_comparison(plants: Iterable[PublicPlant], method: Method) -> None:
    """Check that a method can compare recordings with earlier ones where a trial asks for it.

    Raises
    ------
    InputError
        When it cannot.
    """
    known = inspect.signature(method).parameters
    for plant in plants:
        needed = "simulator" if plant.excitation == BLACK_BOX else "reference"
        if plant.reference and needed not in known:
            raise InputError(
                f"plant {plant.plant}: is to be compared with recordings as {needed}, but this diagnosis takes no {needed}; "
                f"make a trial without the tier {BLACK_BOX if needed == 'simulator' else BEFORE_AFTER}"
            )


def submission_of(plant: PublicPlant, diagnosis: Diagnosis) -> Submission:
    """Return what is stored of a diagnosis. Nothing else in this package reads a `mrd_diagnosis.Diagnosis`."""
    causes = tuple(
        Explanation(
            effects=(cause.effect,),
            probability=cause.probability,
            closed_fraction=_ends(cause.closed_fraction),
            sizes={name: _ends(value.value) for name, value in cause.parameters.items()},
            indistinguishable=tuple(
                alternative.effect for alternative in diagnosis.alternatives if alternative.instead_of == cause.effect
            ),
            level=cause.level,
            members=tuple(member.effect for member in cause.members) if cause.level != "effect" else (),
            plausible=cause.plausible,
            class_probability=cause.class_probability,
        )
        for cause in diagnosis.causes
    )
    candidates = tuple(
        Explanation(
            candidate.effects, candidate.probability, _ends(candidate.closed_fraction), {}, candidate.indistinguishable
        )
        for candidate in diagnosis.candidates
    )
    submission = Submission(
        plant=plant.plant,
        verdict=diagnosis.verdict,
        causes=causes,
        candidates=candidates,
        untestable=tuple(entry.effect for entry in diagnosis.untestable),
        nearest=diagnosis.nearest.effects if diagnosis.nearest else (),
        where=tuple(GapBin(region.axis, region.lower, region.upper, region.share.value) for region in diagnosis.where),
        has_place=bool(where_sentence(diagnosis)) if diagnosis.where else None,
        next_experiment=diagnosis.next_experiment.experiment if diagnosis.next_experiment else "",
        elapsed=diagnosis.elapsed,
        commitment=plant.commitment,
        weighed=tuple(
            WeighedEffect(entry.effect, entry.members, entry.probability, entry.evidence, entry.table)
            for entry in diagnosis.weighed
        ),
    )
    if diagnosis.gap is None or diagnosis.corrected is None:
        return submission
    return replace(
        submission,
        noise_floor=diagnosis.gap.noise_floor.value,
        before=diagnosis.gap.before.value,
        after=diagnosis.gap.after.value,
        closed_fraction=_ends(diagnosis.gap.closed_fraction),
        parameters=dict(diagnosis.corrected.parameters),
        effects=diagnosis.corrected.effects,
    )


def _ends(interval: Interval) -> IntervalEnds:
    return interval.value, interval.lower, interval.upper


def _origin(package: str) -> str:
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise InputError(f"package {package} is not installed; run: make build")
    return spec.origin


def _hash_sources(roots: Sequence[Path]) -> str:
    """Return the SHA-256 of some files, or of all Python sources and JSON files below some folders."""
    digest = hashlib.sha256()
    for root in roots:
        files = sorted(root.rglob("*")) if root.is_dir() else [root]
        for file in (file for file in files if file.suffix in (".py", ".json")):
            digest.update(str(file.relative_to(root.parent)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()
