"""Judging a trial: resumed, on a cluster, by one diagnoser."""

from dataclasses import replace

import pytest
from distributed import LocalCluster

from mrd_base import InputError
from mrd_trials.make import Recipe, make
from mrd_trials.records import to_json
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


def test_a_cluster_judges_alike(trial, verdicts, tmp_path):
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster:
        assert timeless(run(trial, tmp_path, DIAGNOSER, scheduler=cluster.scheduler_address)) == verdicts
