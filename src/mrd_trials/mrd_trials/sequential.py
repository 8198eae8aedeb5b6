"""Trial of the sequential diagnosis: does the recording that it chooses name a cause that the first recordings leave open?

Three ways to go on after the first recordings are compared at the same bench time: the recordings that the diagnosis
chooses, random ones, and a fixed set in its order.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mrd_base.progress import ignore
from mrd_diagnosis import Diagnosis, diagnose, diagnose_sequentially, first_set
from mrd_runs import Run
from mrd_trajectory.plan import Plan
from mrd_trials.bench_session import BenchSession, Effects, as_run
from mrd_trials.excitation import Tier, at_reference, command, commands_of_runs, random_command
from mrd_trials.parallel import run_in_processes
from mrd_trials.records import GroundTruth, PolicyAnswer, SequentialOutcome, complete_records
from mrd_trials.scoring.rates import Rate
from mrd_trials.scoring.tables import text
from mrd_trials.size import REFERENCE, Size
from mrd_trials.trial_design import PlantDesign, design_trial
from mrd_trials.trial_folder import read_trial
from mrd_trials.truth import BenchCommand, record

OUTCOMES_FILE = "sequential.jsonl"

FURTHER = 45.0
"""Bench time in s after the first recordings: three of the experiments that a diagnosis advises."""

RANDOM_STREAM = 8
"""Number of the random stream, beside those of a plant's design, that gives its random experiments."""


@dataclass
class SimulatedBench:
    """A plant with its effects on a bench that records what it is asked for, one run after the other."""

    session: BenchSession
    effects: Effects
    size: Size
    recorded: list[tuple[str, BenchCommand]] = field(default_factory=list)

    def record(self, named: Sequence[tuple[str, BenchCommand]]) -> list[Run]:
        """Record commands at the reference size; heat and the like carry over from what was recorded before."""
        self.recorded += named
        plant = replace(self.session.plant, effects=self.effects)
        rng = np.random.default_rng(self.session.noise_seed)
        readings = record(plant, [given for _, given in self.recorded], self.session.instruments, rng)
        runs = [as_run(name, of_run) for (name, _), of_run in zip(self.recorded, readings, strict=True)]
        return [self.size.scaled(run) for run in runs[-len(named) :]]

    def record_plans(self, _round: int, plans: Sequence[Plan]) -> list[Run]:
        """Record plans at the size of the plant."""
        return self.record([(planned.experiment.name, at_reference(command(planned), self.size)) for planned in plans])


def run_sequential_trial(
    folder: Path,
    answers: Mapping[str, GroundTruth],
    output: Path,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] = ignore,
) -> dict[str, SequentialOutcome]:
    """Diagnose the plants of a trial with one known cause sequentially; outcomes that ``output`` holds already are kept.

    Parameters
    ----------
    folder : Path
        Folder of the trial, for its recipe; the recordings in it are not used.
    answers : mapping
        By plant.
    output : Path
        Folder that gets `OUTCOMES_FILE`.
    workers : int
        Number of processes.
    progress : callable
        Called with the number of finished plants and of all plants.
    """
    designs = {design.plant: design for design in design_trial(read_trial(folder).recipe)[0]}
    names = [name for name, truth in answers.items() if truth.kind == "single" and truth.excitation == "rich"]
    output.mkdir(parents=True, exist_ok=True)

    def work(missing: Sequence[str]) -> Iterator[SequentialOutcome]:
        return run_in_processes(diagnose_by_policies, [(designs[name], answers[name]) for name in missing], workers)

    return complete_records(SequentialOutcome, output / OUTCOMES_FILE, names, work, progress)


def diagnose_by_policies(design: PlantDesign, truth: GroundTruth) -> SequentialOutcome:
    """Diagnose one plant after the first recordings and, where these leave the cause open, after those of each way."""
    session, size = BenchSession.from_design(design), Size(**truth.size) if truth.size else REFERENCE
    bench = size.bench
    first = SimulatedBench(session, truth.effects, size)
    plans = first_set(bench)
    needed = sum(planned.duration for planned in plans)
    advised = diagnose_sequentially(first.record_plans, truth.model, bench=bench, budget=needed + FURTHER)
    at_first = _answer("first", advised.rounds[0].diagnosis, len(plans), needed)
    outcome = SequentialOutcome(truth.plant, truth.causes, truth.signal_to_floor, (at_first,))
    if len(advised.rounds) == 1:
        return outcome
    answers = [_answer("advised", advised.diagnosis, len(first.recorded), advised.duration, advised.ending)]
    rng = np.random.default_rng([*design.seed, RANDOM_STREAM])
    drawn = (given for given in (random_command(rng) for _ in itertools.count()) if given is not None)
    random = ((f"random_{number}", given) for number, given in enumerate(drawn, 1))
    fixed = iter(commands_of_runs(Tier("rich", session.rate), np.random.default_rng(0)))
    for policy, commands in (("random", random), ("fixed", fixed)):
        other = SimulatedBench(session, truth.effects, size)
        runs = other.record_plans(1, plans)
        runs += other.record(_within(commands, advised.duration - needed))
        diagnosis = diagnose(runs, truth.model, bench=bench)
        answers.append(_answer(policy, diagnosis, len(runs), sum(run.duration for run in runs)))
    return SequentialOutcome(truth.plant, truth.causes, truth.signal_to_floor, (at_first, *answers))


def policy_table(outcomes: Sequence[SequentialOutcome]) -> str:
    """Return a Markdown table: how often each way of going on names the cause that the first recordings leave open."""
    rows = [
        "| recordings | plants | cause named | class named | something wrong named | bench time |",
        "|---|---|---|---|---|---|",
    ]
    open_after_first = [outcome for outcome in outcomes if len(outcome.answers) > 1]
    groups = {"first, all plants": ("first", outcomes), "first": ("first", open_after_first)}
    groups |= {policy: (policy, open_after_first) for policy in ("advised", "random", "fixed")}
    for label, (policy, chosen) in groups.items():
        pairs = [(outcome, a) for outcome in chosen for a in outcome.answers if a.policy == policy]
        right = Rate.from_outcomes([bool(set(o.causes) & set(a.effects)) for o, a in pairs])
        of_class = Rate.from_outcomes([any(set(o.causes) & set(members) for members in a.classes) for o, a in pairs])
        wrong = Rate.from_outcomes([any(not set(o.causes) & set(members) for members in a.classes) for o, a in pairs])
        seconds = f"{np.median([a.duration for _, a in pairs]):.0f} s" if pairs else "–"
        rows.append(f"| {label} | {len(pairs)} | {text(right)} | {text(of_class)} | {text(wrong)} | {seconds} |")
    return "\n".join(rows)


def _within(commands: Iterator[tuple[str, BenchCommand]], seconds: float) -> list[tuple[str, BenchCommand]]:
    """Return the first commands, the last of them cut off, that take some time in s together."""
    chosen = []
    for name, given in commands:
        count = int(seconds / given.step)
        chosen.append((name, BenchCommand(given.time[:count], given.position[:count], given.current[:count])))
        seconds -= len(given.time) * given.step
        if seconds < 1.0:
            break
    return chosen


def _answer(policy: str, diagnosis: Diagnosis, recordings: int, duration: float, ending: str = "") -> PolicyAnswer:
    named = [cause for cause in diagnosis.causes if cause.level in ("effect", "class")]
    return PolicyAnswer(
        policy,
        diagnosis.verdict,
        tuple(cause.effect for cause in named if cause.level == "effect"),
        tuple(tuple(member.effect for member in cause.members) or (cause.effect,) for cause in named),
        recordings,
        duration,
        ending,
    )
