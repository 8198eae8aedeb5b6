"""The verdict after the rejection rules."""

import pytest

from mrd_diagnosis.decision.rejection_rules import RULES, leaves_open
from mrd_diagnosis.decision.verdict import verdict_after_rejection, verdict_beside_other_forms
from mrd_diagnosis.diagnosis import Finding

RULE = {rule.id: rule for rule in RULES}
HELD = Finding("clock", "limitation", "the position is refreshed at 50 Hz only", "a", "position")


@pytest.mark.parametrize(
    ("verdict", "named", "rejected_by", "limitations", "remains"),
    [
        ("explained", ["gas_spring"], [], [], "explained"),
        ("no_gap", [], [], [], "no_gap"),
        ("explained", ["gas_spring"], ["neutral"], [], "partly_explained"),
        ("explained", ["gas_spring"], ["limitation"], [HELD], "partly_explained"),
        ("ambiguous", [], ["limitation", "neutral"], [HELD], "data_fault"),
        ("explained", [], ["on_bound", "undecided"], [], "ambiguous"),
        ("ambiguous", [], ["on_bound", "little"], [], "unknown_effect"),
        ("partly_explained", [], ["on_bound"], [], "unknown_effect"),
    ],
)
def test_what_the_rejection_rules_leave_of_a_verdict(verdict, named, rejected_by, limitations, remains):
    assert verdict_after_rejection(verdict, named, [RULE[rule] for rule in rejected_by], limitations) == remains


def test_effects_beside_other_forms_are_a_part_of_the_explanation():
    assert verdict_beside_other_forms(["gas_spring"]) == "partly_explained"
    assert verdict_beside_other_forms([]) == "unknown_effect"


def test_an_effect_is_seen_where_only_its_size_or_its_name_is_open():
    assert {rule.id for rule in RULES if leaves_open(rule.id)} == {"on_bound", "undetermined", "neutral", "undecided"}
