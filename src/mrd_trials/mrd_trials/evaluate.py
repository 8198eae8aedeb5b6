"""Evaluate submissions with the ground truth: how far the gap can close, where it lies, what the next experiment brings."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mrd_base.progress import ignore
from mrd_runs import Run
from mrd_trials.baseline_methods import run_baseline_methods
from mrd_trials.bench_session import BenchSession, as_run
from mrd_trials.closure import ClosureMeter
from mrd_trials.excitation import BEFORE_AFTER, BLACK_BOX, random_command, recommended_command
from mrd_trials.parallel import run_in_processes
from mrd_trials.recorded_closure import share_closed
from mrd_trials.recorded_session import RecordedSession
from mrd_trials.records import Evaluation, GroundTruth, Submission, complete_records
from mrd_trials.size import Size
from mrd_trials.submission import diagnose_plant
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
    """

    folder: Path
    design: PlantDesign
    recorded: str
    public: PublicPlant
    truth: GroundTruth
    submission: Submission
    of_untouched: Submission | None = None

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
    """Evaluate every plant that has a submission; evaluations that ``output`` holds already are kept.

    Parameters
    ----------
    folder : Path
        Folder of the trial.
    answers, submissions : mapping
        By plant.
    output : Path
        Folder that gets `EVALUATIONS_FILE`.
    workers : int
        Number of processes.
    progress : callable
        Called with the number of finished plants and of all plants.
    """
    trial = read_trial(folder)
    designs = {design.plant: design for design in design_trial(trial.recipe)[0]}
    plants = {
        public.plant: DiagnosedPlant(
            folder,
            designs[public.plant],
            trial.recipe.recorded,
            public,
            answers[public.plant],
            submissions[public.plant],
            submissions.get(answers[public.plant].background),
        )
        for public in trial.plants
        if public.plant in submissions
    }

    def work(names: Sequence[str]) -> Iterator[Evaluation]:
        return run_in_processes(evaluate_plant, [(plants[name],) for name in names], workers)

    return complete_records(Evaluation, output / EVALUATIONS_FILE, list(plants), work, progress)


def evaluate_plant(plant: DiagnosedPlant) -> Evaluation:
    """Evaluate the submission on one plant; an evaluation of a failed one is empty, as it would fail again."""
    truth, submission = plant.truth, plant.submission
    evaluation = Evaluation(truth.plant, equivalents={cause: (cause,) for cause in truth.causes})
    if submission.verdict == "failed" or truth.excitation == BLACK_BOX:  # of a black box, the names count
        return evaluation
    if truth.excitation in ALTERED_TIERS:
        return _evaluate_altered(plant, evaluation)
    runs = read_given_runs(plant.folder, plant.public)
    session = BenchSession.from_design(plant.design, plant.recorded)
    detectable = truth.kind == "single" and is_detectable(truth)
    if (detectable or (truth.kind == "null" and truth.excitation == "rich")) and submission.verdict != "data_fault":
        baseline = run_baseline_methods([plant.size.inverse.scaled(run) for run in runs], truth.model)
        equivalents = {cause: baseline.equivalents(cause) for cause in truth.causes}
        evaluation = replace(evaluation, rankings=baseline.rankings, equivalents=equivalents)
    if truth.effects and submission.where:
        shares = true_map(session, truth.effects, truth.model, submission.where, plant.size)
        evaluation = replace(evaluation, true_map=shares)
    is_solvable = bool(truth.causes) and truth.kind != "absent"
    if is_solvable or submission.causes:
        fresh = read_fresh_runs(plant.folder, truth.plant)
        meter = ClosureMeter.from_session(session, truth.effects, truth.model, runs, fresh, plant.size)
        if is_solvable:
            oracle = diagnose_plant(plant.public, runs, effects=truth.causes)
            if oracle.effects:
                evaluation = replace(evaluation, oracle_closure=meter.on_given_runs(oracle.effects, oracle.parameters))
        if submission.causes:
            closure = meter.on_fresh_runs(submission.effects, submission.parameters)
            evaluation = replace(evaluation, fresh_closure=closure)
    random = random_command(np.random.default_rng([*plant.design.seed, RANDOM_STREAM]))
    if submission.verdict == "ambiguous" and submission.next_experiment and random is not None:
        advised = recommended_command(submission.next_experiment, plant.size)
        evaluation = replace(
            evaluation,
            advised_resolves=_is_resolved(plant, session, runs, advised),
            random_resolves=_is_resolved(plant, session, runs, random),
        )
    return evaluation


def _evaluate_altered(plant: DiagnosedPlant, evaluation: Evaluation) -> Evaluation:
    """Evaluate the submission on measured recordings into which effects were put; the oracle knows what was put in."""
    truth = plant.truth
    if not truth.effects:
        return evaluation
    evaluation = replace(evaluation, oracle_closure=truth.signal_to_floor / (1.0 + truth.signal_to_floor))
    if truth.excitation == BEFORE_AFTER or plant.of_untouched is None:
        return evaluation
    session = RecordedSession.from_design(plant.design, plant.recorded)
    closed = share_closed(session, truth.effects, truth.model, plant.submission, plant.of_untouched, plant.size)
    return replace(evaluation, fresh_closure=closed)


def _is_resolved(plant: DiagnosedPlant, session: BenchSession, runs: Sequence[Run], command: BenchCommand) -> bool:
    """Whether a diagnosis with one more run names the causes and nothing else, without an alternative."""
    further = plant.size.scaled(as_run("next", session.record(plant.truth.effects, [command])[-1]))
    submission = diagnose_plant(plant.public, [*runs, further])
    named = {effect for cause in submission.causes for effect in cause.effects}
    return submission.verdict in ("explained", "partly_explained") and named == set(plant.truth.causes)
