"""A small trial from plants to score: fails where the diagnosis has become worse."""

import os

import pytest

from mrd_trials.commitments import open_answers
from mrd_trials.evaluate import evaluate_trial
from mrd_trials.make import make_trial
from mrd_trials.run import run_trial
from mrd_trials.scoring.report import write_score_report
from mrd_trials.scoring.score import score_trial
from mrd_trials.scoring.tables import markdown_tables
from mrd_trials.submission import installed_diagnoser
from mrd_trials.trial_design import Recipe
from mrd_trials.trial_folder import read_trial

RECIPE = Recipe(31, {"rich@100": 6}, sizes="reference", starts="rest")
"""Two null plants, two with one effect, one with two effects, one with an effect that the catalogue lacks; two dampers have
another form than the fitted model. None has mains hum, so the rate may be low."""

LEAST_NAMED = 2
"""Of four causes; not all of them are strong."""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_verdicts_on_a_small_trial_are_no_worse_than_before(tmp_path):
    folder, path, output = tmp_path / "trial", tmp_path / "answers.jsonl", tmp_path / "verdicts"
    workers = os.cpu_count() or 1
    make_trial(RECIPE, folder, path, workers)
    submissions = run_trial(folder, output, installed_diagnoser(), workers=workers)
    answers = open_answers(path, read_trial(folder).commitments)
    assert [submission.failure for submission in submissions.values() if submission.failure] == []
    named = {plant: {cause.effects[0] for cause in submission.causes} for plant, submission in submissions.items()}
    summary = {plant: (tuple(answers[plant].effects), submissions[plant].verdict, named[plant]) for plant in answers}
    assert sum(len(truth.causes) for truth in answers.values()) == 4
    assert sum(len(named[plant] & set(truth.causes)) for plant, truth in answers.items()) >= LEAST_NAMED, summary
    assert [plant for plant, truth in answers.items() if not truth.causes and named[plant]] == [], summary

    right = [plant for plant in sorted(submissions) if named[plant] & set(answers[plant].causes)]
    few = {plant: submissions[plant] for plant in right[:2]}
    score = score_trial({plant: answers[plant] for plant in few}, few, evaluate_trial(folder, answers, few, output))
    rich = score.tiers["rich"]
    assert rich.relative_closure.median > 0.9
    assert rich.maps.overlap.median > 0.6
    assert "Goals" in markdown_tables(score)
    assert write_score_report(score, output).stat().st_size > 10_000
