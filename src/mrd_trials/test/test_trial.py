"""A small trial from plants to score: fails where the diagnosis has become worse, or where two runs of it differ."""

import os

import pytest

from mrd_trials.make import Recipe, make, read_trial
from mrd_trials.run import frozen, run
from mrd_trials.seal import unseal

RECIPE = Recipe(20, {"rich@250": 12})
"""Three nulls, five single effects, two pairs, two effects that the catalogue has not."""


@pytest.mark.timeout(900)
def test_a_small_trial_is_not_judged_worse_than_it_was(tmp_path):
    folder, answers = tmp_path / "trial", tmp_path / "answers.jsonl"
    workers = os.cpu_count() or 1
    make(RECIPE, folder, answers, workers)
    diagnoser = frozen(peers=False)
    submissions = run(folder, tmp_path / "verdicts", diagnoser, workers=workers)
    known = unseal(answers, {exhibit.plant: exhibit.commitment for exhibit in read_trial(folder).exhibits})
    assert [said.failure for said in submissions.values() if said.failure] == []
    right = wrong = 0
    for plant, said in submissions.items():
        named = {cause.effects[0] for cause in said.causes}
        right += len(named & set(known[plant].causes))
        wrong += len(named - set(known[plant].causes))
    wanted = sum(len(answer.causes) for answer in known.values())
    assert wanted == 9
    assert (right, wrong) >= (RIGHT, 0), {plant: (known[plant].effects, said.causes) for plant, said in submissions.items()}
    assert wrong <= WRONG


RIGHT, WRONG = 0, 0
