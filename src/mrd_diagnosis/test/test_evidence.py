"""Numbers that speak for an effect or against it."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_diagnosis.decision import presence
from mrd_diagnosis.decision.presence import plausible_set, presence_model, presence_of, with_presence
from mrd_diagnosis.evidence import evidence
from mrd_diagnosis.evidence.evidence import EVIDENCE, Evidence, balance_of_folds, lead_over, measure_evidence, share_closed


def refit(*costs):
    return SimpleNamespace(held_out_cost=float(np.sum(costs)), held_out_costs=np.array(costs, dtype=float))


finite = st.floats(0.0, 1e6)
DOCUMENT = Path(__file__).parents[3] / "docs" / "diagnosis.md"
AGAINST = {entry.name for entry in EVIDENCE if entry.against}


@given(st.lists(finite, min_size=3, max_size=3), st.lists(finite, min_size=3, max_size=3), finite)
def test_shares_lie_between_minus_one_and_one(before, after, noise):
    without, fitted = refit(*before), refit(*after)
    for value in (
        share_closed(without, fitted, noise),
        lead_over(without, fitted, [refit(noise)]),
        balance_of_folds(without, fitted),
    ):
        assert -1.0 <= value <= 1.0


def test_an_effect_that_closes_half_of_the_gap():
    without, fitted = refit(30.0, 30.0), refit(20.0, 20.0)
    assert share_closed(without, fitted, 20.0) == pytest.approx(0.5)
    assert lead_over(without, fitted, [refit(25.0, 25.0)]) == pytest.approx(0.5)
    assert lead_over(without, fitted, []) == pytest.approx(1.0)
    assert balance_of_folds(without, fitted) == pytest.approx(1.0)
    assert balance_of_folds(refit(30.0, 30.0), refit(10.0, 50.0)) == pytest.approx(0.0)


def test_what_diverges_gains_nothing_and_all_numbers_stay_finite():
    diverged, sound = refit(np.inf, 10.0), refit(10.0, 10.0)
    assert share_closed(sound, diverged, 5.0) == -1.0
    assert share_closed(diverged, sound, 5.0) == 1.0
    assert lead_over(sound, diverged, [sound]) == pytest.approx(0.0)
    assert np.isfinite(lead_over(diverged, sound, [diverged]))


def test_a_fold_that_diverges_is_no_gain():
    assert balance_of_folds(refit(np.inf, 10.0), refit(10.0, 20.0)) == pytest.approx(-1.0)


def test_the_shipped_weights_are_those_of_the_evidence_and_have_signs_that_make_sense():
    weights = presence_model().weights
    assert set(weights) <= {entry.name for entry in EVIDENCE}
    for name, weight in weights.items():
        assert weight <= 0.0 if name in AGAINST else weight >= 0.0
    assert presence_model().card["left out by damper"]["calibration error"] < 0.2


@given(
    st.dictionaries(st.sampled_from(["", *"abcdef"]), st.floats(0.0, 1.0), min_size=2).filter(
        lambda d: sum(d.values()) > 0.1
    ),
    st.floats(0.0, 1.0),
    st.data(),
)
def test_the_class_has_the_learnt_probability_and_nothing_gains_by_it(weights, presence, data):
    table = {name: weight / sum(weights.values()) for name, weight in weights.items()}
    effects = [name for name in table if name]
    members = effects[: data.draw(st.integers(1, len(effects)))]
    probabilities = with_presence(table, members, presence)
    assert sum(probabilities[name] for name in members) == pytest.approx(presence)
    assert sum(probabilities.values()) <= 1.0 + 1e-9
    assert all(probabilities[name] <= table[name] + 1e-12 for name in effects if name not in members)


@given(st.dictionaries(st.sampled_from("abcdef"), st.floats(0.01, 1.0), min_size=1))
def test_a_plausible_set_begins_with_the_likeliest_and_is_no_larger_than_it_must_be(probabilities):
    found = plausible_set(probabilities)
    assert 1 <= len(found) <= len(probabilities)
    assert probabilities[found[0]] == max(probabilities.values())
    smaller = sum(probabilities[name] for name in found[:-1]) / sum(probabilities.values())
    assert len(found) == 1 or smaller < presence_model().set_share + 1e-9


@given(st.data())
def test_more_evidence_never_lowers_the_probability(data):
    names = [entry.name for entry in EVIDENCE]
    less = {name: data.draw(st.floats(0.0, 1.0), label=name) for name in names}
    name = data.draw(st.sampled_from(names))
    more = less | {name: data.draw(st.floats(less[name], 1.0), label="more")}
    gained = presence_of(more) - presence_of(less)
    assert gained <= 0.0 if name in AGAINST else gained >= 0.0


def test_a_new_piece_of_evidence_is_one_entry_and_has_no_weight_until_it_is_learnt(monkeypatch):
    entry = Evidence("new", "what nobody has measured yet", lambda fits: len(fits.effect))
    monkeypatch.setattr(evidence, "EVIDENCE", (entry,))
    monkeypatch.setattr(presence, "EVIDENCE", (*EVIDENCE, entry))
    assert measure_evidence(SimpleNamespace(effect="end_stop")) == {"new": 8}
    assert "| `new` | what nobody has measured yet | not learnt yet |\n" in presence.markdown_table()
    known = {known.name: 0.5 for known in EVIDENCE}
    assert presence_of(known | {"new": 8.0}) == presence_of(known)


def test_the_documentation_has_the_evidence():
    assert presence.markdown_table() in DOCUMENT.read_text(encoding="utf-8")
