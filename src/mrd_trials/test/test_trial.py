"""A small trial from plants to score: fails where the diagnosis has become worse."""

import os

import pytest

from mrd_trials.insight import insights
from mrd_trials.make import Recipe, make, read_trial
from mrd_trials.run import VERDICTS, frozen, run
from mrd_trials.score import score
from mrd_trials.score_report import write_score_report
from mrd_trials.seal import unseal
from mrd_trials.tables import tables

RECIPE = Recipe(30, {"rich@250": 12})
"""Three nulls, five plants with one effect, two with two, two with an effect that the catalogue has not."""

RIGHT = 6
"""Of nine causes: as many as are named, less a margin of one."""


@pytest.mark.timeout(900)
def test_a_small_trial_is_judged_no_worse_than_it_was(tmp_path):
    folder, path, verdicts = tmp_path / "trial", tmp_path / "answers.jsonl", tmp_path / "verdicts"
    workers = os.cpu_count() or 1
    make(RECIPE, folder, path, workers)
    said = run(folder, verdicts, frozen(), workers=workers)
    answers = unseal(path, {exhibit.plant: exhibit.commitment for exhibit in read_trial(folder).exhibits})
    assert [each.failure for each in said.values() if each.failure] == []
    named = {plant: {cause.effects[0] for cause in each.causes} for plant, each in said.items()}
    found = {plant: (tuple(answers[plant].effects), said[plant].verdict, sorted(named[plant])) for plant in said}
    assert sum(len(answer.causes) for answer in answers.values()) == 9
    assert sum(len(named[plant] & set(answers[plant].causes)) for plant in said) >= RIGHT, found
    assert [plant for plant, answer in answers.items() if not answer.causes and named[plant]] == [], found

    # Those whose oracle is soon asked.
    few = {plant: said[plant] for plant in sorted(said)[:2]}
    scored = score({plant: answers[plant] for plant in few}, few, insights(folder, answers, few, verdicts))
    assert "Goals" in tables(scored)
    assert write_score_report(scored, verdicts).stat().st_size > 10_000
    # Verdicts that stand are kept.
    before = (verdicts / VERDICTS).read_text(encoding="utf-8")
    run(folder, verdicts, frozen())
    assert (verdicts / VERDICTS).read_text(encoding="utf-8") == before
