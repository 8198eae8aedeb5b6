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
from mrd_diagnosis.evidence.evidence import (
    EVIDENCE,
    LARGEST_DRIFT,
    LEAST_DRIFT,
    Evidence,
    drift_over_runs,
    measure_evidence,
    share_closed,
)
from mrd_sim.effects import EFFECTS

DOCUMENT = Path(__file__).parents[3] / "docs" / "diagnosis.md"
AGAINST = {entry.name for entry in EVIDENCE if entry.against}


def refit(cost):
    return SimpleNamespace(held_out_cost=cost)


@given(st.floats(0.0, 1e6), st.floats(0.0, 1e6), st.floats(0.0, 1e6))
def test_shares_lie_between_minus_one_and_one(before, after, noise):
    assert -1.0 <= share_closed(refit(before), refit(after), noise) <= 1.0


def test_an_effect_that_closes_half_of_the_gap():
    assert share_closed(refit(60.0), refit(40.0), 20.0) == pytest.approx(0.5)


def test_what_diverges_closes_nothing():
    assert share_closed(refit(20.0), refit(np.inf), 5.0) == -1.0
    assert share_closed(refit(np.inf), refit(20.0), 5.0) == 1.0


def fitted_to_runs(*sizes, common=2.0, runs=None):
    """A refit of one parameter, the size of a moving mass in units of its range, with folds of the same information each."""
    name = f"moving_mass.{EFFECTS['moving_mass'].parameters[0].name}"
    model = SimpleNamespace(parameters=[SimpleNamespace(name=name)], defaults=0.0)
    problem = SimpleNamespace(model=model, free=[0], unit=lambda theta: np.array([theta]))
    gradients = np.array([[3.0 * (common - size)] for size in sizes])
    folds = tuple((run, slice(0, 1)) for run in (runs or range(len(sizes))))
    return SimpleNamespace(
        problem=problem, theta=common, folds=folds, normal_matrices=np.full((len(sizes), 1, 1), 3.0), gradients=gradients
    )


def test_a_mechanism_has_one_size_and_a_stand_in_drifts():
    assert drift_over_runs(fitted_to_runs(2.0, 2.0, 2.05, 1.95), "moving_mass") == 0.0
    assert drift_over_runs(fitted_to_runs(3.0, 1.0, 3.0, 1.0), "moving_mass") == pytest.approx(np.log10(0.5 / LEAST_DRIFT))
    # Folds of one run differ as they like, its size is their mean; a single run is divided.
    of_runs = fitted_to_runs(3.0, 1.0, 3.0, 1.0, runs=(0, 0, 1, 1))
    assert drift_over_runs(of_runs, "moving_mass") == 0.0
    assert drift_over_runs(fitted_to_runs(3.0, 1.0, runs=(0, 0)), "moving_mass") == pytest.approx(1.0)
    most = pytest.approx(np.log10(LARGEST_DRIFT / LEAST_DRIFT))
    assert drift_over_runs(fitted_to_runs(30.0, -30.0), "moving_mass") == most
    assert drift_over_runs(fitted_to_runs(1.0, 1.0, common=0.0), "moving_mass") == most


def test_the_shipped_weights_are_those_of_the_evidence_and_have_signs_that_make_sense():
    weights = presence_model().weights
    assert set(weights) <= {entry.name for entry in EVIDENCE}
    for name, weight in weights.items():
        assert weight <= 0.0 if name in AGAINST else weight >= 0.0
    measured = presence_model().card["left out by damper"]
    assert measured["log loss"] < 0.6 * measured["log loss of the mean alone"]


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
