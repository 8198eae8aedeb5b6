"""Trials on measured recordings: what is untouched, what is altered, what is compared, and how it is scored.

Simulated dampers stand for the measured ones.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import read_runs
from mrd_trials import evaluate
from mrd_trials.commitments import open_answers
from mrd_trials.evaluate import evaluate_trial
from mrd_trials.excitation import BEFORE_AFTER, FRESH_RUNS, SEMIREAL
from mrd_trials.make import make_trial
from mrd_trials.recorded_session import split_runs
from mrd_trials.records import Evaluation, Explanation, GroundTruth, Submission, from_json
from mrd_trials.run import run_trial
from mrd_trials.scoring.rates import Rate
from mrd_trials.scoring.report import write_score_report
from mrd_trials.scoring.score import score_trial
from mrd_trials.scoring.tables import markdown_tables
from mrd_trials.size import Size, measured_size
from mrd_trials.submission import installed_diagnoser
from mrd_trials.trial_design import RECORDED_MODELS, Recipe, design_trial, is_detectable
from mrd_trials.trial_folder import read_fresh_runs, read_given_runs, read_reference_runs, read_trial
from mrd_trials.truth import ALTERATIONS, BenchCommand, TrueInstruments, TruePlant, record

SHARES = {"null": 0.5, "single": 0.5, "pair": 0.0, "absent": 0.0}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Folder of one damper with ten recordings, as a user would have it."""
    folder = tmp_path_factory.mktemp("recorded")
    t = np.arange(3 * 8000) / 8000
    commands = [
        BenchCommand(t, amplitude * np.sin(2 * np.pi * frequency * t), np.full_like(t, level), exact=True)
        for amplitude, frequency in ((0.012, 0.7), (0.008, 1.5))
        for level in (0.0, 0.1, 0.2, 0.3, 0.4)
    ]
    (folder / "press").mkdir()
    runs = record(TruePlant("dahl", {}), commands, TrueInstruments(100.0, False), np.random.default_rng(1))
    for place, run in enumerate(runs):
        columns = np.stack([run.time, run.position, run.current, run.force], axis=1)
        header = "time_s,position_m,current_A,force_N"
        np.savetxt(folder / "press" / f"run_{place}.csv", columns, delimiter=",", header=header, comments="")
    return folder


@pytest.fixture(scope="module")
def trial(recordings, tmp_path_factory):
    """A trial of four plants of each tier, with its answers."""
    folder = tmp_path_factory.mktemp("trial")
    path = folder.with_name("answers.jsonl")
    assert make_trial(Recipe(3, {SEMIREAL: 4, BEFORE_AFTER: 4}, SHARES, str(recordings)), folder, path) == []
    return folder, open_answers(path, read_trial(folder).commitments)


def originals(recordings, truth):
    """Return the recordings at the size of a plant, by name."""
    runs = read_runs([str(file) for file in sorted((recordings / "press").glob("*.csv"))])
    size = Size(**truth.size)
    return {run.name: size.scaled(measured_size(runs).inverse.scaled(run)) for run in runs}


def is_untouched(run, original, channel):
    """Whether a channel of a run is that of the original, of which the start may have been cut off."""
    values = getattr(original, channel)[-len(run) :]
    return np.allclose(getattr(run, channel), values, rtol=1e-6, atol=1e-6 * np.abs(values).max())


def name_of(run):
    """Name of a recording without the number that the trial has put before it."""
    return run.name.partition("_")[2]


def test_null_plants_are_untouched_and_the_others_are_not(trial, recordings):
    folder, answers = trial
    for plant in read_trial(folder).plants:
        truth = answers[plant.plant]
        known = originals(recordings, truth)
        runs = [*read_given_runs(folder, plant), *read_fresh_runs(folder, plant.plant)]
        assert len(runs) == 4 + FRESH_RUNS
        assert len({name_of(run) for run in runs}) == len(runs)
        channels = ("position", "current", "force")
        changed = [name for run in runs for name in channels if not is_untouched(run, known[name_of(run)], name)]
        assert truth.begins_in_motion == (len(runs[0]) < len(known[name_of(runs[0])]))
        assert bool(changed) == (truth.kind == "single"), truth
        assert truth.rate == pytest.approx(100.0, rel=1e-6)
        assert truth.effects.keys() <= set(ALTERATIONS)
        assert truth.effects.keys() == truth.formulas.keys()


def test_altered_plants_have_the_recordings_of_an_untouched_one(trial):
    folder, answers = trial
    plants = {plant.plant: plant for plant in read_trial(folder).plants}
    altered = [truth for truth in answers.values() if truth.kind == "single"]
    assert len(altered) == 4
    for truth in altered:
        background = answers[truth.background]
        assert background.kind == "null"
        assert background.model == truth.model
        assert background.excitation == truth.excitation
        assert (background.size, background.begins_in_motion) == (truth.size, truth.begins_in_motion)
        assert plants[truth.plant].runs != plants[truth.background].runs
        one, other = (
            [name_of(run) for run in read_given_runs(folder, plants[name])] for name in (truth.plant, truth.background)
        )
        # A comparison of the same runs has those of the reference; an untouched one always compares different runs.
        assert one == other or one == [name_of(run) for run in read_reference_runs(folder, plants[truth.plant])]
        assert truth.stratum in ("10-25 %", "25-50 %", "50-75 %")
        assert truth.signal_to_floor > 0.1
    assert {truth.model for truth in altered} == set(RECORDED_MODELS)
    assert all(not truth.background for truth in answers.values() if truth.kind == "null")


def test_what_is_compared_is_untouched_and_shares_no_run_but_for_half_of_the_altered_plants(trial, recordings):
    folder, answers = trial
    shared = []
    for plant in read_trial(folder).plants:
        before = read_reference_runs(folder, plant)
        assert bool(before) == (answers[plant.plant].excitation == BEFORE_AFTER)
        known = originals(recordings, answers[plant.plant])
        assert all(is_untouched(run, known[name_of(run)], "force") for run in before)
        if before:
            after = {name_of(run) for run in read_given_runs(folder, plant)}
            assert after == {name_of(run) for run in before} or after.isdisjoint(name_of(run) for run in before)
            shared.append((answers[plant.plant].kind, not after.isdisjoint(name_of(run) for run in before)))
    assert sorted(shared) == [("null", False), ("null", False), ("single", False), ("single", True)]


def test_halves_share_no_run_and_are_alike():
    runs = list(range(18))
    first, second, fresh = split_runs(runs, np.random.default_rng(0))
    assert len(first) == len(second) == 8
    assert sorted([*first, *second, *fresh]) == runs
    assert all(abs(a - b) <= 3 for a, b in zip(first, second, strict=True))


def test_recordings_need_an_untouched_plant(recordings):
    shares = {"null": 0.0, "single": 1.0, "pair": 0.0, "absent": 0.0}
    with pytest.raises(InputError, match="tier semireal: 3 plants without a null plant"):
        design_trial(Recipe(1, {SEMIREAL: 3}, shares, str(recordings)))
    assert design_trial(Recipe(1, {SEMIREAL: 3}))[1] == ["3 plants of the tier semireal: no recordings in any folder"]


def test_the_families_alter_other_recordings_by_other_strengths(recordings):
    recipe = Recipe(1, {SEMIREAL: 12}, recorded=str(recordings))
    targets = {
        family: {target for design in design_trial(replace(recipe, family=family))[0] for target in design.targets}
        for family in ("development", "evaluation")
    }
    assert targets["development"].isdisjoint(targets["evaluation"])
    assert all(targets.values())


def cause_of(effect, probability):
    interval = SimpleNamespace(value=0.5, lower=0.4, upper=0.6)
    return SimpleNamespace(
        effect=effect,
        probability=probability,
        closed_fraction=interval,
        parameters={},
        level="effect",
        members=(),
        plausible=(),
        class_probability=probability,
    )


def stand_in(runs, model, *, effects=(), bench=None, seed=0, reference=()):
    """A diagnosis that names the same effects for whatever it is given, one more in a comparison."""
    assert model in RECORDED_MODELS
    assert all(len(run.time) > 100 for run in (*runs, *reference))
    causes = [cause_of("gas_spring", 0.9), *([cause_of("end_stop", 0.6)] if reference else [])]
    return SimpleNamespace(
        verdict="partly_explained",
        causes=causes,
        candidates=(),
        alternatives=(),
        untestable=(),
        nearest=None,
        where=(),
        weighed=(),
        next_experiment=None,
        elapsed=1.0,
        gap=None,
        corrected=None,
    )


def without_reference(runs, model, *, effects=(), bench=None, seed=0):
    return stand_in(runs, model)


def test_another_method_can_diagnose_and_is_scored(trial, tmp_path):
    folder, answers = trial
    submissions = run_trial(folder, tmp_path, installed_diagnoser(), method=stand_in)
    assert not [submission.failure for submission in submissions.values() if submission.failure]
    evaluations = evaluate_trial(folder, answers, submissions, tmp_path)
    score = score_trial(answers, submissions, evaluations)
    semireal, compared = score.tiers[SEMIREAL], score.tiers[BEFORE_AFTER]
    assert semireal.classes.null == Rate(2, 2)
    assert semireal.classes.wrong == Rate(0, 2)  # what is named without the effect too counts for nothing
    assert compared.classes.null == Rate(2, 2)
    assert semireal.calibration.count == 0
    assert compared.calibration.count == 8
    assert score.tiers["rich"].plants == 0
    for text in (markdown_tables(score), write_score_report(score, tmp_path).read_text()):
        assert "Goals, measured recordings" in text
    # Nothing was corrected, so nothing of what was added is closed.
    assert semireal.relative_closure.values
    assert np.abs(semireal.relative_closure.values).max() < 0.05


def test_evaluations_follow_the_submissions(trial, tmp_path, monkeypatch):
    folder, answers = trial
    submissions = run_trial(folder, tmp_path, installed_diagnoser(seed=3), method=stand_in)
    monkeypatch.setattr(evaluate, "evaluate_plant", lambda plant: Evaluation(plant.truth.plant, plant.digest))
    path = tmp_path / evaluate.EVALUATIONS_FILE

    def written(submissions):
        evaluate_trial(folder, answers, submissions, tmp_path)
        return [from_json(Evaluation, line, "here").plant for line in path.read_text(encoding="utf-8").splitlines()]

    altered = next(truth for truth in answers.values() if truth.excitation == SEMIREAL and truth.background)
    untouched = altered.background
    on_it = {truth.plant for truth in answers.values() if truth.excitation == SEMIREAL and truth.background == untouched}
    # Another version has left its evaluations, and one verdict is not there yet.
    path.write_text('{"format":2,"plant":"p0001"}\n', encoding="utf-8")
    first = written({plant: entry for plant, entry in submissions.items() if plant != untouched})
    assert set(first) == answers.keys() - on_it - {untouched}
    assert written(submissions) == [*first, *(plant for plant in answers if plant in on_it | {untouched})]
    assert written(submissions)[: len(first)] == first
    # What was evaluated beside another verdict on the untouched recordings is evaluated again.
    changed = {**submissions, untouched: replace(submissions[untouched], verdict="no_gap")}
    assert set(written(changed)[-1 - len(on_it) :]) == on_it | {untouched}
    assert len(written(changed)) == len(answers)


def test_a_comparison_needs_a_method_that_compares(trial, tmp_path):
    with pytest.raises(
        InputError, match="is to be compared with recordings as reference, but this diagnosis takes no reference"
    ):
        run_trial(trial[0], tmp_path, installed_diagnoser(), method=without_reference)


# Scores by hand


def truth_of(plant, kind, *causes, strength=1.0, background="n", tier=SEMIREAL):
    effects = {cause: {} for cause in causes}
    return GroundTruth(
        plant,
        kind,
        "bouc_wen",
        "press",
        True,
        (),
        {},
        effects,
        {},
        causes,
        {},
        strength if causes else 0.0,
        "25-50 %",
        tier,
        200.0,
        0,
        "00",
        "" if kind == "null" else background,
    )


def submit(plant, verdict, *names):
    nan = (float("nan"),) * 3
    return Submission(plant, verdict, causes=tuple(Explanation((name,), 0.9, nan) for name in names))


def scored(truths, submissions, evaluations=()):
    """Return the figures of the only tier."""
    by_plant = ({record.plant: record for record in records} for records in (truths, submissions, evaluations))
    return score_trial(*by_plant).tiers[truths[0].excitation]


def test_a_name_that_the_untouched_recordings_get_too_counts_for_no_one():
    truths = [
        truth_of("n", "null"),
        truth_of("a", "single", "joint_play"),
        truth_of("b", "single", "channel_delay"),
        truth_of("c", "single", "channel_delay", strength=0.2),
        truth_of("d", "pair", "channel_delay", "moving_mass"),
        truth_of("e", "single", "moving_mass"),
    ]
    submissions = [
        submit("n", "unknown_effect", "joint_play"),
        submit("a", "unknown_effect", "joint_play"),
        submit("b", "partly_explained", "joint_play", "channel_delay"),
        submit("c", "ambiguous", "joint_play"),
        submit("d", "explained", "channel_delay", "gas_spring"),
    ]
    evaluations = [Evaluation("b", oracle_closure=1.0, closure=0.8), Evaluation("a", oracle_closure=1.0, closure=0.1)]
    found = scored(truths, submissions, evaluations)
    assert found.not_counted == 1
    assert found.classes.right == found.classes.cause == Rate(1, 2)  # the plant without submission has failed
    assert found.classes.both == Rate(0, 1)
    assert found.classes.wrong == Rate(2, 4)
    assert found.classes.null == Rate(1, 1)
    assert found.calibration.count == 3
    assert found.relative_closure.values == (0.8, 0.0)
    assert [entry.right for entry in found.strata if entry.factor == "effect"] == [Rate(1, 1), Rate(0, 1)]
    assert not is_detectable(truths[3])


def test_the_background_is_what_is_named_in_classes_too():
    """The class of the untouched runs is led by its first effect, that of the altered ones by its second."""
    late = ("channel_delay", "force_sensor_lag")

    def led_by(plant, effect):
        cause = Explanation((effect,), 0.6, (float("nan"),) * 3, level="class", members=late)
        return Submission(plant, "ambiguous", causes=(cause,))

    truths = [truth_of("n", "null"), truth_of("a", "single", late[1]), truth_of("b", "single", "end_stop")]
    found = scored(truths, [led_by("n", late[0]), led_by("a", late[1]), led_by("b", late[1])])
    assert found.not_counted == 1
    assert found.classes.right == found.classes.wrong == Rate(0, 1)
    assert found.calibration.count == 0


def test_names_beside_an_unknown_background_are_worth_nothing():
    truths = [truth_of("n", "null"), truth_of("a", "single", "end_stop")]
    for untouched in ([], [Submission("n", "failed", "an error")]):
        found = scored(truths, [submit("a", "explained", "end_stop"), *untouched])
        assert (found.classes.right, found.classes.wrong) == (Rate(0, 1), Rate(1, 1))


def test_what_the_untouched_recordings_show_is_not_known_to_be_wrong():
    """A fluid that thins closed half of the gap of an untouched press, and was named on some of the altered runs only."""
    nan = float("nan")
    truths = [truth_of("n", "null"), *(truth_of(plant, "single", "end_stop") for plant in "abc")]
    shown = tuple(
        Explanation(effects, 0.1, (share, nan, nan))
        for effects, share in ((("shear_thinning",), 0.56), (("gas_spring",), 0.1), (("gas_spring", "settling"), 0.9))
    )
    submissions = [
        replace(submit("n", "unknown_effect"), candidates=shown),
        submit("a", "partly_explained", "end_stop", "shear_thinning"),
        submit("b", "partly_explained", "gas_spring"),
        submit("c", "partly_explained", "settling"),
    ]
    found = scored(truths, submissions)
    assert found.classes.wrong == Rate(3, 3)
    assert found.classes.wrong_unshown == Rate(2, 3)


def test_a_name_without_a_change_is_wrong_in_a_comparison():
    truths = [truth_of("n", "null", tier=BEFORE_AFTER), truth_of("a", "single", "moving_mass", tier=BEFORE_AFTER)]
    found = scored(truths, [submit("n", "explained", "moving_mass"), submit("a", "explained", "moving_mass")])
    assert found.classes.null == Rate(1, 1)
    assert found.classes.right == Rate(1, 1)
    assert found.calibration.count == 2
    assert found.not_counted == 0
    assert found.relative_closure.values == ()


def test_a_class_counts_as_right_where_it_holds_the_cause():
    nan = (float("nan"),) * 3
    late = Explanation(("force_sensor_lag",), 0.5, nan, level="class", members=("force_sensor_lag", "channel_delay"))
    truths = [
        truth_of("n", "null"),
        truth_of("a", "single", "channel_delay"),
        truth_of("b", "single", "joint_play"),
        truth_of("c", "pair", "channel_delay", "joint_play"),
        truth_of("d", "absent"),
    ]
    submissions = [
        submit("n", "unknown_effect"),
        Submission("a", "ambiguous", causes=(late,)),
        Submission("b", "ambiguous", causes=(late,)),
        Submission("c", "ambiguous", causes=(late, Explanation(("joint_play",), 0.9, nan))),
        submit("d", "unknown_effect"),
    ]
    rates = scored(truths, submissions).classes
    assert (rates.right, rates.cause, rates.both, rates.wrong) == (Rate(1, 2), Rate(0, 2), Rate(1, 1), Rate(1, 4))
    assert (rates.effect, rates.undivided) == (Rate(1, 1), Rate(3, 4))
    assert rates.members.values == (2.0, 2.0, 2.0, 1.0)
