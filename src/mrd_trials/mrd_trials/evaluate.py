"""Evaluate submissions with the ground truth: how far the gap can close, where it lies, what the next experiment brings."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_runs import Run
from mrd_trials.baseline_methods import run_baseline_methods
from mrd_trials.bench_session import BenchSession, as_run
from mrd_trials.closure import ClosureMeter
from mrd_trials.excitation import BLACK_BOX, SEMIREAL, random_command, recommended_command
from mrd_trials.parallel import run_in_processes
from mrd_trials.recorded_closure import share_closed
from mrd_trials.recorded_session import RecordedSession
from mrd_trials.records import Evaluation, GroundTruth, Submission, complete_records, read_records, to_json
from mrd_trials.scoring.plant_result import PlantResult
from mrd_trials.size import Size
from mrd_trials.submission import DIAGNOSER_FILE, Diagnoser, diagnose_plant, installed_diagnoser
from mrd_trials.trial_design import ALTERED_TIERS, PlantDesign, design_trial, is_detectable
from mrd_trials.trial_folder import PublicPlant, read_fresh_runs, read_given_runs, read_trial
from mrd_trials.true_map import true_map
from mrd_trials.truth import BenchCommand

EVALUATIONS_FILE = "evaluations.jsonl"

RANDOM_STREAM = 7
"""Number of the random stream, beside those of a plant's design, that gives its random experiment."""


@dataclass(frozen=True)
class DiagnosedPlant:
    """A plant with everything that its evaluation needs.

    Attributes
    ----------
    folder : Path
        Folder of the trial.
    design : PlantDesign
    recorded : str
        As in `mrd_trials.trial_design.Recipe`.
    public : PublicPlant
    truth : GroundTruth
    submission : Submission
    of_untouched : Submission or None
        That on the same recordings without the effects; None for a simulated plant, or where there is none.
    seed : int
        Seed of every diagnosis.
    """

    folder: Path
    design: PlantDesign
    recorded: str
    public: PublicPlant
    truth: GroundTruth
    submission: Submission
    of_untouched: Submission | None = None
    seed: int = 0

    @property
    def is_rendered(self) -> bool:
        """Whether the plant is rendered once more for its evaluation; of a black box, the names count."""
        return self.truth.excitation not in (BLACK_BOX, *ALTERED_TIERS)

    @property
    def digest(self) -> str:
        """SHA-256 of the submissions that are evaluated."""
        lines = [to_json(entry) for entry in (self.submission, self.of_untouched) if entry]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    @property
    def size(self) -> Size:
        """Size of the plant."""
        return Size(**self.truth.size)


def evaluate_trial(
    folder: Path,
    answers: Mapping[str, GroundTruth],
    submissions: Mapping[str, Submission],
    output: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = ignore,
) -> dict[str, Evaluation]:
    """Evaluate every plant that has a submission, and whose untouched recordings have one; evaluations that ``output`` holds
    already are kept as long as these submissions stay the same.

    Parameters
    ----------
    folder : Path
        Folder of the trial.
    answers, submissions : mapping
        By plant.
    output : Path
        Folder of the verdicts; gets `EVALUATIONS_FILE`.
    workers : int
        Number of processes.
    progress : callable
        Called with the number of finished plants and of all plants.

    Raises
    ------
    InputError
        When the folder does not say whose verdicts it holds, or simulated plants are to be diagnosed once more and another
        diagnoser made the verdicts than is installed.
    """
    trial = read_trial(folder)
    designs = {design.plant: design for design in design_trial(trial.recipe)[0]}
    diagnoser = _diagnoser_of(output)
    plants = {}
    for public in trial.plants:
        background = answers[public.plant].background
        if public.plant in submissions and (not background or background in submissions):
            plants[public.plant] = DiagnosedPlant(
                folder,
                designs[public.plant],
                trial.recipe.recorded,
                public,
                answers[public.plant],
                submissions[public.plant],
                submissions.get(background),
                diagnoser.seed,
            )

    path = output / EVALUATIONS_FILE
    kept = _kept_evaluations(path, plants)
    to_diagnose = [name for name in plants.keys() - kept.keys() if plants[name].is_rendered]
    if to_diagnose and diagnoser != replace(installed_diagnoser(diagnoser.seed, diagnoser.model), version=diagnoser.version):
        raise InputError(
            f"{output}: holds verdicts of another diagnoser, see {output / DIAGNOSER_FILE}; simulated plants are evaluated "
            "by further diagnoses: install the sources that made the verdicts"
        )
    partial = path.with_suffix(".part")
    partial.write_text("".join(f"{to_json(entry)}\n" for entry in kept.values()), encoding="utf-8")
    partial.replace(path)

    def work(names: Sequence[str]) -> Iterator[Evaluation]:
        return run_in_processes(evaluate_plant, [(plants[name],) for name in names], workers)

    return complete_records(Evaluation, path, list(plants), work, progress)


def _diagnoser_of(output: Path) -> Diagnoser:
    """Return the diagnoser whose verdicts a folder holds."""
    path = output / DIAGNOSER_FILE
    try:
        return Diagnoser(**json.loads(path.read_text(encoding="utf-8")))
    except (FileNotFoundError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: does not tell whose verdicts these are ({error}), expected the file that run wrote"
        ) from None


def _kept_evaluations(path: Path, plants: Mapping[str, DiagnosedPlant]) -> dict[str, Evaluation]:
    """Return the evaluations of a file, but those of other submissions than now; none of what another version wrote."""
    try:
        stored = read_records(Evaluation, path)
    except InputError:
        return {}
    return {name: entry for name, entry in stored.items() if name not in plants or entry.submission == plants[name].digest}


def evaluate_plant(plant: DiagnosedPlant) -> Evaluation:
    """Evaluate the submission on one plant."""
    truth, submission = plant.truth, plant.submission
    evaluation = Evaluation(truth.plant, plant.digest)
    if not plant.is_rendered:
        return _evaluate_altered(plant, evaluation)
    try:
        runs = read_given_runs(plant.folder, plant.public)
    except InputError:  # where the diagnosis was refused the recordings, no method has them
        return evaluation
    session = BenchSession.from_design(plant.design, plant.recorded)
    detectable = is_detectable(truth)
    if truth.excitation == "rich" and (truth.kind == "null" or (truth.kind == "single" and detectable)):
        evaluation = replace(evaluation, rankings=_rankings(plant, runs))
    if submission.verdict == "failed":
        return evaluation
    if detectable and submission.where and submission.verdict != "partly_explained":  # its map is that of what remains
        shares = true_map(session, truth.effects, truth.model, submission.where, plant.size)
        evaluation = replace(evaluation, true_map=shares)
    if detectable and truth.kind in ("single", "pair"):
        evaluation = _with_closure(plant, evaluation, session, runs)
    random = random_command(np.random.default_rng([*plant.design.seed, RANDOM_STREAM]))
    if submission.verdict == "ambiguous" and submission.next_experiment and random is not None:
        advised = recommended_command(submission.next_experiment, plant.size)
        evaluation = replace(
            evaluation,
            advised_resolves=_is_resolved(plant, session, runs, advised),
            random_resolves=_is_resolved(plant, session, runs, random),
        )
    return evaluation


def _rankings(plant: DiagnosedPlant, runs: Sequence[Run]) -> Mapping[str, tuple[str, ...]]:
    """Return the rankings of the baseline methods; none where what the diagnosis failed on fails these as well."""
    try:
        return run_baseline_methods([plant.size.inverse.scaled(run) for run in runs], plant.truth.model)
    except Exception:
        if plant.submission.verdict != "failed":
            raise
        return {}


def _with_closure(plant: DiagnosedPlant, evaluation: Evaluation, session: BenchSession, runs: Sequence[Run]) -> Evaluation:
    """Return an evaluation with the closure of the oracle and of the submission, which closes nothing without causes."""
    truth, submission = plant.truth, plant.submission
    fresh = read_fresh_runs(plant.folder, truth.plant)
    meter = ClosureMeter.from_session(session, truth.effects, truth.model, runs, fresh, plant.size)
    oracle = diagnose_plant(plant.public, runs, plant.seed, effects=truth.causes)
    corrected = submission.effects, submission.parameters
    return replace(
        evaluation,
        oracle_closure=meter.on_given_runs(oracle.effects, oracle.parameters) if oracle.effects else np.nan,
        closure=meter.on_given_runs(*corrected) if submission.causes else 0.0,
        fresh_closure=meter.on_fresh_runs(*corrected) if submission.causes else 0.0,
    )


def _evaluate_altered(plant: DiagnosedPlant, evaluation: Evaluation) -> Evaluation:
    """Evaluate the submission on measured recordings into which effects were put; the oracle knows what was put in."""
    truth, of_untouched = plant.truth, plant.of_untouched
    if truth.excitation != SEMIREAL or of_untouched is None or "failed" in (plant.submission.verdict, of_untouched.verdict):
        return evaluation
    session = RecordedSession.from_design(plant.design, plant.recorded)
    closed = share_closed(session, truth.effects, truth.model, plant.submission, of_untouched, plant.size)
    return replace(evaluation, oracle_closure=1.0, closure=closed)


def _is_resolved(plant: DiagnosedPlant, session: BenchSession, runs: Sequence[Run], command: BenchCommand) -> bool:
    """Whether a diagnosis with one more run names the causes and nothing else, without an alternative."""
    further = plant.size.scaled(as_run("next", session.record(plant.truth.effects, [command])[-1]))
    submission = diagnose_plant(plant.public, [*runs, further], plant.seed)
    named = PlantResult(plant.truth, submission, Evaluation(plant.truth.plant)).named
    return submission.verdict in ("explained", "partly_explained") and set(named) == set(plant.truth.causes)
