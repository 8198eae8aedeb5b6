"""Scores against figures worked out by hand."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from mrd_base import InputError
from mrd_trials.rates import Rate, Spread, calibration
from mrd_trials.records import Answer, Bin, Insight, Named, Submission
from mrd_trials.score import Experiment, Goal, overlap, score
from mrd_trials.score_report import write_score_report
from mrd_trials.tables import tables, text

NAN = float("nan")
NOWHERE = (NAN, NAN, NAN)


def answer(plant, kind, *causes, **changed):
    """A rich plant of the fitted form whose effects are well above the floor."""
    plain = Answer(
        plant,
        kind,
        "bouc_wen",
        "bouc_wen",
        False,
        {},
        {cause: {} for cause in causes},
        causes,
        {},
        0.0 if kind == "null" else 20.0,
        "" if kind == "null" else ">10",
        "rich",
        500.0,
        0,
        "00",
    )
    return replace(plain, **changed)


def said(plant, verdict, *causes, candidates=(), **changed):
    """A submission; causes and candidates as (effect, probability, ...)."""
    return Submission(plant, verdict, causes=tuple(map(named, causes)), candidates=tuple(map(named, candidates)), **changed)


def named(found):
    effect, probability, *rest = found
    return Named((effect,), probability, NOWHERE, *rest)


def judged(answers, submissions, insights=()):
    return score(*({one.plant: one for one in records} for records in (answers, submissions, insights)))


# Clopper-Pearson


@given(st.integers(0, 60), st.integers(0, 60))
def test_interval_of_a_rate(hits, misses):
    if not hits + misses:
        assert all(map(math.isnan, (Rate(0, 0).value, Rate(0, 0).lower, Rate(0, 0).upper, Rate(0, 0).bound)))
        return
    rate = Rate(hits, hits + misses)
    expected = binomtest(hits, hits + misses).proportion_ci(0.95, "exact")
    one_sided = binomtest(hits, hits + misses, alternative="less").proportion_ci(0.95, "exact")
    assert rate.lower == pytest.approx(expected.low, abs=1e-9)
    assert rate.upper == pytest.approx(expected.high, abs=1e-9)
    assert rate.bound == pytest.approx(one_sided.high, abs=1e-9)


# Single effects


def test_naming_and_ranking_are_told_apart():
    plants = [answer(f"p{k}", "single", "backlash") for k in range(5)]
    rich = judged(
        plants,
        [
            said("p0", "explained", ("backlash", 0.9), candidates=[("coil_lag", 0.1)]),
            said("p1", "ambiguous", ("coil_lag", 0.6), ("backlash", 0.4)),
            said("p2", "unknown_effect", candidates=[("backlash", 0.5), ("coil_lag", 0.2)]),
            said("p3", "unknown_effect", candidates=[("a", 0.5), ("b", 0.2), ("c", 0.1), ("backlash", 0.1)]),
        ],
    ).folds["rich"]
    assert rich.detectable.named == Rate(1, 5)
    assert rich.detectable.ranked == Rate(2, 5)
    assert rich.detectable.ranked_three == Rate(3, 5)
    assert rich.explained.named == Rate(1, 1)
    # The plant without submission has failed, which is as bad as needless abstention.
    assert rich.mistakes.needless == Rate(3, 5)


def test_a_cause_beside_something_unknown_can_be_wrong_but_does_not_make_the_answer_right():
    plants = [answer("a", "single", "backlash"), answer("n", "null")]
    rich = judged(plants, [said(name, "unknown_effect", ("backlash", 1.0)) for name in "an"]).folds["rich"]
    assert rich.detectable.named == Rate(0, 1)
    assert rich.mistakes.null == Rate(1, 1)
    assert rich.calibration.count == 2


def test_groups_are_the_oracle_s_or_else_claimed():
    single = answer("p", "single", "backlash")
    wrong = said("p", "explained", ("joint_play", 0.9))

    def found(submission, *insights):
        return judged([single], [submission], insights).folds["rich"].detectable

    assert found(wrong).named_group == Rate(0, 1)
    claimed = said("p", "explained", ("joint_play", 0.9, {}, ("backlash",)))
    assert found(claimed).named_group == Rate(1, 1)
    assert found(claimed, Insight("p", alike={"backlash": ("backlash",)})).named_group == Rate(0, 1)
    known = Insight("p", alike={"backlash": ("backlash", "joint_play")})
    assert found(wrong, known).named_group == Rate(1, 1)
    assert found(wrong, known).named == Rate(0, 1)


def test_parts_of_the_plants():
    weak = {"signal_to_floor": 2.0, "stratum": "1-3"}
    plants = [
        answer("a", "single", "backlash"),
        answer("b", "single", "coil_lag", rate=25.0),
        answer("c", "single", "backlash", **weak),
        answer("d", "single", "backlash", excitation="sine"),
    ]
    found = judged(plants, [said("a", "explained", ("backlash", 0.9)), said("d", "explained", ("coil_lag", 0.9))])
    named = {(one.by, one.value): one.named for one in found.which}
    assert named["effect", "backlash"] == Rate(1, 1)
    assert named["effect", "coil_lag"] == Rate(0, 1)
    assert named["signal to floor", "1-3"] == Rate(0, 1)
    assert [value for by, value in named if by == "signal to floor"] == ["1-3", ">10"]
    assert [value for by, value in named if by == "rate"] == ["25 Hz", "500 Hz"]
    assert found.folds["rich"].single.named == Rate(1, 3)
    assert found.folds["rich"].detectable.named == Rate(1, 2)
    assert list(found.folds) == ["rich", "sine"]
    assert found.folds["sine"].sets.holds == Rate(0, 1)
    assert found.folds["sine"].sets.named_wrong == Rate(1, 1)


# Pairs


def test_pairs():
    plants = [answer(f"p{k}", "pair", "backlash", "coil_lag") for k in range(4)]
    found = judged(
        plants,
        [
            said("p0", "explained", ("coil_lag", 0.9), ("backlash", 0.8)),
            said("p1", "explained", ("backlash", 0.9)),
            said("p2", "ambiguous", ("joint_play", 0.5), ("coil_lag", 0.9)),
            said("p3", "unknown_effect"),
        ],
        [Insight("p2", alike={"backlash": ("backlash", "joint_play")})],
    )
    pairs = found.folds["rich"].pairs
    assert pairs.both == pairs.both_detectable == Rate(1, 4)
    assert pairs.both_group == Rate(2, 4)
    assert (pairs.precision, pairs.recall) == (Rate(4, 5), Rate(4, 8))
    assert pairs.f1 == pytest.approx(2 * 0.8 * 0.5 / 1.3)
    cells = {
        (row, column): count
        for row, own in zip(found.confusion.rows, found.confusion.counts, strict=True)
        for column, count in zip(found.confusion.columns, own, strict=True)
        if count
    }
    assert cells == {
        ("backlash, of a pair", "backlash"): 2,
        ("backlash, of a pair", "joint_play"): 1,
        ("backlash, of a pair", "unknown_effect"): 1,
        ("coil_lag, of a pair", "coil_lag"): 2,
        ("coil_lag, of a pair", "not named"): 1,
        ("coil_lag, of a pair", "unknown_effect"): 1,
    }


def test_one_name_does_not_stand_for_both_of_a_pair():
    alike = {"backlash": ("joint_play",), "coil_lag": ("joint_play",)}
    one = said("p", "explained", ("joint_play", 0.9))
    found = judged([answer("p", "pair", "backlash", "coil_lag")], [one], [Insight("p", alike=alike)])
    assert found.folds["rich"].pairs.both_group.hits == 0


# Mistakes


def test_alarms_and_wrong_names():
    plants = [
        *(answer(f"n{k}", "null") for k in range(4)),
        answer("o0", "null", perturbed=True),
        answer("o1", "null", perturbed=True),
        answer("x0", "absent", effects={"strange": {}}),
        answer("x1", "absent", effects={"strange": {}}),
        answer("x2", "absent", "pre_yield_hysteresis"),
    ]
    found = judged(
        plants,
        [
            said("n0", "no_gap"),
            said("n1", "unknown_effect"),
            said("n2", "explained", ("backlash", 0.9)),
            # n3 failed
            said("o0", "unknown_effect", ("pre_yield_hysteresis", 1.0)),
            said("o1", "unknown_effect"),
            said("x0", "unknown_effect"),
            said("x1", "ambiguous", ("backlash", 0.6)),
            said("x2", "unknown_effect", ("pre_yield_hysteresis", 1.0)),
        ],
    )
    mistakes = found.folds["rich"].mistakes
    assert (mistakes.null, mistakes.null_fitted, mistakes.null_other) == (Rate(3, 6), Rate(2, 4), Rate(1, 2))
    assert mistakes.false_unknown == Rate(2, 4)
    assert mistakes.absent == Rate(1, 3)
    assert found.failures == {"n3": "no submission"}


def test_needless_unknowns_are_those_that_the_catalogue_could_have_solved():
    plants = [
        answer("a", "single", "backlash"),
        answer("b", "single", "backlash", signal_to_floor=2.0),
        answer("c", "single", "backlash", perturbed=True),
        answer("d", "absent", "backlash", effects={"backlash": {}, "strange": {}}),
    ]
    found = judged(plants, [said(plant.plant, "unknown_effect") for plant in plants])
    assert found.folds["rich"].mistakes.needless == Rate(1, 1)


def test_baselines_stand_beside_the_diagnosis():
    plants = [answer("a", "single", "backlash"), answer("b", "single", "coil_lag"), answer("n", "null"), answer("m", "null")]
    plants += [answer("unasked", "single", "gas_spring")]
    found = judged(
        plants,
        [said("a", "explained", ("backlash", 0.9)), *(said(plant, "no_gap") for plant in ("b", "n", "m", "unasked"))],
        [
            Insight("a", rankings={"bic": ("coil_lag", "x", "backlash"), "score": ("backlash",)}),
            Insight("b", rankings={"bic": ("", "coil_lag"), "score": ()}),
            Insight("n", rankings={"bic": ("",), "score": ("x",)}),
            Insight("m", rankings={"bic": ("x",)}),
        ],
    )
    rows = {row.name: (row.top, row.three, row.alarms) for row in found.baselines}
    assert rows["bic"] == (Rate(0, 2), Rate(2, 2), Rate(1, 2))
    assert rows["score"] == (Rate(1, 2), Rate(1, 2), Rate(1, 2))
    assert rows["diagnosis, named"] == (Rate(1, 2), Rate(1, 2), Rate(0, 2))


# How sure, how far, where, how large


def test_calibration_by_hand():
    found = calibration(np.array([0.95, 0.91, 0.35, 1.0]), np.array([True, False, False, True]))
    nine, three = (next(one for one in found.curve if one.lower == lower) for lower in (0.9, 0.3))
    assert (nine.right, three.right) == (Rate(2, 3), Rate(0, 1))
    assert found.error == pytest.approx((3 * abs(2.86 / 3 - 2 / 3) + 0.35) / 4)
    assert found.brier == pytest.approx((0.05**2 + 0.91**2 + 0.35**2) / 4)
    assert found.log == pytest.approx(-(math.log(0.95) + math.log(0.09) + math.log(0.65)) / 4)


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_calibration_is_bounded_and_counts_everything(claims):
    found = calibration(*(np.array(part) for part in zip(*claims, strict=True)))
    assert 0 <= found.error <= 1
    assert 0 <= found.brier <= 1
    assert sum(one.right.of for one in found.curve) == found.count == len(claims)


def test_claims_are_causes_and_else_the_first_candidate():
    plants = [answer("a", "single", "backlash"), answer("b", "single", "backlash"), answer("n", "null")]
    rich = judged(
        plants,
        [
            said("a", "explained", ("backlash", 0.9), ("coil_lag", 0.8), candidates=[("backlash", 0.9)]),
            said("b", "unknown_effect", candidates=[("backlash", 0.7), ("coil_lag", 0.3)]),
            said("n", "no_gap", candidates=[("coil_lag", NAN)]),
        ],
    ).folds["rich"]
    assert rich.calibration.count == 2
    assert rich.calibration.brier == pytest.approx((0.1**2 + 0.8**2) / 2)
    assert rich.calibration_first.count == 3
    assert rich.calibration_first.brier == pytest.approx((0.1**2 + 0.8**2 + 0.3**2) / 3)


def test_intervals_count_where_the_cause_is_right_and_has_one():
    true = {"backlash.width": 2e-4, "coil_lag.time": 0.01}
    plants = [answer(name, "pair", "backlash", "coil_lag", sizes=true) for name in "abc"]
    sizes = [
        {"backlash.width": (2.1e-4, 1.9e-4, 2.3e-4), "backlash.shape": (1.0, 0.9, 1.1)},
        {"backlash.width": (2.6e-4, 2.5e-4, 2.7e-4)},
        {"backlash.width": (2.0e-4, NAN, NAN)},
    ]
    found = judged(
        plants,
        [
            said(name, "explained", ("backlash", 0.9, own), ("joint_play", 0.9, {"joint_play.width": (1.0, 0.0, 2.0)}))
            for name, own in zip("abc", sizes, strict=True)
        ],
    ).folds["rich"]
    assert found.coverage == Rate(1, 2)
    assert found.coverage_of == {"backlash": Rate(1, 2)}


def test_closure_is_relative_to_what_could_be_closed():
    plants = [answer(name, "single", "backlash") for name in "abcd"]
    submissions = [
        replace(said(name, "explained"), closed=(closed, NAN, NAN)) for name, closed in zip("ab", (0.9, 0.4), strict=True)
    ]
    submissions.append(said("c", "failed", failure="none"))
    insights = [
        Insight("a", closed=1.0, fresh=0.7),
        Insight("b", closed=0.8, fresh=0.5),
        Insight("c", closed=0.5),
        Insight("d"),
    ]
    rich = judged(plants, submissions, insights).folds["rich"]
    assert rich.closure.values == pytest.approx((0.9, 0.5, 0.0))
    assert rich.closure.median == pytest.approx(0.5)
    assert rich.fresh.values == pytest.approx((0.2, 0.1))


def bins(axis, *shares):
    return [Bin(axis, float(k), k + 1.0, share) for k, share in enumerate(shares)]


def test_overlap_by_hand():
    said_of = [*bins("velocity", 3.0, 1.0, -2.0), *bins("current", 1.0, 1.0), *bins("time", 1.0)]
    true = [*bins("velocity", 0.5, 0.5, 0.0, 4.0), *bins("current", 0.0, 1.0), *bins("time", 1.0)]
    velocity, current = overlap(said_of, true)
    assert velocity == pytest.approx((0.75, 2 / 3, True))
    assert current == pytest.approx((0.5, 0.5, False))


@given(st.lists(st.floats(-1, 5), min_size=2, max_size=9))
def test_overlap_of_a_map_with_itself_is_whole(shares):
    found = overlap(bins("velocity", *shares), bins("velocity", *shares))
    assert found == ([(pytest.approx(1.0), pytest.approx(found[0][1]), True)] if max(shares) > 0 else [])


# Next experiment, single sine


def test_experiments_are_counted_in_pairs():
    outcomes = [(True, True), (True, False), (True, False), (False, False), (False, True), (None, None)]
    plants = [answer(f"p{k}", "single", "backlash") for k in range(len(outcomes))]
    insights = [Insight(f"p{k}", advised=first, random=second) for k, (first, second) in enumerate(outcomes)]
    plants[0] = replace(plants[0], excitation="sine")
    whole = judged(plants, [], insights)
    found = next(goal.measured for goal in whole.goals if isinstance(goal.measured, Experiment))
    assert whole.folds["rich"].experiment.advised == Rate(2, 4)
    assert (found.advised, found.random) == (Rate(3, 5), Rate(2, 5))
    assert (found.only_advised, found.only_random) == (2, 1)
    assert found.ratio == pytest.approx(1.5)


def test_sets_left_open():
    plants = [answer(f"p{k}", "single", "backlash", excitation="sine") for k in range(7)]
    sets = (
        judged(
            plants,
            [
                said("p0", "ambiguous", ("joint_play", 0.6, {}, ("backlash",))),
                said("p1", "ambiguous", ("joint_play", 0.6), candidates=[("joint_play", 0.6), ("backlash", 0.06)]),
                said("p2", "ambiguous", ("joint_play", 0.6), candidates=[("joint_play", 0.6), ("backlash", 0.04)]),
                said("p3", "no_gap", untestable=("backlash", "coil_lag")),
                said("p4", "unknown_effect"),
                said("p6", "explained", ("joint_play", 1.0), candidates=[("backlash", 0.0, {}, ("joint_play",))]),
            ],
        )
        .folds["sine"]
        .sets
    )
    assert sets.holds == Rate(5, 7)
    assert sets.holds_it == Rate(4, 7)
    assert sets.named_wrong == Rate(3, 7)  # p0 says itself that it may be the backlash
    assert sets.size.values == (2.0, 2.0, 1.0, 2.0, 0.0, 2.0)


# Goals, tables, page


def test_goals_and_their_bounds():
    assert Goal("", Rate(19, 20), least=0.95).met
    assert Goal("", Rate(18, 20), least=0.95).met is False
    assert Goal("", Rate(0, 0), most=0.05).met is None
    assert Goal("", Spread((0.2, 0.9, 1.0)), least=0.9).met
    assert Goal("", Rate(20, 20), least=0.9, most=0.99).met is False
    assert Goal("", Experiment(Rate(3, 4), Rate(0, 4), 3, 0), least=2.0).met
    assert Goal("", Experiment(Rate(0, 4), Rate(0, 4), 0, 0), least=2.0).met is None
    assert text(Experiment(Rate(3, 4), Rate(2, 4), 1, 0)) == "1.5 (3 against 2 of 4)"


def trial(seed=3, right=0.9, plants=120):
    """Answers, submissions and insights of a diagnosis that is right about this often."""
    random = np.random.default_rng(seed)
    effects = ("backlash", "coil_lag", "gas_spring", "moving_mass", "seal_friction", "channel_delay")
    answers, submissions, insights = [], [], []
    for place in range(plants):
        name = f"plant_{place:03d}"
        kind = str(random.choice(["null", "single", "pair", "absent"], p=[0.25, 0.4, 0.15, 0.2]))
        causes = tuple(map(str, random.choice(effects, {"single": 1, "pair": 2}.get(kind, 0), replace=False)))
        signal = 0.0 if kind == "null" else float(np.exp(random.uniform(0, 4)))
        answers.append(
            answer(
                name,
                kind,
                *causes,
                perturbed=kind == "null" and bool(place % 2),
                signal_to_floor=signal,
                excitation="sine" if place % 6 == 5 else "rich",
                rate=25.0 if place % 3 == 0 else 500.0,
                stratum="" if kind == "null" else "1-3" if signal < 3 else "3-10" if signal < 10 else ">10",
                effects={cause: {} for cause in causes or (() if kind == "null" else ("strange",))},
                sizes={f"{cause}.size": 1.0 for cause in causes},
            )
        )
        told = causes if random.random() < right else tuple(map(str, random.choice(effects, 1)))
        verdict = "explained" if told else {"null": "no_gap", "absent": "unknown_effect"}[kind]
        shares = random.dirichlet(np.ones(6))
        found = tuple(
            Named((cause,), right, (right, 0.8, 1.0), {f"{cause}.size": (1.0, 0.9, 1.0 + random.normal(0.1, 0.06))})
            for cause in told
        )
        if place != 7:
            submissions.append(
                Submission(
                    name,
                    verdict,
                    "",
                    found,
                    (*found, named((str(random.choice(effects)), 0.1))),
                    closed=(0.93, 0.9, 0.97),
                    where=tuple(bins("velocity", *shares)),
                    elapsed=float(random.gamma(9.0)),
                )
            )
        blurred = tuple(bins("velocity", *(shares + random.dirichlet(np.ones(6)))))
        tried = (bool(random.random() < 0.7), bool(random.random() < 0.3)) if place % 9 == 0 else (None, None)
        rankings = {method: tuple(map(str, random.permutation(effects))) for method in ("bic", "random")}
        insights.append(Insight(name, float(random.uniform(0.9, 1.0)), blurred, 0.9, {}, rankings, *tried))
    return answers, submissions, insights


def test_tables_hold_the_figures():
    found = judged(*trial())
    shown = tables(found)
    assert text(found.folds["rich"].mistakes.null) in shown
    assert text(found.folds["rich"].detectable.named_group) in shown
    assert "| plant_007 | no submission |" in shown
    # Every table is whole: each line has as many cells as its header.
    for block in shown.split("### ")[1:]:
        assert len({line.count("|") for line in block.splitlines() if line.startswith("|")}) == 1
    assert "nan" not in shown


@pytest.mark.parametrize("kinds", [("null",), ("single",), ("absent", "pair")])
def test_a_page_and_tables_of_any_trial(tmp_path, kinds):
    parts = trial()
    kept = {one.plant for one in parts[0] if one.kind in kinds}
    found = judged(*([one for one in part if one.plant in kept] for part in parts))
    assert "nan" not in tables(found)
    page = write_score_report(found, tmp_path).read_text(encoding="utf-8")
    assert text(found.folds["rich"].mistakes.null) in page
    assert not re.search(r'(src|href)="(https?:)?//', page.rpartition("<h1>")[2])
    assert [path.name for path in tmp_path.iterdir()] == ["score.html"]


def test_failures_never_help():
    answers, submissions, insights = trial(right=1.0, plants=60)
    whole, broken = judged(answers, submissions, insights), judged(answers, submissions[::2], insights)
    for before, after in zip(whole.goals, broken.goals, strict=True):
        if isinstance(before.measured, Rate) and np.isinf(before.most):
            assert after.measured.hits <= before.measured.hits
        elif isinstance(before.measured, Rate) and np.isinf(before.least):
            assert after.measured.hits >= before.measured.hits
    assert whole.folds["rich"].mistakes.null.value < broken.folds["rich"].mistakes.null.value


def test_what_cannot_be_scored_is_refused():
    with pytest.raises(InputError, match="no plants"):
        judged([], [])
    with pytest.raises(InputError, match="plant b has no answer"):
        judged([answer("a", "null")], [said("b", "no_gap")])
    with pytest.raises(InputError, match="0 causes do not fit"):
        judged([answer("a", "single")], [])
