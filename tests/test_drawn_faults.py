"""Faults that are drawn and hidden in the simulated bench are named by it, with no hand on it."""

from pathlib import Path

import pytest
from drawn_faults import LARGEST, TAKEN_UP, diagnose, draw_faults

from mrd_sim.effects import EFFECTS


def test_the_seed_draws_different_faults_of_typical_sizes() -> None:
    assert draw_faults(3, 5) == draw_faults(3, 5)
    drawn = [fault for seed in range(100) for fault in draw_faults(seed, 5)]
    assert {fault.effect for fault in drawn} == set(EFFECTS) - set(TAKEN_UP)
    for fault in drawn:
        typical = EFFECTS[fault.effect].typical
        assert 1.0 <= fault.values[fault.size] / typical[fault.size] <= LARGEST
        assert {**fault.values, fault.size: 0.0} == {**typical, fault.size: 0.0}
    assert len({fault.effect for fault in draw_faults(3, 5)}) == 5


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(3600)
def test_five_drawn_faults_are_named_alone_with_their_sizes(tmp_path: Path) -> None:
    answers = [diagnose(fault, 93 + number, tmp_path / str(number)) for number, fault in enumerate(draw_faults(93, 5), 1)]
    for answer in answers:
        assert answer.is_right, (answer.fault, answer.outcome["sentence"])
        (found,) = [
            member["parameters"][answer.fault.size]
            for member in answer.report["causes"][0]["members"]
            if member["effect"] == answer.fault.effect
        ]
        # Five intervals of 95 % need not hold their five sizes: each size is to be known to a fifth.
        assert found["value"] == pytest.approx(answer.fault.values[answer.fault.size], rel=0.2)
