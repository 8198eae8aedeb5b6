"""Diagnosing a trial: continued, on a cluster, by one diagnoser."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from distributed import LocalCluster

from mrd_base import InputError
from mrd_trials import evaluate, run
from mrd_trials.bench_session import as_run
from mrd_trials.cli.score import work
from mrd_trials.evaluate import DiagnosedPlant
from mrd_trials.excitation import Tier
from mrd_trials.records import Evaluation, Explanation, GroundTruth, Submission, to_json
from mrd_trials.run import VERDICTS_FILE, run_trial
from mrd_trials.submission import DIAGNOSER_FILE, diagnose_plant, installed_diagnoser, reserve_folder
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
    monkeypatch.setattr(
        "sys.argv", ["score", str(trial), str(tmp_path / "own"), "--around", *2 * [str(tmp_path / "nothing")]]
    )
    with pytest.raises(InputError, match="nothing: holds no verdicts"):
        work()
    monkeypatch.setattr("sys.argv", ["score", str(trial), str(tmp_path / "own"), "--around", str(tmp_path / "asked")])
    with pytest.raises(InputError, match="asked: found one folder, expected those of two models or more"):
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


def rich_plant(folder, kind, submission):
    """A plant of rich excitation with its submission; its recordings are those of the first plant of the trial."""
    causes = {"single": ("moving_mass",)}.get(kind, ())
    effects, strength = {cause: {} for cause in causes}, 20.0 * len(causes)
    truth = GroundTruth(
        "p0001", kind, "bouc_wen", "bouc_wen", False, (), {}, effects, {}, causes, {}, strength, "", "rich", 100.0, 1, "00"
    )
    size = {"force": 1.0, "motion": 1.0, "current": 1.0}
    design = PlantDesign("p0001", kind, Tier("rich", 100.0), (1, 1), "bouc_wen", (), ())
    public = read_trial(folder).plants[0]
    return DiagnosedPlant(folder, design, "", public, replace(truth, size=size), submission, seed=7)


@pytest.fixture
def unrendered(monkeypatch):
    """No plant is rendered once more, which takes long."""
    monkeypatch.setattr(evaluate.BenchSession, "from_design", lambda *_: None)


@pytest.mark.parametrize("verdict", ["failed", "data_fault"])
@pytest.mark.usefixtures("unrendered")
def test_baseline_methods_run_whatever_the_verdict(trial, monkeypatch, verdict):
    plant = rich_plant(trial, "null", Submission("p0001", verdict))
    monkeypatch.setattr(evaluate, "run_baseline_methods", lambda runs, model: {"bic": (model, str(len(runs)))})
    assert evaluate.evaluate_plant(plant).rankings == {"bic": ("bouc_wen", "2")}


@pytest.mark.usefixtures("unrendered")
def test_what_fails_the_diagnosis_may_fail_the_baseline_methods(trial, monkeypatch):
    def fails(runs, model):
        raise ValueError("no reason")

    monkeypatch.setattr(evaluate, "run_baseline_methods", fails)
    plant = rich_plant(trial, "null", Submission("p0001", "failed"))
    assert evaluate.evaluate_plant(plant).rankings == {}
    with pytest.raises(ValueError, match="no reason"):
        evaluate.evaluate_plant(replace(plant, submission=Submission("p0001", "no_gap")))
    refused = replace(plant.public, runs=("nowhere.csv",))
    assert evaluate.evaluate_plant(replace(plant, public=refused)).rankings == {}


@pytest.mark.usefixtures("unrendered")
def test_closure_is_measured_alike_for_the_oracle_and_the_submission(trial, monkeypatch):
    seeds = []

    def oracle(plant, runs, seed, effects):
        seeds.append(seed)
        return Submission("p0001", "explained", effects=("oracle",))

    meter = SimpleNamespace(
        on_given_runs=lambda effects, parameters: {"oracle": 0.9, "mine": 0.6}[effects[0]],
        on_fresh_runs=lambda effects, parameters: 0.5,
    )
    monkeypatch.setattr(evaluate, "run_baseline_methods", lambda runs, model: {})
    monkeypatch.setattr(evaluate, "diagnose_plant", oracle)
    monkeypatch.setattr(evaluate.ClosureMeter, "from_session", lambda *_: meter)
    named = (Explanation(("mine",), 0.9, (0.95, 0.9, 1.0)),)
    plant = rich_plant(trial, "single", Submission("p0001", "explained", causes=named, effects=("mine",)))
    found = evaluate.evaluate_plant(plant)
    assert (found.oracle_closure, found.closure, found.fresh_closure) == (0.9, 0.6, 0.5)
    unnamed = replace(plant, submission=replace(plant.submission, causes=()))
    assert evaluate.evaluate_plant(unnamed).closure == 0.0
    assert seeds == [7, 7]


def test_simulated_plants_are_evaluated_by_the_diagnoser_of_the_verdicts(trial, tmp_path, monkeypatch):
    of_plant = rich_plant(trial, "null", Submission("p0001", "no_gap"))
    answers = {plant: replace(of_plant.truth, plant=plant) for plant in ("p0001", "p0002")}
    submissions = {"p0001": of_plant.submission}
    seeds = []

    def empty(plant):
        seeds.append(plant.seed)
        return Evaluation(plant.truth.plant, plant.digest)

    monkeypatch.setattr(evaluate, "evaluate_plant", empty)
    with pytest.raises(InputError, match="does not tell whose verdicts these are"):
        evaluate.evaluate_trial(trial, answers, submissions, tmp_path)
    reserve_folder(replace(DIAGNOSER, seed=5, version="older"), tmp_path)
    assert list(evaluate.evaluate_trial(trial, answers, submissions, tmp_path)) == ["p0001"]
    assert seeds == [5]
    other = json.dumps(vars(DIAGNOSER) | {"code": "0"})
    (tmp_path / DIAGNOSER_FILE).write_text(other, encoding="utf-8")
    assert list(evaluate.evaluate_trial(trial, answers, submissions, tmp_path)) == ["p0001"]  # nothing is to be done
    with pytest.raises(InputError, match="holds verdicts of another diagnoser"):
        evaluate.evaluate_trial(trial, answers, {"p0001": Submission("p0001", "explained")}, tmp_path)


def test_a_cluster_gives_the_same_verdicts(trial, verdicts, tmp_path):
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1") as cluster:
        assert timeless(run_trial(trial, tmp_path, DIAGNOSER, scheduler=cluster.scheduler_address)) == verdicts
