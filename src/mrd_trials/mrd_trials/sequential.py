"""Trial of the sequential diagnosis: do the recordings that it chooses name a cause that the first recordings leave open?

Three ways to go on after the first recordings are compared: the recordings that the diagnosis chooses, random ones, and a
fixed set in its order. All of them are diagnosed after each recording, end by the same rule, and have the same bench time.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mrd_base.progress import ignore
from mrd_diagnosis import diagnose_sequentially
from mrd_runs import Run
from mrd_trajectory.plan import Plan
from mrd_trials.bench_session import BenchSession, Effects, as_run
from mrd_trials.excitation import Tier, at_reference, command, commands_of_runs, random_command
from mrd_trials.parallel import run_in_processes
from mrd_trials.records import GroundTruth, PolicyAnswer, SequentialOutcome, Submission, complete_records, read_records
from mrd_trials.run import require_same_trial
from mrd_trials.scoring.plant_result import members_of
from mrd_trials.scoring.rates import Rate
from mrd_trials.scoring.tables import text
from mrd_trials.size import Size
from mrd_trials.submission import failed_submission, installed_diagnoser, reserve_folder, submission_of
from mrd_trials.trial_design import DETECTABLE, PlantDesign, design_trial
from mrd_trials.trial_folder import PublicPlant, read_trial
from mrd_trials.truth import BenchCommand, record

OUTCOMES_FILE = "sequential.jsonl"

FURTHER_ROUNDS, BENCH_TIME = 3, 120.0
"""Most rounds after the first recordings, and most bench time in s with them."""

RANDOM_STREAM = 8
"""Number of the random stream, beside those of a plant's design, that gives its random experiments."""

POLICIES = ("advised", "random", "fixed")

Commands = Iterator[tuple[str, BenchCommand]]


class EnoughRecordedError(Exception):
    """There is nothing more to record."""


@dataclass
class SimulatedBench:
    """A plant with its effects on a bench that records one run after the other.

    From the second round on, it records ``others`` in place of what it is asked for, where there are some.
    """

    session: BenchSession
    effects: Effects
    size: Size
    others: Commands | None = None
    recorded: list[tuple[str, BenchCommand]] = field(default_factory=list)

    def record(self, named: Sequence[tuple[str, BenchCommand]]) -> list[Run]:
        """Record commands at the reference size; heat and the like carry over from what was recorded before."""
        self.recorded += named
        plant = replace(self.session.plant, effects=self.effects)
        rng = np.random.default_rng(self.session.noise_seed)
        readings = record(plant, [given for _, given in self.recorded], self.session.instruments, rng)
        runs = [as_run(name, of_run) for (name, _), of_run in zip(self.recorded, readings, strict=True)]
        return [self.size.scaled(run) for run in runs[-len(named) :]]

    @property
    def duration(self) -> float:
        """Bench time in s of what was recorded."""
        return sum(len(given.time) * given.step for _, given in self.recorded)

    def record_round(self, number: int, plans: Sequence[Plan]) -> list[Run]:
        """Record plans at the size of the plant, or other commands that take as long."""
        if number > 1 + FURTHER_ROUNDS:
            raise EnoughRecordedError
        if number > 1 and self.others is not None:
            return self.record(_within(self.others, sum(planned.duration for planned in plans)))
        return self.record([(planned.experiment.name, at_reference(command(planned), self.size)) for planned in plans])


def run_sequential_trial(
    folder: Path,
    answers: Mapping[str, GroundTruth],
    output: Path,
    *,
    most: int | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] = ignore,
) -> dict[str, SequentialOutcome]:
    """Diagnose the plants of a trial with rich excitation sequentially; outcomes that ``output`` holds already are kept.

    Parameters
    ----------
    folder : Path
        Folder of the trial, for its recipe; the recordings in it are not used.
    answers : mapping
        By plant.
    output : Path
        Folder that gets `OUTCOMES_FILE`.
    most : int, optional
        Largest number of plants.
    workers : int
        Number of processes.
    progress : callable
        Called with the number of finished plants and of all plants.

    Raises
    ------
    InputError
        When ``output`` holds outcomes of another diagnoser or on another trial, or the trial's recordings have changed.
    """
    trial = read_trial(folder)
    designs = {design.plant: design for design in design_trial(trial.recipe)[0]}
    plants = {plant.plant: plant for plant in [plant for plant in trial.plants if plant.excitation == "rich"][:most]}
    reserve_folder(installed_diagnoser(), output)
    path = output / OUTCOMES_FILE
    require_same_trial(read_records(SequentialOutcome, path), plants.values(), path)

    def work(missing: Sequence[str]) -> Iterator[SequentialOutcome]:
        pieces = [(plants[name], designs[name], answers[name]) for name in missing]
        return run_in_processes(diagnose_by_policies, pieces, workers)

    return complete_records(SequentialOutcome, path, list(plants), work, progress)


def diagnose_by_policies(plant: PublicPlant, design: PlantDesign, truth: GroundTruth) -> SequentialOutcome:
    """Diagnose a plant after the first recordings and, where these do not name its causes, after those of each way."""
    session = BenchSession.from_design(design)
    rng = np.random.default_rng([*design.seed, RANDOM_STREAM])
    drawn = (given for given in (random_command(rng) for _ in itertools.count()) if given is not None)
    random = ((f"random_{number}", given) for number, given in enumerate(drawn, 1))
    fixed = iter(commands_of_runs(Tier("rich", session.rate), np.random.default_rng(0)))
    answers: list[PolicyAnswer] = []
    for policy, others in zip(POLICIES, (None, random, fixed), strict=True):
        rounds = _diagnose_rounds(SimulatedBench(session, truth.effects, plant.size, others), plant, truth.causes, policy)
        answers = answers or [replace(rounds[0], policy="first", ending="")]
        if _are_named(truth.causes, rounds[0]):
            break
        answers.append(rounds[-1])
        if len(rounds) == 1:  # the other ways would end there as well
            answers += [replace(rounds[0], policy=other) for other in POLICIES[1:]]
            break
    return SequentialOutcome(
        truth.plant, truth.causes, truth.implied, truth.signal_to_floor, plant.commitment, tuple(answers)
    )


def _diagnose_rounds(bench: SimulatedBench, plant: PublicPlant, causes: Sequence[str], policy: str) -> list[PolicyAnswer]:
    """Return the answer after each round, the first one alone if it names the causes; an error is the last answer."""
    answers: list[PolicyAnswer] = []

    def answer(said: Submission) -> None:
        named = tuple(claim.effects[0] for claim in said.causes if claim.level == "effect")
        classes = tuple(tuple(members_of(claim)) for claim in said.causes)
        answers.append(
            PolicyAnswer(policy, said.verdict, named, classes, len(bench.recorded), bench.duration, failure=said.failure)
        )

    def on_round(of_round: Any) -> None:
        answer(submission_of(plant, of_round.diagnosis))
        if len(answers) == 1 and _are_named(causes, answers[0]):
            raise EnoughRecordedError

    try:
        ending: str = diagnose_sequentially(
            bench.record_round, plant.model, bench=plant.size.bench, budget=BENCH_TIME, on_round=on_round
        ).ending
    except EnoughRecordedError:
        ending = "budget"
    except Exception as error:  # every error counts as a failure of the diagnosis
        answer(failed_submission(plant, error))
        ending = "failed"
    return [*answers[:-1], replace(answers[-1], ending=ending)]


def _are_named(causes: Sequence[str], answer: PolicyAnswer) -> bool:
    """Whether all causes are named by themselves; never on a plant without one."""
    return bool(causes) and set(causes) <= set(answer.effects)


def policy_table(outcomes: Sequence[SequentialOutcome]) -> str:
    """Return tables in Markdown: how often each way names the causes that the first recordings leave open, and how it ends.

    As in `mrd_trials.scoring.classes.ClassRates`, what a damper's form contains is not wrong to name, and a failed diagnosis
    is wrong.
    """
    left_open = [outcome for outcome in outcomes if outcome.causes and len(outcome.answers) > 1]
    detectable = [outcome for outcome in left_open if outcome.signal_to_floor > DETECTABLE]
    gone_on = [outcome for outcome in detectable if outcome.answers[1].recordings > outcome.answers[0].recordings]
    groups = {
        "all": (outcomes, ("first",)),
        "left open by the first recordings": (left_open, ("first", *POLICIES)),
        "of these, detectable": (detectable, ("first", *POLICIES)),
        "of these, more was recorded": (gone_on, ("first", *POLICIES)),
        "without a cause of the catalogue": ([outcome for outcome in outcomes if not outcome.causes], ("first", *POLICIES)),
    }
    rows = ["| plants | recordings | number | causes named | classes named | something wrong named | failed | bench time |"]
    rows.append("|" + "---|" * 8)
    for label, (chosen, policies) in groups.items():
        for policy in policies:
            pairs = [(outcome, answer) for outcome in chosen for answer in outcome.answers if answer.policy == policy]
            with_cause = [(outcome, answer) for outcome, answer in pairs if outcome.causes]
            cells = [
                str(len(pairs)),
                text(Rate.from_outcomes([_are_named(outcome.causes, answer) for outcome, answer in with_cause])),
                text(Rate.from_outcomes([_has_classes(outcome.causes, answer) for outcome, answer in with_cause])),
                text(Rate.from_outcomes([_is_wrong(outcome, answer) for outcome, answer in pairs])),
                str(sum(answer.verdict == "failed" for _, answer in pairs)),
                f"{np.median([answer.duration for _, answer in pairs]):.0f} s" if pairs else "–",
            ]
            rows.append(f"| {label} | {policy} | {' | '.join(cells)} |")
    rows += ["", "| left open, recordings | ending | plants | causes named | something wrong named |", "|" + "---|" * 5]
    for policy in POLICIES:
        pairs = [(outcome, answer) for outcome in left_open for answer in outcome.answers if answer.policy == policy]
        for ending in sorted({answer.ending for _, answer in pairs}):
            ended = [(outcome, answer) for outcome, answer in pairs if answer.ending == ending]
            named = text(Rate.from_outcomes([_are_named(outcome.causes, answer) for outcome, answer in ended]))
            wrong = text(Rate.from_outcomes([_is_wrong(outcome, answer) for outcome, answer in ended]))
            rows.append(f"| {policy} | {ending} | {len(ended)} | {named} | {wrong} |")
    return "\n".join(rows)


def _has_classes(causes: Sequence[str], answer: PolicyAnswer) -> bool:
    return all(any(cause in members for members in answer.classes) for cause in causes)


def _is_wrong(outcome: SequentialOutcome, answer: PolicyAnswer) -> bool:
    not_wrong = {*outcome.causes, *outcome.implied}
    return answer.verdict == "failed" or any(not_wrong.isdisjoint(members) for members in answer.classes)


def _within(commands: Commands, seconds: float) -> list[tuple[str, BenchCommand]]:
    """Return the next commands, the last of them cut off, that take some time in s together."""
    chosen = []
    for name, given in commands:
        count = int(seconds / given.step)
        chosen.append((name, BenchCommand(given.time[:count], given.position[:count], given.current[:count])))
        seconds -= len(given.time) * given.step
        if seconds < 1.0:
            break
    return chosen
