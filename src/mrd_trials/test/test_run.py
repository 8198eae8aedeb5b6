"""Judging a trial: resumed, on a cluster, by one diagnoser."""

from dataclasses import replace

import pytest
from distributed import LocalCluster

from mrd_base import InputError
from mrd_trials.cli.score import work
from mrd_trials.insight import insight
from mrd_trials.make import Recipe, make, plan_trial, read_trial
from mrd_trials.records import Answer, Submission, read_records, to_json
from mrd_trials.run import FROZEN, VERDICTS, frozen, run

RECIPE = Recipe(4, {"paper@25": 2}, {"null": 0.5, "single": 0.5, "pair": 0.0, "absent": 0.0})
DIAGNOSER = frozen()


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trial")
    make(RECIPE, folder / "plants", folder / "answers.jsonl")
    return folder / "plants"


@pytest.fixture(scope="module")
def verdicts(trial, tmp_path_factory):
    """As they are found at one go."""
    return timeless(run(trial, tmp_path_factory.mktemp("verdicts"), DIAGNOSER))


def timeless(found):
    return {plant: to_json(replace(said, elapsed=0.0)) for plant, said in found.items()}


def test_an_interrupted_trial_goes_on(trial, verdicts, tmp_path):
    def progress(done, _of):
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(trial, tmp_path, DIAGNOSER, progress=progress)
    with (tmp_path / VERDICTS).open("a") as stream:
        stream.write('{"plant": "p00')  # in the middle of a line
    shown = []
    found = run(trial, tmp_path, DIAGNOSER, progress=lambda done, of: shown.append((done, of)))
    assert shown == [(1, 2), (2, 2)]
    assert timeless(found) == verdicts
    assert len((tmp_path / VERDICTS).read_text().splitlines()) == 2


def test_verdicts_of_another_diagnoser_are_kept(trial, tmp_path):
    (tmp_path / FROZEN).write_text("{}")
    with pytest.raises(InputError, match="holds verdicts of another diagnoser"):
        run(trial, tmp_path, DIAGNOSER)
    assert not (tmp_path / VERDICTS).exists()


def test_verdicts_of_another_trial_are_kept(trial, verdicts, tmp_path):
    lines = [line.replace('"commitment":"', '"commitment":"0') for line in verdicts.values()]
    (tmp_path / VERDICTS).write_text("".join(f"{line}\n" for line in lines))
    with pytest.raises(InputError, match="the verdict on p0001 is on a plant of another trial"):
        run(trial, tmp_path, DIAGNOSER)
    assert (tmp_path / VERDICTS).read_text().splitlines() == lines


def test_without_verdicts_the_answers_stay_sealed(trial, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["score", str(trial), str(tmp_path), "--answers", "nowhere.jsonl"])
    with pytest.raises(InputError, match="holds no verdicts, so the answers stay sealed"):
        work()


def test_what_failed_to_be_judged_is_not_asked_of_again(trial):
    order, (exhibit, *_) = plan_trial(RECIPE)[0][0], read_trial(trial).exhibits
    (answer, *_) = read_records(Answer, trial.parent / "answers.jsonl").values()
    said = Submission(exhibit.plant, "failed", "ValueError: of everything")
    assert insight(trial / "nowhere", RECIPE, order, exhibit, answer, said).rankings == {}


def test_a_cluster_judges_alike(trial, verdicts, tmp_path):
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster:
        assert timeless(run(trial, tmp_path, DIAGNOSER, scheduler=cluster.scheduler_address)) == verdicts
