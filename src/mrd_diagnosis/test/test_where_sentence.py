"""One sentence says where the error lies, and one whether the named causes must show there."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import pytest

from mrd_diagnosis.diagnosis import Axis, Interval, Region
from mrd_diagnosis.localisation.sentence import agreement_sentence, headline_place, share_in_words, where_sentence
from mrd_sim.effects import EFFECTS, PLACES

NAN = float("nan")


def region(axis, label, share, lift, q_value=0.001, ends=(0.0, 1.0)):
    return Region(axis, *ends, "", Interval(share), lift, q_value, label)


NEAR = region("reversal", "within 0.2 mm after a reversal", 0.55, 5.5, ends=(0.0, 2e-4))
NEXT = region("reversal", "0.2 to 0.5 mm after a reversal", 0.21, 3.5, ends=(2e-4, 5e-4))
FAR = region("reversal", "more than 0.5 mm after a reversal", 0.24, 0.3, 1.0, ends=(5e-4, 0.02))
RUN = region("run", "run 3", 0.6, 2.0)
SPEED = region("velocity", "speeds above 50 mm/s", 0.9, 9.0)
LINE = region("frequency", "an oscillation near 50 Hz", 0.97, NAN, NAN)


def located(*where, causes=(), alternatives=(), oscillation=None):
    named = [[SimpleNamespace(effect=name) for name in names] for names in (causes, alternatives)]
    return SimpleNamespace(where=where, oscillation=oscillation, causes=named[0], alternatives=named[1])


def test_bins_from_an_event_on_are_one_place():
    assert where_sentence(located(NEAR, NEXT, RUN, FAR)) == (
        "Three quarters of the error lie within 0.5 mm after a reversal, which is 16 % of the samples."
    )
    alone = region(NEXT.axis, NEXT.label, NEXT.share.value, NEXT.lift, 0.5, (NEXT.lower, NEXT.upper))
    assert where_sentence(located(NEAR, RUN, alone, FAR), "the remaining error") == (
        "55 % of the remaining error lies within 0.2 mm after a reversal, which is 10 % of the samples."
    )
    thin = region(NEXT.axis, NEXT.label, NEXT.share.value, 2.1, 0.001, (NEXT.lower, NEXT.upper))
    assert headline_place((NEAR, thin, RUN, FAR)).label == "within 0.2 mm after a reversal"


def test_speed_and_what_is_not_significant_are_no_place():
    assert where_sentence(located(SPEED, region("run", "run 3", 0.9, 3.0, 0.2))) == ""
    assert where_sentence(located(region("run", "run 3", 0.3, 1.1))) == ""
    assert where_sentence(located(SPEED, RUN)) == "60 % of the error lies in run 3, which is 30 % of the samples."


@pytest.mark.parametrize(
    ("axis", "label", "words"),
    [
        ("run", "run3", "lies in run3"),
        ("current", "at up to 0.2 A", "lies at up to 0.2 A"),
        ("time", "the first 10 s of the recordings", "lies in the first"),
        ("position", "positions above 5 mm", "lies at positions above"),
        ("sign", "while extending", "lies while extending"),
    ],
)
def test_a_place_has_its_preposition(axis, label, words):
    assert words in where_sentence(located(region(axis, label, 0.6, 2.0)))


def test_a_run_is_named_in_place_of_the_time_at_which_it_was_recorded():
    time = region("time", "the first 10 s of the recordings", 0.61, 2.1)
    assert headline_place((time, RUN)) is RUN
    late = region("time", "from 50 s of the recordings on", 0.6, 4.0)
    assert headline_place((late, RUN)) is late


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.99, ("nearly all of", "lies")),
        (0.89, ("nine tenths of", "lie")),
        (0.76, ("three quarters of", "lie")),
        (0.65, ("two thirds of", "lie")),
        (0.62, ("62 % of", "lies")),
        (0.5, ("half of", "lies")),
        (0.33, ("a third of", "lies")),
        (0.08, ("8 % of", "lies")),
    ],
)
def test_shares_are_read_aloud(share, words):
    assert share_in_words(share) == words


def test_a_cause_agrees_where_it_must_show():
    assert agreement_sentence(located(NEAR, NEXT, FAR, causes=["joint_play"])) == "That is where play in a joint must show."
    both = agreement_sentence(located(NEAR, NEXT, FAR, causes=["joint_play", "channel_delay"]))
    assert both == "That is where play in a joint and delay of the force channel must show."
    assert agreement_sentence(located(RUN, NEAR, FAR, causes=["joint_play"])) == (
        "The error is also larger after reversals, where play in a joint must show."
    )
    assert agreement_sentence(located(RUN, causes=["mains_hum"], oscillation=LINE)) == "That is how mains hum must show."


def test_high_accelerations_are_not_the_lowest_ones():
    low = region("acceleration", "accelerations below 0.5 m/s²", 0.6, 2.0)
    high = region("acceleration", "accelerations above 0.5 m/s²", 0.4, 0.6, 1.0, (0.5, 5.0))
    assert "elsewhere" in agreement_sentence(located(NEAR, FAR, low, high, causes=["moving_mass"]))
    low, high = replace(low, q_value=1.0), replace(high, q_value=0.001)
    assert agreement_sentence(located(NEAR, FAR, low, high, causes=["moving_mass"])) == (
        "The error is also larger at high accelerations, where moving mass must show."
    )


def test_a_cause_agrees_with_a_place_only_where_that_is_named():
    thin = replace(NEAR, share=Interval(0.4))
    assert where_sentence(located(thin, FAR, oscillation=LINE)) == (
        "Nearly all of the error (97 %) is an oscillation near 50 Hz."
    )
    assert agreement_sentence(located(thin, FAR, causes=["joint_play"], oscillation=LINE)) == (
        "The error is also larger after reversals, where play in a joint must show."
    )


def test_a_cause_contradicts_only_a_place_without_more_error():
    fewer = region("reversal", NEAR.label, 0.05, 0.5, 1.0, (0.0, 2e-4))
    far = region("reversal", FAR.label, 0.95, 1.06, 0.01, (2e-4, 0.02))
    assert agreement_sentence(located(RUN, fewer, far, causes=["joint_play"])) == (
        "Play in a joint would show after reversals, and the error lies elsewhere."
    )
    unsure = region("reversal", NEAR.label, 0.3, 3.0, 0.3, (0.0, 2e-4))
    assert agreement_sentence(located(RUN, unsure, far, causes=["joint_play"])) == ""


def test_the_place_speaks_for_one_of_two_alternatives():
    step = region("step", "within 10 ms after a step of the current", 0.01, 0.5, 1.0, (0.0, 0.01))
    away = region("step", "away from steps of the current, by more than 10 ms", 0.99, 1.01, 1.0, (0.01, 3.0))
    assert agreement_sentence(located(NEAR, NEXT, FAR, step, away, causes=["channel_delay"], alternatives=["coil_lag"])) == (
        "That is where delay of the force channel must show. "
        "Lag behind the coil current would show after steps of the current, and the error lies elsewhere."
    )


@pytest.mark.parametrize("causes", [(), ("load_cell_gain",), ("an_effect_of_another_folder",)])
def test_without_a_place_where_the_cause_must_show_nothing_is_said(causes):
    assert agreement_sentence(located(NEAR, NEXT, FAR, causes=causes)) == ""


def test_nothing_is_said_where_no_place_is_significant():
    assert agreement_sentence(located(SPEED, causes=["joint_play"])) == ""
    assert agreement_sentence(located(causes=["joint_play"])) == ""


def test_effects_show_on_axes_of_the_diagnosis():
    assert PLACES.keys() <= set(get_args(Axis))
    assert {place for effect in EFFECTS.values() for place in effect.shows} == PLACES.keys()
