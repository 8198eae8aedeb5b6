"""The trial of the sequential diagnosis: three ways to go on, with the same looks, bench time and rule that ends them."""

import itertools
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_diagnosis import first_set
from mrd_trials import sequential
from mrd_trials.cli.sequential import work
from mrd_trials.excitation import commands_of_runs, parse_tier
from mrd_trials.records import Explanation, GroundTruth, PolicyAnswer, SequentialOutcome, Submission
from mrd_trials.sequential import diagnose_by_policies, policy_table, run_sequential_trial
from mrd_trials.size import REFERENCE
from mrd_trials.submission import DIAGNOSER_FILE
from mrd_trials.trial_design import PlantDesign, Recipe
from mrd_trials.trial_folder import PublicPlant, PublicTrial, write_trial

NAN = (float("nan"),) * 3
DESIGN = PlantDesign("p0001", "single", parse_tier("rich@500"), (1, 0, 1), "bouc_wen", ("backlash",), (5.0,))
PLANT = PublicPlant("p0001", "bouc_wen", "rich", 500.0, (), "commitment")


def truth(plant="p0001", causes=("backlash",), implied=()):
    effects = {cause: {} for cause in causes}
    numbers = {}, 5.0, "3-10", "rich", 500.0, 1, "00"
    return GroundTruth(plant, "single", "bouc_wen", "bouc_wen", False, implied, {}, effects, {}, causes, *numbers)


def claim(*members, level="effect"):
    return Explanation(members[:1], 0.9, NAN, level=level, members=members if level != "effect" else ())


@cache
def plans():
    return first_set(REFERENCE.bench)[:1]


@cache
def fixed_set():
    return commands_of_runs(DESIGN.tier, np.random.default_rng(0))


def outcome(monkeypatch, says):
    """Outcome of a diagnosis that says a claim after each round, or raises an error, or ends as its text says."""

    def loop(record, model, *, bench, budget, on_round):
        for number, said in enumerate(itertools.chain(says, itertools.repeat(says[-1])), 1):
            if isinstance(said, str):
                return SimpleNamespace(ending=said)
            record(number, plans())
            if isinstance(said, Exception):
                raise said
            on_round(SimpleNamespace(diagnosis=Submission("p0001", "ambiguous", causes=(said,))))
        return None

    def record(bench, named):
        bench.recorded += named
        return []

    monkeypatch.setattr(sequential, "diagnose_sequentially", loop)
    monkeypatch.setattr(sequential, "submission_of", lambda _, submission: submission)
    monkeypatch.setattr(sequential.SimulatedBench, "record", record)
    monkeypatch.setattr(sequential.BenchSession, "from_design", lambda _: SimpleNamespace(rate=500.0))
    monkeypatch.setattr(sequential, "commands_of_runs", lambda *_: fixed_set())
    return diagnose_by_policies(PLANT, DESIGN, truth(implied=("bypass_flow",)))


def test_all_ways_are_diagnosed_after_each_of_three_rounds(monkeypatch):
    tie = claim("joint_play", "backlash", level="class")
    found = outcome(monkeypatch, [tie])
    assert [answer.policy for answer in found.answers] == ["first", "advised", "random", "fixed"]
    assert [answer.recordings for answer in found.answers[:3]] == [1, 4, 4]
    first, *others = (answer.duration for answer in found.answers)
    assert others == pytest.approx([4 * first] * 3, abs=3.0)
    assert {answer.ending for answer in found.answers[1:]} == {"budget"}
    assert found.answers[1].classes == (("joint_play", "backlash"),)
    assert found.commitment == "commitment"


@pytest.mark.parametrize(
    ("says", "verdict", "ending", "recordings"),
    [
        ([claim("moving_mass"), "cause_known"], "ambiguous", "cause_known", 1),
        ([claim("moving_mass", level="stage"), RuntimeError("no reason")], "failed", "failed", 2),
        ([RuntimeError("no reason")], "failed", "failed", 1),
    ],
)
def test_a_wrong_name_and_an_error_count_wherever_they_come(monkeypatch, says, verdict, ending, recordings):
    found = outcome(monkeypatch, says)
    assert [answer.policy for answer in found.answers] == ["first", "advised", "random", "fixed"]
    for answer in found.answers[1:]:
        assert (answer.verdict, answer.ending, answer.recordings) == (verdict, ending, recordings)
        assert answer.failure == ("RuntimeError: no reason" if verdict == "failed" else "")
    table = policy_table([found])
    assert "| left open by the first recordings | advised | 1 | 0/1 = 0 % (0–98) | 0/1 = 0 % (0–98) | 1/1" in table
    assert f"| advised | {ending} | 1 | 0/1" in table


def test_a_plant_whose_cause_is_named_needs_no_further_recording(monkeypatch):
    found = outcome(monkeypatch, [claim("backlash")])
    assert [(answer.policy, answer.recordings) for answer in found.answers] == [("first", 1)]


def test_what_the_form_contains_is_not_wrong_and_a_stage_counts_by_its_members(monkeypatch):
    found = outcome(monkeypatch, [claim("bypass_flow"), claim("moving_mass", "backlash", level="stage")])
    line = next(
        line
        for line in policy_table([found]).splitlines()
        if line.startswith("| left open by the first recordings | random")
    )
    named, of_class, wrong, failed = (cell.strip()[:3] for cell in line.split("|")[4:8])
    assert (named, of_class, wrong, failed) == ("0/1", "1/1", "0/1", "0")


@pytest.fixture
def trial(tmp_path):
    plants = [
        PublicPlant(f"p{number}", "bouc_wen", excitation, 500.0, (), f"commitment {number}")
        for number, excitation in enumerate(["sine", "rich", "rich"])
    ]
    write_trial(PublicTrial(Recipe(1, {}), tuple(plants)), tmp_path)
    return tmp_path


def test_outcomes_are_continued_on_the_same_trial_by_the_same_diagnoser(trial, tmp_path, monkeypatch):
    def stand_in(plant, design, truth):
        return SequentialOutcome(
            plant.plant, (), (), 0.0, plant.commitment, (PolicyAnswer("first", "no_gap", (), (), 1, 1.0),)
        )

    monkeypatch.setattr(sequential, "diagnose_by_policies", stand_in)
    monkeypatch.setattr(
        sequential, "design_trial", lambda _: ([replace(DESIGN, plant=f"p{number}") for number in range(3)], [])
    )
    answers, output = {f"p{number}": truth(f"p{number}") for number in range(3)}, tmp_path / "outcomes"
    assert list(run_sequential_trial(trial, answers, output, most=1)) == ["p1"]  # of those with rich excitation
    assert list(run_sequential_trial(trial, answers, output)) == ["p1", "p2"]
    text = (output / "sequential.jsonl").read_text()
    (output / "sequential.jsonl").write_text(text.replace("commitment 2", "commitment 0"))
    with pytest.raises(InputError, match="the verdict on p2 is on a plant of another trial"):
        run_sequential_trial(trial, answers, output)
    (output / DIAGNOSER_FILE).write_text("{}")
    with pytest.raises(InputError, match="holds verdicts of another diagnoser"):
        run_sequential_trial(trial, answers, output)


@pytest.mark.parametrize("count", ["0", "-1"])
def test_a_number_of_plants_below_one_is_refused(tmp_path, monkeypatch, count):
    monkeypatch.setattr("sys.argv", ["sequential", str(tmp_path), "--output", str(tmp_path), "--plants", count])
    with pytest.raises(InputError, match=f"--plants is {count}, expected a whole number from 1"):
        work()
