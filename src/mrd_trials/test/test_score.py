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
from mrd_trials.records import Evaluation, Explanation, GapBin, GroundTruth, Submission, WeighedEffect
from mrd_trials.scoring.around_models import found_around_all
from mrd_trials.scoring.classes import LOST
from mrd_trials.scoring.gap import AxisOverlap, ExperimentComparison, overlaps
from mrd_trials.scoring.goals import Goal
from mrd_trials.scoring.rates import Distribution, Rate, calibration
from mrd_trials.scoring.report import write_score_report
from mrd_trials.scoring.score import score_trial
from mrd_trials.scoring.tables import markdown_tables, text

NAN = float("nan")
NO_INTERVAL = (NAN, NAN, NAN)


def truth_of(plant, kind, *causes, **changed):
    """A rich plant of the fitted form whose effects are well above the floor."""
    plain = GroundTruth(
        plant,
        kind,
        "bouc_wen",
        "bouc_wen",
        False,
        (),
        {},
        {cause: {} for cause in causes},
        {},
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


def submit(plant, verdict, *causes, candidates=(), **changed):
    """A submission; causes and candidates as (effect, probability, ...)."""
    explained, tried = (tuple(map(explanation, entries)) for entries in (causes, candidates))
    return Submission(plant, verdict, causes=explained, candidates=tried, **changed)


def explanation(entry):
    effect, probability, *rest = entry
    return Explanation((effect,), probability, NO_INTERVAL, *rest)


def score(answers, submissions, evaluations=()):
    by_plant = ({record.plant: record for record in records} for records in (answers, submissions, evaluations))
    return score_trial(*by_plant)


# Places, and other models


@pytest.mark.parametrize(
    ("verdict", "before", "has_place", "hits", "total"),
    [
        ("unknown_effect", 0.05, True, 1, 1),
        ("unknown_effect", 0.05, False, 0, 1),
        ("unknown_effect", 0.021, True, 0, 0),
        ("unknown_effect", 0.05, None, 0, 0),
        ("unknown_effect", NAN, True, 0, 0),
        ("explained", 0.05, False, 0, 1),
        ("partly_explained", 0.05, False, 0, 0),  # its map is that of what remains
    ],
)
def test_a_large_error_should_have_a_place(verdict, before, has_place, hits, total):
    submission = submit("a", verdict, before=before, after=0.02, noise_floor=0.01, has_place=has_place)
    rate = score([truth_of("a", "single", "backlash")], [submission]).by_excitation["rich"].places
    assert (rate.hits, rate.total) == (hits, total)


def test_a_cause_is_found_around_all_models_or_not():
    answers = {
        plant: truth_of(plant, kind, *causes)
        for plant, kind, causes in (
            ("a", "single", ["backlash"]),
            ("b", "single", ["coil_lag"]),
            ("c", "single", ["settling"]),
            ("d", "null", []),
            ("e", "single", ["mains_hum"]),
            ("f", "single", ["backlash"]),
        )
    }
    answers["f"] = replace(answers["f"], excitation="black_box")
    as_class = Explanation(("joint_play",), 0.5, NO_INTERVAL, level="class", members=("joint_play", "backlash"))
    first = [
        Submission("a", "ambiguous", causes=(as_class,)),
        submit("b", "explained", ("coil_lag", 0.9)),
        submit("c", "unknown_effect"),
        submit("d", "no_gap"),
        submit("e", "explained", ("mains_hum", 0.9)),
        submit("f", "explained", ("backlash", 0.9)),
    ]
    second = [
        submit("a", "explained", ("backlash", 0.9)),
        submit("b", "unknown_effect"),
        submit("c", "unknown_effect"),
        submit("d", "no_gap"),
        submit("f", "explained", ("backlash", 0.9)),
    ]
    by_model = [{entry.plant: entry for entry in entries} for entries in (first, second)]
    rate = found_around_all(answers, by_model)
    # Nobody found that of c, e has no second verdict, and a black box is diagnosed around no model.
    assert (rate.hits, rate.total) == (1, 2)


# Clopper-Pearson


@given(st.integers(0, 60), st.integers(0, 60))
def test_interval_of_a_rate(hits, misses):
    if not hits + misses:
        assert all(map(math.isnan, (Rate(0, 0).value, Rate(0, 0).lower, Rate(0, 0).upper, Rate(0, 0).upper_bound)))
        return
    rate = Rate(hits, hits + misses)
    expected = binomtest(hits, hits + misses).proportion_ci(0.95, "exact")
    one_sided = binomtest(hits, hits + misses, alternative="less").proportion_ci(0.95, "exact")
    assert rate.lower == pytest.approx(expected.low, abs=1e-9)
    assert rate.upper == pytest.approx(expected.high, abs=1e-9)
    assert rate.upper_bound == pytest.approx(one_sided.high, abs=1e-9)


# Single effects


def test_naming_and_ranking_differ():
    plants = [truth_of(f"p{k}", "single", "backlash") for k in range(5)]
    rich = score(
        plants,
        [
            submit("p0", "explained", ("backlash", 0.9), candidates=[("coil_lag", 0.1)]),
            submit("p1", "ambiguous", ("coil_lag", 0.6), ("backlash", 0.4)),
            submit("p2", "unknown_effect", candidates=[("backlash", 0.5), ("coil_lag", 0.2)]),
            submit("p3", "unknown_effect", candidates=[("a", 0.5), ("b", 0.2), ("c", 0.1), ("backlash", 0.1)]),
        ],
    ).by_excitation["rich"]
    assert rich.detectable.named == Rate(1, 5)
    assert rich.detectable.ranked == Rate(2, 5)
    assert rich.detectable.ranked_three == Rate(3, 5)
    assert rich.explained.named == Rate(1, 1)
    # The plant without submission has failed, which is as bad as needless abstention.
    assert rich.mistakes.needless_unknown == Rate(3, 5)


@pytest.mark.parametrize("verdict", ["explained", "partly_explained", "ambiguous", "unknown_effect"])
def test_a_name_counts_whatever_the_verdict(verdict):
    plants = [truth_of("a", "single", "backlash"), truth_of("n", "null")]
    rich = score(plants, [submit(name, verdict, ("backlash", 1.0)) for name in "an"]).by_excitation["rich"]
    assert rich.detectable.named == Rate(1, 1)
    assert rich.mistakes.null == Rate(1, 1)
    assert rich.mistakes.needless_unknown == Rate(0, 1)
    assert rich.calibration.count == 2


def test_what_the_form_of_the_damper_contains_is_neither_right_nor_wrong():
    thinning = {"implied": ("shear_thinning",), "perturbed": True}
    plants = [truth_of("n", "null", **thinning), truth_of("a", "single", "backlash", **thinning)]
    names = ("shear_thinning", 1.0), ("backlash", 0.9)
    rich = score(plants, [submit("n", "explained", names[0]), submit("a", "explained", *names)]).by_excitation["rich"]
    assert rich.mistakes.null == Rate(0, 1)
    assert rich.detectable.named == Rate(0, 1)  # the cause has to come first
    assert rich.calibration.count == 1
    wrong = score(plants[:1], [submit("n", "explained", ("backlash", 0.9))]).by_excitation["rich"]
    assert wrong.mistakes.null == Rate(1, 1)


def test_equivalents_are_evaluated_or_else_submitted():
    single = truth_of("p", "single", "backlash")
    wrong = submit("p", "explained", ("joint_play", 0.9))

    def found(submission, *evaluations):
        return score([single], [submission], evaluations).by_excitation["rich"].detectable

    assert found(wrong).named_equivalent == Rate(0, 1)
    claimed = submit("p", "explained", ("joint_play", 0.9, {}, ("backlash",)))
    assert found(claimed).named_equivalent == Rate(1, 1)
    assert found(claimed, Evaluation("p", equivalents={"backlash": ("backlash",)})).named_equivalent == Rate(0, 1)
    known = Evaluation("p", equivalents={"backlash": ("backlash", "joint_play")})
    assert found(wrong, known).named_equivalent == Rate(1, 1)
    assert found(wrong, known).named == Rate(0, 1)


def test_strata_of_the_plants():
    weak = {"signal_to_floor": 2.0, "stratum": "1-3"}
    plants = [
        truth_of("a", "single", "backlash"),
        truth_of("b", "single", "coil_lag", rate=25.0),
        truth_of("c", "single", "backlash", **weak),
        truth_of("d", "single", "backlash", excitation="sine"),
    ]
    found = score(plants, [submit("a", "explained", ("backlash", 0.9)), submit("d", "explained", ("coil_lag", 0.9))])
    named = {(rates.factor, rates.stratum): rates.named for rates in found.by_stratum}
    assert named["effect", "backlash"] == Rate(1, 1)
    assert named["effect", "coil_lag"] == Rate(0, 1)
    assert named["signal to floor", "1-3"] == Rate(0, 1)
    assert [stratum for factor, stratum in named if factor == "signal to floor"] == ["1-3", ">10"]
    assert [stratum for factor, stratum in named if factor == "rate"] == ["25 Hz", "500 Hz"]
    assert found.by_excitation["rich"].single.named == Rate(1, 3)
    assert found.by_excitation["rich"].detectable.named == Rate(1, 2)
    assert list(found.by_excitation) == ["rich", "sine"]
    assert found.by_excitation["sine"].candidate_sets.covers == Rate(0, 1)
    assert found.by_excitation["sine"].candidate_sets.named_wrong == Rate(1, 1)


# Pairs


def test_pairs():
    plants = [truth_of(f"p{k}", "pair", "backlash", "coil_lag") for k in range(4)]
    found = score(
        plants,
        [
            submit("p0", "explained", ("coil_lag", 0.9), ("backlash", 0.8)),
            submit("p1", "explained", ("backlash", 0.9)),
            submit("p2", "ambiguous", ("joint_play", 0.5), ("coil_lag", 0.9)),
            submit("p3", "unknown_effect"),
        ],
        [Evaluation("p2", equivalents={"backlash": ("backlash", "joint_play")})],
    )
    pairs = found.by_excitation["rich"].pairs
    assert pairs.both == pairs.both_detectable == Rate(1, 4)
    assert pairs.both_equivalent == Rate(2, 4)
    assert (pairs.precision, pairs.recall) == (Rate(4, 5), Rate(4, 8))
    assert pairs.f1 == pytest.approx(2 * 0.8 * 0.5 / 1.3)
    cells = {
        (row, column): count
        for row, cells in zip(found.confusion.rows, found.confusion.counts, strict=True)
        for column, count in zip(found.confusion.columns, cells, strict=True)
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


def test_one_name_does_not_stand_for_both_causes_of_a_pair():
    alike = {"backlash": ("joint_play",), "coil_lag": ("joint_play",)}
    one = submit("p", "explained", ("joint_play", 0.9))
    found = score([truth_of("p", "pair", "backlash", "coil_lag")], [one], [Evaluation("p", equivalents=alike)])
    assert found.by_excitation["rich"].pairs.both_equivalent.hits == 0


# Mistakes


def test_where_a_cause_was_lost_is_counted():
    def weighed(effect, probability, members=(), table=()):
        return WeighedEffect(effect, (effect, *members), probability, {}, dict.fromkeys((effect, *table), 0.5))

    plants = {
        "named": [weighed("backlash", 0.9)],
        "never": [weighed("gas_spring", 0.9)],
        "table": [weighed("gas_spring", 0.9, table=["backlash"])],
        "doubt": [weighed("joint_play", 0.3, ["backlash"]), weighed("gas_spring", 0.9, table=["backlash"])],
        "later": [weighed("backlash", 0.8)],
    }
    submissions = [
        submit(plant, "partly_explained", *([("backlash", 0.9)] if plant == "named" else []), weighed=tuple(entries))
        for plant, entries in plants.items()
    ]
    classes = score([truth_of(plant, "single", "backlash") for plant in plants], submissions).by_excitation["rich"].classes
    assert classes.right == Rate(1, 5)
    assert list(classes.lost.values()) == [Rate(1, 4)] * 4
    assert list(classes.lost) == list(LOST)


def test_alarms_and_wrong_names():
    plants = [
        *(truth_of(f"n{k}", "null") for k in range(4)),
        truth_of("o0", "null", perturbed=True),
        truth_of("o1", "null", perturbed=True),
        truth_of("x0", "absent", effects={"strange": {}}),
        truth_of("x1", "absent", effects={"strange": {}}),
        truth_of("x2", "absent", "pre_yield_hysteresis"),
    ]
    found = score(
        plants,
        [
            submit("n0", "no_gap"),
            submit("n1", "unknown_effect"),
            submit("n2", "explained", ("backlash", 0.9)),
            # n3 failed
            submit("o0", "unknown_effect", ("pre_yield_hysteresis", 1.0)),
            submit("o1", "unknown_effect"),
            submit("x0", "unknown_effect"),
            submit("x1", "ambiguous", ("backlash", 0.6)),
            submit("x2", "unknown_effect", ("pre_yield_hysteresis", 1.0)),
        ],
    )
    mistakes = found.by_excitation["rich"].mistakes
    assert (mistakes.null, mistakes.null_fitted, mistakes.null_other) == (Rate(3, 6), Rate(2, 4), Rate(1, 2))
    assert mistakes.false_unknown == Rate(2, 4)
    assert mistakes.absent == Rate(1, 3)
    assert found.failures == {"n3": "no submission"}


def test_needless_unknowns_are_those_that_the_catalogue_could_have_solved():
    plants = [
        truth_of("a", "single", "backlash"),
        truth_of("b", "single", "backlash", signal_to_floor=2.0),
        truth_of("c", "single", "backlash", perturbed=True),
        truth_of("d", "absent", "backlash", effects={"backlash": {}, "strange": {}}),
    ]
    found = score(plants, [submit(plant.plant, "unknown_effect") for plant in plants])
    assert found.by_excitation["rich"].mistakes.needless_unknown == Rate(1, 1)


def test_baseline_methods_are_compared_where_they_were_run():
    plants = [
        truth_of("a", "single", "backlash"),
        truth_of("b", "single", "coil_lag"),
        truth_of("n", "null"),
        truth_of("m", "null"),
    ]
    plants += [truth_of("unasked", "single", "gas_spring")]
    found = score(
        plants,
        [submit("a", "explained", ("backlash", 0.9)), *(submit(plant, "no_gap") for plant in ("b", "n", "m", "unasked"))],
        [
            Evaluation("a", rankings={"bic": ("coil_lag", "x", "backlash"), "score": ("backlash",)}),
            Evaluation("b", rankings={"bic": ("", "coil_lag"), "score": ()}),
            Evaluation("n", rankings={"bic": ("",), "score": ("x",)}),
            Evaluation("m", rankings={"bic": ("x",)}),
        ],
    )
    rows = {row.method: (row.first, row.first_three, row.false_alarms) for row in found.methods}
    assert rows["bic"] == (Rate(0, 2), Rate(2, 2), Rate(1, 2))
    assert rows["score"] == (Rate(1, 2), Rate(1, 2), Rate(1, 2))
    assert rows["diagnosis, named"] == (Rate(1, 2), Rate(1, 2), Rate(0, 2))


# Calibration, closure, map, coverage


def test_calibration_by_hand():
    found = calibration(np.array([0.95, 0.91, 0.35, 1.0]), np.array([True, False, False, True]))
    nine, three = (next(entry for entry in found.curve if entry.lower == lower) for lower in (0.9, 0.3))
    assert (nine.right, three.right) == (Rate(2, 3), Rate(0, 1))
    assert found.error == pytest.approx((3 * abs(2.86 / 3 - 2 / 3) + 0.35) / 4)
    assert found.brier == pytest.approx((0.05**2 + 0.91**2 + 0.35**2) / 4)
    assert found.log == pytest.approx(-(math.log(0.95) + math.log(0.09) + math.log(0.65)) / 4)


@pytest.mark.parametrize(("claims", "by_chance"), [(1, 0.5), (400, 0.5 * math.sqrt(2 / math.pi / 400))])
def test_right_probabilities_have_the_calibration_error_of_chance(claims, by_chance):
    found = calibration(np.full(claims, 0.5), np.arange(claims) % 2 == 0)
    assert found.by_chance == pytest.approx(by_chance, rel=0.05)


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_calibration_is_bounded_and_counts_everything(claims):
    found = calibration(*(np.array(part) for part in zip(*claims, strict=True)))
    assert 0 <= found.error <= 1
    assert 0 <= found.brier <= 1
    assert sum(entry.right.total for entry in found.curve) == found.count == len(claims)


def test_claims_are_causes_and_else_the_first_candidate():
    plants = [truth_of("a", "single", "backlash"), truth_of("b", "single", "backlash"), truth_of("n", "null")]
    rich = score(
        plants,
        [
            submit("a", "explained", ("backlash", 0.9), ("coil_lag", 0.8), candidates=[("backlash", 0.9)]),
            submit("b", "unknown_effect", candidates=[("backlash", 0.7), ("coil_lag", 0.3)]),
            submit("n", "no_gap", candidates=[("coil_lag", NAN)]),
        ],
    ).by_excitation["rich"]
    assert rich.calibration.count == 2
    assert rich.calibration.brier == pytest.approx((0.1**2 + 0.8**2) / 2)
    assert rich.calibration_with_candidates.count == 3
    assert rich.calibration_with_candidates.brier == pytest.approx((0.1**2 + 0.8**2 + 0.3**2) / 3)


def test_intervals_count_where_the_cause_is_right_and_has_one():
    true = {"backlash.width": 2e-4, "coil_lag.time": 0.01}
    plants = [truth_of(name, "pair", "backlash", "coil_lag", sizes=true) for name in "abc"]
    sizes = [
        {"backlash.width": (2.1e-4, 1.9e-4, 2.3e-4), "backlash.shape": (1.0, 0.9, 1.1)},
        {"backlash.width": (2.6e-4, 2.5e-4, 2.7e-4)},
        {"backlash.width": (2.0e-4, NAN, NAN)},
    ]
    found = score(
        plants,
        [
            submit(
                name, "explained", ("backlash", 0.9, of_plant), ("joint_play", 0.9, {"joint_play.width": (1.0, 0.0, 2.0)})
            )
            for name, of_plant in zip("abc", sizes, strict=True)
        ],
    ).by_excitation["rich"]
    assert found.coverage == Rate(1, 2)
    assert found.coverage_by_effect == {"backlash": Rate(1, 2)}


def test_closure_is_relative_to_what_could_be_closed():
    plants = [truth_of(name, "single", "backlash") for name in "abcd"]
    submissions = [
        replace(submit(name, "explained"), closed_fraction=(closed, NAN, NAN))
        for name, closed in zip("ab", (0.9, 0.4), strict=True)
    ]
    submissions.append(submit("c", "failed", failure="none"))
    evaluations = [
        Evaluation("a", oracle_closure=1.0, fresh_closure=0.7),
        Evaluation("b", oracle_closure=0.8, fresh_closure=0.5),
        Evaluation("c", oracle_closure=0.5),
        Evaluation("d"),
    ]
    rich = score(plants, submissions, evaluations).by_excitation["rich"]
    assert rich.relative_closure.values == pytest.approx((0.9, 0.5, 0.0))
    assert rich.relative_closure.median == pytest.approx(0.5)
    assert rich.fresh_difference.values == pytest.approx((0.2, 0.1))


def bins(axis, *shares):
    return [GapBin(axis, float(k), k + 1.0, share) for k, share in enumerate(shares)]


def test_overlap_by_hand():
    submitted = [*bins("velocity", 3.0, 1.0, -2.0), *bins("current", 1.0, 1.0), *bins("time", 1.0)]
    true = [*bins("velocity", 0.5, 0.5, 0.0, 4.0), *bins("current", 0.0, 1.0), *bins("time", 1.0)]
    axes = overlaps(submitted, true)
    assert axes.keys() == {"velocity", "current"}
    assert axes["velocity"] == AxisOverlap(pytest.approx(0.75), pytest.approx(2 / 3), True)
    assert axes["current"] == AxisOverlap(pytest.approx(0.5), pytest.approx(0.5), False)


@given(st.lists(st.floats(-1, 5), min_size=2, max_size=9))
def test_overlap_of_a_map_with_itself_is_whole(shares):
    axes = overlaps(bins("velocity", *shares), bins("velocity", *shares))
    assert [(axis.overlap, axis.same_largest_bin) for axis in axes.values()] == (
        [(pytest.approx(1.0), True)] if max(shares) > 0 else []
    )


# Next experiment, single sine


def test_experiments_are_counted_in_pairs():
    outcomes = [(True, True), (True, False), (True, False), (False, False), (False, True), (None, None)]
    plants = [truth_of(f"p{k}", "single", "backlash") for k in range(len(outcomes))]
    evaluations = [
        Evaluation(f"p{k}", advised_resolves=first, random_resolves=second) for k, (first, second) in enumerate(outcomes)
    ]
    plants[0] = replace(plants[0], excitation="sine")
    whole = score(plants, [], evaluations)
    found = next(goal.figure for goal in whole.goals if isinstance(goal.figure, ExperimentComparison))
    assert whole.by_excitation["rich"].experiments.advised == Rate(2, 4)
    assert (found.advised, found.random) == (Rate(3, 5), Rate(2, 5))
    assert (found.only_advised, found.only_random) == (2, 1)
    assert found.ratio == pytest.approx(1.5)


def test_sets_left_open():
    plants = [truth_of(f"p{k}", "single", "backlash", excitation="sine") for k in range(7)]
    sets = (
        score(
            plants,
            [
                submit("p0", "ambiguous", ("joint_play", 0.6, {}, ("backlash",))),
                submit("p1", "ambiguous", ("joint_play", 0.6), candidates=[("joint_play", 0.6), ("backlash", 0.06)]),
                submit("p2", "ambiguous", ("joint_play", 0.6), candidates=[("joint_play", 0.6), ("backlash", 0.04)]),
                submit("p3", "no_gap", untestable=("backlash", "coil_lag")),
                submit("p4", "unknown_effect"),
                submit("p6", "explained", ("joint_play", 1.0), candidates=[("backlash", 0.0, {}, ("joint_play",))]),
            ],
        )
        .by_excitation["sine"]
        .candidate_sets
    )
    assert sets.covers == Rate(5, 7)
    assert sets.holds_cause == Rate(4, 7)
    assert sets.named_wrong == Rate(3, 7)  # p0 says itself that it may be the backlash
    assert sets.size.values == (2.0, 2.0, 1.0, 2.0, 0.0, 2.0)


# Goals, tables, page


def test_goals_and_their_bounds():
    assert Goal("", Rate(19, 20), least=0.95).met
    assert Goal("", Rate(18, 20), least=0.95).met is False
    assert Goal("", Rate(0, 0), most=0.05).met is None
    assert Goal("", Distribution((0.2, 0.9, 1.0)), least=0.9).met
    assert Goal("", Rate(20, 20), least=0.9, most=0.99).met is False
    assert Goal("", ExperimentComparison(Rate(3, 4), Rate(0, 4), 3, 0), least=2.0).met
    assert Goal("", ExperimentComparison(Rate(0, 4), Rate(0, 4), 0, 0), least=2.0).met is None
    assert text(ExperimentComparison(Rate(3, 4), Rate(2, 4), 1, 0)) == "1.5 (3 against 2 of 4)"


def trial(seed=3, right=0.9, plants=120):
    """Answers, submissions and evaluations of a diagnosis that is right about this often."""
    random = np.random.default_rng(seed)
    effects = ("backlash", "coil_lag", "gas_spring", "moving_mass", "seal_friction", "channel_delay")
    answers, submissions, evaluations = [], [], []
    for place in range(plants):
        name = f"plant_{place:03d}"
        kind = str(random.choice(["null", "single", "pair", "absent"], p=[0.25, 0.4, 0.15, 0.2]))
        causes = tuple(map(str, random.choice(effects, {"single": 1, "pair": 2}.get(kind, 0), replace=False)))
        signal = 0.0 if kind == "null" else float(np.exp(random.uniform(0, 4)))
        answers.append(
            truth_of(
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
        named = causes if random.random() < right else tuple(map(str, random.choice(effects, 1)))
        verdict = "explained" if named else {"null": "no_gap", "absent": "unknown_effect"}[kind]
        shares = random.dirichlet(np.ones(6))
        found = tuple(
            Explanation((cause,), right, (right, 0.8, 1.0), {f"{cause}.size": (1.0, 0.9, 1.0 + random.normal(0.1, 0.06))})
            for cause in named
        )
        if place != 7:
            submissions.append(
                Submission(
                    name,
                    verdict,
                    "",
                    found,
                    (*found, explanation((str(random.choice(effects)), 0.1))),
                    closed_fraction=(0.93, 0.9, 0.97),
                    where=tuple(bins("velocity", *shares)),
                    elapsed=float(random.gamma(9.0)),
                )
            )
        blurred = tuple(bins("velocity", *(shares + random.dirichlet(np.ones(6)))))
        tried = (bool(random.random() < 0.7), bool(random.random() < 0.3)) if place % 9 == 0 else (None, None)
        rankings = {method: tuple(map(str, random.permutation(effects))) for method in ("bic", "random")}
        evaluations.append(Evaluation(name, float(random.uniform(0.9, 1.0)), blurred, 0.9, {}, rankings, *tried))
    return answers, submissions, evaluations


def test_tables_hold_the_figures():
    found = score(*trial())
    shown = markdown_tables(found)
    assert text(found.by_excitation["rich"].mistakes.null) in shown
    assert text(found.by_excitation["rich"].detectable.named_equivalent) in shown
    assert "| plant_007 | no submission |" in shown
    # Every table is whole: each line has as many cells as its header.
    for block in shown.split("### ")[1:]:
        assert len({line.count("|") for line in block.splitlines() if line.startswith("|")}) == 1
    assert "nan" not in shown


@pytest.mark.parametrize("kinds", [("null",), ("single",), ("absent", "pair")])
def test_a_page_and_tables_of_any_trial(tmp_path, kinds):
    parts = trial()
    kept = {truth.plant for truth in parts[0] if truth.kind in kinds}
    found = score(*([record for record in part if record.plant in kept] for part in parts))
    assert "nan" not in markdown_tables(found)
    page = write_score_report(found, tmp_path).read_text(encoding="utf-8")
    assert text(found.by_excitation["rich"].mistakes.null) in page
    assert not re.search(r'(src|href)="(https?:)?//', page.rpartition("<h1>")[2])
    assert [path.name for path in tmp_path.iterdir()] == ["score.html"]


def test_failures_never_improve_a_score():
    answers, submissions, evaluations = trial(right=1.0, plants=60)
    whole, broken = score(answers, submissions, evaluations), score(answers, submissions[::2], evaluations)
    for before, after in zip(whole.goals, broken.goals, strict=True):
        if isinstance(before.figure, Rate) and np.isinf(before.most):
            assert after.figure.hits <= before.figure.hits
        elif isinstance(before.figure, Rate) and np.isinf(before.least):
            assert after.figure.hits >= before.figure.hits
    assert whole.by_excitation["rich"].mistakes.null.value < broken.by_excitation["rich"].mistakes.null.value


def test_records_that_cannot_be_scored_are_refused():
    with pytest.raises(InputError, match="no plants"):
        score([], [])
    with pytest.raises(InputError, match="plant b has no answer"):
        score([truth_of("a", "null")], [submit("b", "no_gap")])
    with pytest.raises(InputError, match="0 causes do not fit"):
        score([truth_of("a", "single")], [])
