"""Diagnosing a trial: continued, on a cluster, by one diagnoser."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster

from mrd_base import InputError
from mrd_trials import run
from mrd_trials.bench_session import as_run
from mrd_trials.cli.score import work
from mrd_trials.evaluate import DiagnosedPlant, evaluate_plant
from mrd_trials.excitation import Tier
from mrd_trials.records import GroundTruth, Submission, to_json
from mrd_trials.run import VERDICTS_FILE, run_trial
from mrd_trials.submission import DIAGNOSER_FILE, diagnose_plant, installed_diagnoser
from mrd_trials.trial_design import PlantDesign, Recipe
from mrd_trials.trial_folder import PublicPlant, PublicTrial, read_given_runs, read_trial, write_recordings, write_trial
from mrd_trials.truth import BenchCommand, TrueInstruments, TruePlant, record

DIAGNOSER = installed_diagnoser()


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    """A trial of two plants with two short runs each, quickly diagnosed."""
    folder = tmp_path_factory.mktemp("trial")
    time = np.arange(3 * 8000) / 8000
    commands = [BenchCommand(time, 0.01 * np.sin(2 * np.pi * time), np.full_like(time, level)) for level in (0.0, 0.2)]
    names = ["first", "second", "fresh_1", "fresh_2"]
    plants = []
    for number, effects in enumerate([{}, {"moving_mass": {"mass": 1.5, "frequency": 100.0, "damping": 0.3}}], 1):
        plant = TruePlant("bouc_wen", {}, effects)
        readings = record(plant, commands * 2, TrueInstruments(100.0), np.random.default_rng(number))
        files = write_recordings(folder, f"p000{number}", [as_run(*named) for named in zip(names, readings, strict=True)])
        plants.append(PublicPlant(f"p000{number}", "bouc_wen", "sine", 100.0, files, f"commitment {number}"))
    write_trial(PublicTrial(Recipe(1, {"sine@100": 2}), tuple(plants)), folder)
    return folder


@pytest.fixture(scope="module")
def verdicts(trial, tmp_path_factory):
    """Verdicts of an uninterrupted run."""
    return timeless(run_trial(trial, tmp_path_factory.mktemp("verdicts"), DIAGNOSER))


def timeless(submissions):
    return {plant: to_json(replace(submission, elapsed=0.0)) for plant, submission in submissions.items()}


def test_plants_are_diagnosed(verdicts):
    assert list(verdicts) == ["p0001", "p0002"]
    assert not any('"verdict":"failed"' in line for line in verdicts.values())


def test_an_interrupted_run_is_continued(trial, verdicts, tmp_path):
    def progress(done, _total):
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_trial(trial, tmp_path, DIAGNOSER, progress=progress)
    with (tmp_path / VERDICTS_FILE).open("a") as stream:
        stream.write('{"plant": "p00')  # in the middle of a line
    shown = []
    submissions = run_trial(trial, tmp_path, DIAGNOSER, progress=lambda *counts: shown.append(counts))
    assert shown == [(1, 2), (2, 2)]
    assert timeless(submissions) == verdicts
    assert len((tmp_path / VERDICTS_FILE).read_text().splitlines()) == 2
    # Verdicts that exist are kept.
    content = (tmp_path / VERDICTS_FILE).read_text()
    run_trial(trial, tmp_path, DIAGNOSER)
    assert (tmp_path / VERDICTS_FILE).read_text() == content


def test_every_plant_is_diagnosed_around_a_model_that_is_asked_for(trial, tmp_path, monkeypatch):
    models = []

    def method(runs, model, *, effects, bench, seed):
        models.append(model)
        raise ValueError("not diagnosed")

    run_trial(trial, tmp_path / "own", DIAGNOSER, method=method)
    run_trial(trial, tmp_path / "asked", replace(DIAGNOSER, model="sigmoid"), method=method)
    assert models == ["bouc_wen", "bouc_wen", "sigmoid", "sigmoid"]
    for other, by in ((DIAGNOSER, method), (replace(DIAGNOSER, model="sigmoid"), refuse_nothing)):
        with pytest.raises(InputError, match="holds verdicts of another diagnoser"):
            run_trial(trial, tmp_path / "asked", other, method=by)
    monkeypatch.setattr("sys.argv", ["score", str(trial), str(tmp_path / "asked")])
    with pytest.raises(InputError, match=r"asked: holds verdicts around sigmoid, .*name such a folder after --around"):
        work()
    monkeypatch.setattr("sys.argv", ["score", str(trial), str(tmp_path / "own"), "--around", str(tmp_path / "nothing")])
    with pytest.raises(InputError, match="nothing: holds no verdicts"):
        work()


def test_verdicts_of_another_diagnoser_are_kept(trial, tmp_path):
    (tmp_path / DIAGNOSER_FILE).write_text("{}")
    with pytest.raises(InputError, match="holds verdicts of another diagnoser"):
        run_trial(trial, tmp_path, DIAGNOSER)
    assert not (tmp_path / VERDICTS_FILE).exists()


def test_verdicts_on_another_trial_are_kept(trial, verdicts, tmp_path):
    lines = [line.replace('"commitment":"', '"commitment":"0') for line in verdicts.values()]
    (tmp_path / VERDICTS_FILE).write_text("".join(f"{line}\n" for line in lines))
    with pytest.raises(InputError, match="the verdict on p0001 is on a plant of another trial"):
        run_trial(trial, tmp_path, DIAGNOSER)
    assert (tmp_path / VERDICTS_FILE).read_text().splitlines() == lines


def test_without_verdicts_the_answers_stay_sealed(trial, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["score", str(trial), str(tmp_path), "--answers", "nowhere.jsonl"])
    with pytest.raises(InputError, match="holds no verdicts, so the answers stay sealed"):
        work()


def test_an_error_is_a_failed_submission(trial):
    plant = replace(read_trial(trial).plants[0], model="ghost")
    submission = diagnose_plant(plant, read_given_runs(trial, plant))
    assert submission.verdict == "failed"
    assert submission.failure.startswith("InputError: ")
    assert submission.commitment == plant.commitment


@pytest.mark.parametrize("scheduler", ["", "tcp://nobody:1"])
def test_recordings_that_are_refused_fail_their_plant_alone(trial, tmp_path, monkeypatch, scheduler):
    copy = tmp_path / "trial"
    shutil.copytree(trial, copy)
    broken, other = read_trial(copy).plants
    (copy / broken.runs[0]).write_text("time_s,position_m,current_A,force_N\n0,0,0,0\n", encoding="utf-8")
    monkeypatch.setattr(run, "run_on_cluster", lambda _, work, pieces: [work(*piece) for piece in pieces])
    submissions = run_trial(copy, tmp_path / "verdicts", DIAGNOSER, method=refuse_nothing, scheduler=scheduler)
    assert submissions[broken.plant].failure.startswith(f"InputError: {copy / broken.runs[0]}")
    assert submissions[other.plant].failure == "RuntimeError: 2 runs were read"


def refuse_nothing(runs, model, *, effects, bench, seed, reference=(), simulator=None):
    raise RuntimeError(f"{len(runs)} runs were read")


def test_a_failed_diagnosis_is_not_repeated_by_the_evaluation():
    truth = GroundTruth(
        "p0001", "null", "bouc_wen", "bouc_wen", False, (), {}, {}, {}, (), {}, 0.0, "", "rich", 500.0, 1, "00"
    )
    plant = DiagnosedPlant(
        Path("nowhere"),
        PlantDesign("p0001", "null", Tier("rich", 500.0), (1, 1), "bouc_wen", (), ()),
        "",
        PublicPlant("p0001", "bouc_wen", "rich", 500.0, ("nowhere.csv",), ""),
        truth,
        Submission("p0001", "failed", "ValueError: no reason"),
    )
    assert evaluate_plant(plant).rankings == {}


def test_a_cluster_gives_the_same_verdicts(trial, verdicts, tmp_path):
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1") as cluster:
        assert timeless(run_trial(trial, tmp_path, DIAGNOSER, scheduler=cluster.scheduler_address)) == verdicts
