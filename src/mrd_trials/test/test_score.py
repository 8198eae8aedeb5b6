"""Scores against figures worked out by hand."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from mrd_base import InputError
from mrd_trials.records import Evaluation, Explanation, GapBin, GroundTruth, Submission, WeighedEffect
from mrd_trials.scoring.around_models import found_around_all
from mrd_trials.scoring.classes import LOST
from mrd_trials.scoring.gap import AxisOverlap, overlaps
from mrd_trials.scoring.goals import judge
from mrd_trials.scoring.rates import Calibration, Distribution, Rate, calibration
from mrd_trials.scoring.report import write_score_report
from mrd_trials.scoring.score import score_trial
from mrd_trials.scoring.tables import goal_table, judgements, markdown_tables, tabulate, text

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
        ("failed", NAN, None, 0, 1),
    ],
)
def test_a_large_error_should_have_a_place(verdict, before, has_place, hits, total):
    submission = submit("a", verdict, before=before, after=0.02, noise_floor=0.01, has_place=has_place)
    rate = score([truth_of("a", "single", "backlash")], [submission]).tiers["rich"].places
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
    rate = score_trial(answers, by_model[0], {}, by_model).tiers["rich"].around_models
    # Nobody found that of c, e has no second verdict, and a black box is diagnosed around no model.
    assert (rate.hits, rate.total) == (1, 2)
    assert found_around_all(answers.values(), []) == Rate(0, 0)


# Clopper-Pearson


@given(st.integers(0, 60), st.integers(0, 60))
def test_interval_of_a_rate(hits, misses):
    if not hits + misses:
        assert all(map(math.isnan, (Rate(0, 0).value, Rate(0, 0).lower, Rate(0, 0).upper)))
        return
    rate = Rate(hits, hits + misses)
    expected = binomtest(hits, hits + misses).proportion_ci(0.95, "exact")
    assert rate.lower == pytest.approx(expected.low, abs=1e-9)
    assert rate.upper == pytest.approx(expected.high, abs=1e-9)


# Names


def named_as_class(*members, leading=None, **changed):
    return Explanation((leading or members[0],), 0.5, NO_INTERVAL, level="class", members=members, **changed)


@pytest.mark.parametrize("verdict", ["explained", "partly_explained", "ambiguous", "unknown_effect"])
def test_a_name_counts_whatever_the_verdict(verdict):
    plants = [truth_of("a", "single", "backlash"), truth_of("n", "null")]
    rich = score(plants, [submit(name, verdict, ("backlash", 1.0)) for name in "an"]).tiers["rich"]
    assert rich.classes.right == rich.classes.cause == Rate(1, 1)
    assert rich.classes.null == Rate(1, 1)
    assert rich.classes.effect == Rate(1, 2)
    assert rich.calibration.count == 2


def test_a_class_is_judged_by_its_own_probability():
    """One of two effects that look alike has half of the probability, and their class has all of it."""
    named = named_as_class("joint_play", "backlash", class_probability=0.95)
    plants = [truth_of("a", "single", "backlash"), truth_of("b", "single", "coil_lag")]
    found = score(plants, [Submission("a", "ambiguous", causes=(named,)), submit("b", "explained", ("coil_lag", 0.85))])
    assert [(entry.mean, entry.right) for entry in found.tiers["rich"].calibration.curve] == [
        (pytest.approx(0.85), Rate(1, 1)),
        (pytest.approx(0.95), Rate(1, 1)),
    ]


def test_what_the_form_of_the_damper_contains_is_neither_right_nor_wrong():
    thinning = {"implied": ("shear_thinning",), "perturbed": True}
    plants = [truth_of("n", "null", **thinning), truth_of("a", "single", "backlash", **thinning)]
    names = ("shear_thinning", 1.0), ("backlash", 0.9)
    found = score(
        plants,
        [submit("n", "explained", names[0]), submit("a", "explained", *names)],
        [Evaluation(plant, rankings={"bic": ("shear_thinning", "", "backlash")}) for plant in "na"],
    )
    rich = found.tiers["rich"]
    assert rich.classes.null == Rate(0, 1)
    assert rich.classes.wrong == Rate(0, 1)
    assert rich.classes.effect == Rate(1, 1)
    assert rich.classes.members.values == (1.0,)
    assert rich.calibration.count == 1
    assert [(row.first, row.false_alarms) for row in found.methods] == [
        (Rate(1, 1), Rate(0, 1)),
        (Rate(1, 1), Rate(0, 0)),
        (Rate(0, 1), Rate(0, 1)),
    ]
    wrong = score(plants[:1], [submit("n", "explained", ("backlash", 0.9))]).tiers["rich"]
    assert wrong.classes.null == Rate(1, 1)


def test_the_simulator_of_a_black_box_has_what_the_form_contains():
    plant = truth_of("n", "null", implied=("bypass_flow",), perturbed=True, excitation="black_box")
    box = score([plant], [submit("n", "explained", ("bypass_flow", 0.9))]).tiers["black_box"]
    assert box.classes.null == Rate(1, 1)
    assert box.calibration.right == 0.0


def test_strata_of_the_plants():
    weak = {"signal_to_floor": 2.0, "stratum": "1-3"}
    plants = [
        truth_of("a", "single", "backlash"),
        truth_of("b", "single", "coil_lag", rate=25.0, base="dahl"),
        truth_of("c", "single", "backlash", **weak),
        truth_of("d", "single", "backlash", excitation="sine"),
    ]
    found = score(plants, [submit("a", "explained", ("backlash", 0.9)), submit("d", "explained", ("coil_lag", 0.9))])
    assert [(entry.factor, entry.name, entry.right) for entry in found.tiers["rich"].strata] == [
        ("strength", "1-3", Rate(0, 1)),
        ("strength", ">10", Rate(1, 2)),
        ("effect", "backlash", Rate(1, 1)),
        ("effect", "coil_lag", Rate(0, 1)),
        ("damper", "bouc_wen", Rate(1, 1)),
        ("damper", "dahl", Rate(0, 1)),
        ("rate", "25 Hz", Rate(0, 1)),
        ("rate", "500 Hz", Rate(1, 1)),
    ]
    assert found.tiers["rich"].classes.right == Rate(1, 2)
    assert list(found.tiers) == ["rich", "sine"]


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
    )
    assert found.tiers["rich"].classes.both == Rate(1, 4)
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


def test_each_cause_of_a_pair_needs_a_class_of_its_own():
    alike = named_as_class("backlash", "joint_play")
    one, both = Submission("a", "ambiguous", causes=(alike,)), Submission("b", "ambiguous", causes=(alike, alike))
    classes = score([truth_of(plant, "pair", "backlash", "joint_play") for plant in "ab"], [one, both]).tiers["rich"].classes
    assert classes.both == Rate(1, 2)


def test_sets_are_calibrated_where_the_class_is_right():
    plants = {
        "right": named_as_class("backlash", "joint_play", plausible=("backlash",)),
        "left out": named_as_class("backlash", "joint_play", plausible=("joint_play",)),
        "wrong": Explanation(("coil_lag",), 0.9, NO_INTERVAL, plausible=("coil_lag", "gas_spring")),
        "stands for": Explanation(("joint_play",), 0.9, NO_INTERVAL, plausible=("joint_play",)),
    }
    weighed = WeighedEffect("joint_play", ("joint_play", "backlash"), 0.9, {}, {})
    classes = (
        score(
            [truth_of(plant, "single", "backlash") for plant in plants],
            [
                Submission(plant, "ambiguous", causes=(cause,), weighed=(weighed,) if plant == "stands for" else ())
                for plant, cause in plants.items()
            ],
        )
        .tiers["rich"]
        .classes
    )
    assert classes.covered == Rate(1, 3)
    assert classes.covered_named == Rate(1, 4)
    assert classes.set_sizes.median == 1.0


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
    classes = score([truth_of(plant, "single", "backlash") for plant in plants], submissions).tiers["rich"].classes
    assert classes.right == Rate(1, 5)
    assert list(classes.lost.values()) == [Rate(1, 4)] * 4
    assert list(classes.lost) == list(LOST)


def test_alarms_and_wrong_names():
    plants = [
        *(truth_of(f"n{k}", "null", perturbed=k > 2) for k in range(6)),
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
            submit("n4", "unknown_effect", ("pre_yield_hysteresis", 1.0)),
            submit("n5", "unknown_effect"),
            submit("x0", "unknown_effect"),
            submit("x1", "ambiguous", ("backlash", 0.6)),
            submit("x2", "unknown_effect", ("pre_yield_hysteresis", 1.0)),
        ],
    )
    classes = found.tiers["rich"].classes
    assert (classes.null, classes.absent, classes.wrong) == (Rate(3, 6), Rate(1, 3), Rate(1, 3))
    assert found.failures == {"n3": "no submission"}


def test_baseline_methods_are_compared_where_they_were_run():
    plants = [
        truth_of("a", "single", "backlash"),
        truth_of("b", "single", "coil_lag"),
        truth_of("n", "null"),
        truth_of("m", "null"),
    ]
    plants += [truth_of(plant, "single", "gas_spring") for plant in ("unasked", "failed", "refused")]
    found = score(
        plants,
        [submit("a", "explained", ("backlash", 0.9)), *(submit(plant, "no_gap") for plant in ("b", "n", "m", "unasked"))],
        [
            Evaluation("a", rankings={"bic": ("coil_lag", "x", "backlash"), "score": ("backlash",)}),
            Evaluation("b", rankings={"bic": ("", "coil_lag"), "score": ()}),
            Evaluation("n", rankings={"bic": ("",), "score": ("x",)}),
            Evaluation("m", rankings={"bic": ("x",)}),
            Evaluation("failed", rankings={"bic": ("gas_spring",)}),
        ],
    )
    rows = {row.method: (row.first, row.false_alarms) for row in found.methods}
    # A method has run where the diagnosis failed; where none could run, nothing is compared.
    assert rows["bic"] == (Rate(1, 3), Rate(1, 2))
    assert rows["score"] == (Rate(1, 3), Rate(1, 2))
    assert rows["diagnosis, named"] == (Rate(1, 3), Rate(0, 2))


# Calibration, closure, map, coverage


def test_calibration_by_hand():
    found = calibration(np.array([0.95, 0.91, 0.35, 1.0]), np.array([True, False, False, True]))
    nine, three = (next(entry for entry in found.curve if entry.lower == lower) for lower in (0.9, 0.3))
    assert (nine.right, three.right) == (Rate(2, 3), Rate(0, 1))
    assert found.error == pytest.approx((3 * abs(2.86 / 3 - 2 / 3) + 0.35) / 4)
    assert (found.stated, found.right) == (pytest.approx(3.21 / 4), 0.5)


@pytest.mark.parametrize(("claims", "by_chance"), [(1, 0.5), (400, 0.5 * math.sqrt(2 / math.pi / 400))])
def test_right_probabilities_have_the_calibration_error_of_chance(claims, by_chance):
    found = calibration(np.full(claims, 0.5), np.arange(claims) % 2 == 0)
    assert found.by_chance == pytest.approx(by_chance, rel=0.05)


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40))
def test_calibration_is_bounded_and_counts_everything(claims):
    found = calibration(*(np.array(part) for part in zip(*claims, strict=True)))
    assert 0 <= found.error <= 1
    assert sum(entry.right.total for entry in found.curve) == found.count == len(claims)


def test_classes_that_were_weighed_are_calibrated_whether_named_or_not():
    weighed = [WeighedEffect("joint_play", ("joint_play", "backlash"), 0.6, {}, {}), WeighedEffect("a", ("a",), 0.3, {}, {})]
    found = score([truth_of("p", "single", "backlash")], [submit("p", "unknown_effect", weighed=tuple(weighed))])
    presence = found.tiers["rich"].presence
    assert (presence.count, presence.stated, presence.right) == (2, pytest.approx(0.45), 0.5)
    assert text(presence).startswith("0.350 (2 claims; by chance ")
    assert text(presence).endswith("0.45 stated, 0.50 right)")


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
    ).tiers["rich"]
    assert found.coverage == Rate(1, 2)
    assert found.coverage_by_effect == {"backlash": Rate(1, 2)}


def test_closure_is_relative_to_what_could_be_closed():
    plants = [truth_of(name, "single", "backlash") for name in "abcde"]
    submissions = [*(submit(name, "explained") for name in "abe"), submit("c", "failed", failure="none")]
    evaluations = [
        Evaluation("a", oracle_closure=1.0, closure=0.9, fresh_closure=0.7),
        Evaluation("b", oracle_closure=0.8, closure=0.4, fresh_closure=0.5),
        Evaluation("c"),
        Evaluation("e", oracle_closure=-0.1, closure=0.5),
    ]
    rich = score(plants, submissions, evaluations).tiers["rich"]
    # Two diagnoses failed, and close nothing; one gap cannot be closed.
    assert rich.relative_closure.values == pytest.approx((0.9, 0.5, 0.0, 0.0))
    assert rich.fresh_closure.values == pytest.approx((0.7, 0.5, 0.0, 0.0))


def test_a_map_that_is_not_there_overlaps_with_nothing():
    half = tuple(bins("velocity", 1.0, 1.0))
    plants = [
        *(truth_of(name, "single", "backlash") for name in "abcd"),
        truth_of("weak", "single", "a", signal_to_floor=1.0),
    ]
    submissions = [
        submit("a", "explained", where=half),
        submit("b", "data_fault"),
        submit("c", "partly_explained", where=half),  # its map is that of what remains
        submit("weak", "no_gap"),
    ]
    true = tuple(bins("velocity", 1.0, 0.0))
    maps = score(plants, submissions, [Evaluation(name, true_map=true) for name in "ac"]).tiers["rich"].maps
    assert maps.overlap.values == (0.5, 0.0, 0.0)
    assert maps.uniform.values == (0.5,)


def bins(axis, *shares):
    return [GapBin(axis, float(k), k + 1.0, share) for k, share in enumerate(shares)]


def test_overlap_by_hand():
    submitted = [*bins("velocity", 3.0, 1.0, -2.0), *bins("current", 1.0, 1.0), *bins("time", 1.0)]
    true = [*bins("velocity", 0.5, 0.5, 0.0, 4.0), *bins("current", 0.0, 1.0), *bins("time", 1.0)]
    axes = overlaps(submitted, true)
    assert axes.keys() == {"velocity", "current"}
    assert axes["velocity"] == AxisOverlap(pytest.approx(0.75), pytest.approx(2 / 3))
    assert axes["current"] == AxisOverlap(pytest.approx(0.5), pytest.approx(0.5))


@given(st.lists(st.floats(-1, 5), min_size=2, max_size=9))
def test_overlap_of_a_map_with_itself_is_whole(shares):
    axes = overlaps(bins("velocity", *shares), bins("velocity", *shares))
    assert [axis.overlap for axis in axes.values()] == ([pytest.approx(1.0)] if max(shares) > 0 else [])


def test_experiments_are_counted_in_pairs():
    outcomes = [(True, True), (True, False), (False, True), (None, None)]
    plants = [truth_of(f"p{k}", "single", "backlash") for k in range(len(outcomes))]
    evaluations = [
        Evaluation(f"p{k}", advised_resolves=first, random_resolves=second) for k, (first, second) in enumerate(outcomes)
    ]
    rich = score(plants, [], evaluations).tiers["rich"]
    assert (rich.advised, rich.random) == (Rate(2, 3), Rate(2, 3))


# Goals, tables, page


@pytest.mark.parametrize(
    ("figure", "wanted", "expected"),
    [
        (Rate(0, 1), (-np.inf, 0.05), "undecided"),
        (Rate(0, 19), (-np.inf, 0.05), "undecided"),
        (Rate(0, 20), (-np.inf, 0.05), "met"),
        (Rate(1, 1), (-np.inf, 0.05), "undecided"),
        (Rate(3, 20), (-np.inf, 0.05), "not met"),
        (Rate(18, 20), (0.85, np.inf), "met"),
        (Rate(17, 20), (0.85, np.inf), "undecided"),
        (Rate(15, 20), (0.85, np.inf), "not met"),
        (Rate(5, 5), (0.87, 0.95), "undecided"),
        (Rate(0, 0), (0.85, np.inf), "undecided"),
        (Distribution((0.2, 0.95, 1.0)), (0.9, np.inf), "undecided"),
        (Distribution((0.2, 0.95, 0.95, 0.96, 1.0)), (0.9, np.inf), "met"),
        (Distribution((0.2, 0.2, 1.0)), (0.9, np.inf), "undecided"),
        (Distribution((0.1, 0.2, 0.2, 0.3, 1.0)), (0.9, np.inf), "not met"),
        (Distribution(()), (0.9, np.inf), "undecided"),
        (Calibration(99, (), 0.01, 0.01, 0.5, 0.5), (-np.inf, 0.08), "undecided"),
        (Calibration(100, (), 0.08, 0.01, 0.5, 0.5), (-np.inf, 0.08), "met"),
        (Calibration(100, (), 0.09, 0.01, 0.5, 0.5), (-np.inf, 0.08), "not met"),
    ],
)
def test_a_goal_is_decided_where_no_single_case_would_change_that(figure, wanted, expected):
    assert judge(figure, wanted) == expected


def test_the_documented_goals_are_those_that_are_judged():
    assert goal_table() in (Path(__file__).resolve().parents[3] / "docs/trials.md").read_text(encoding="utf-8")


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
                    where=tuple(bins("velocity", *shares)),
                    elapsed=float(random.gamma(9.0)),
                )
            )
        blurred = tuple(bins("velocity", *(shares + random.dirichlet(np.ones(6)))))
        tried = (bool(random.random() < 0.7), bool(random.random() < 0.3)) if place % 9 == 0 else (None, None)
        rankings = {method: tuple(map(str, random.permutation(effects))) for method in ("bic", "random")}
        oracle = float(random.uniform(0.9, 1.0))
        evaluations.append(Evaluation(name, "", oracle, 0.93, blurred, 0.9, rankings, *tried))
    return answers, submissions, evaluations


def test_tables_hold_the_figures():
    found = score(*trial())
    shown = markdown_tables(found)
    rich = found.tiers["rich"]
    goals = {row[0]: row[1:] for row in tabulate(found)[0].rows}
    assert goals["detectable single effects: class named"] == (text(rich.classes.right), "≥ 92 %", "undecided")
    assert goals["overlap of the map with the true one, median (quartiles)"][2] == "not met"
    assert text(rich.relative_closure) in shown
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
    assert text(found.tiers["rich"].classes.wrong) in page
    assert not re.search(r'(src|href)="(https?:)?//', page.rpartition("<h1>")[2])
    assert [path.name for path in tmp_path.iterdir()] == ["score.html"]


def test_failures_never_improve_a_score():
    answers, submissions, evaluations = trial(right=1.0, plants=60)
    whole, broken = score(answers, submissions, evaluations), score(answers, submissions[::2], evaluations)
    assert set(judgements(broken)) == {"not met", "undecided"}
    before, after = whole.tiers["rich"], broken.tiers["rich"]
    for name in ("right", "cause", "both"):
        assert getattr(after.classes, name).value < getattr(before.classes, name).value
    for name in ("null", "wrong", "absent"):
        assert getattr(after.classes, name).value > getattr(before.classes, name).value
    for name in ("relative_closure", "fresh_closure"):
        assert np.mean(getattr(after, name).values) < np.mean(getattr(before, name).values)
    assert np.mean(after.maps.overlap.values) < np.mean(before.maps.overlap.values)


def test_records_that_cannot_be_scored_are_refused():
    with pytest.raises(InputError, match="no plants"):
        score([], [])
    with pytest.raises(InputError, match="plant b has no answer"):
        score([truth_of("a", "null")], [submit("b", "no_gap")])
    with pytest.raises(InputError, match="0 causes do not fit"):
        score([truth_of("a", "single")], [])
