"""Diagnoses by a catalogue that lacks the true effect: what is tried, what counts as wrong, what fails."""

import numpy as np
import pytest

from mrd_diagnosis.diagnose import candidates_for
from mrd_runs import Run
from mrd_trials import withhold
from mrd_trials.records import Explanation, GroundTruth, Submission
from mrd_trials.trial_design import Recipe
from mrd_trials.trial_folder import PublicPlant, PublicTrial, write_recordings, write_trial
from mrd_trials.withhold import withheld_table, withhold_effects

NAN = (float("nan"),) * 3


def truth(plant, cause, implied=()):
    return GroundTruth(
        plant,
        "single",
        "bouc_wen",
        "kwok",
        True,
        implied,
        {},
        {cause: {}},
        {},
        (cause,),
        {},
        5.0,
        "3-10",
        "rich",
        100.0,
        0,
        "00",
    )


@pytest.fixture
def answers():
    return {
        "p0001": truth("p0001", "backlash"),
        "p0002": truth("p0002", "moving_mass", ("bypass_flow",)),
        "p0003": truth("p0003", "settling"),
    }


@pytest.fixture
def folder(tmp_path, answers):
    """A trial whose last plant has a recording that is refused."""
    time = np.arange(300) / 100.0
    position = 0.01 * np.sin(2 * np.pi * time)
    run = Run("sine", time, position, np.gradient(position, time), np.full_like(time, 0.1), 100.0 * np.cos(2 * np.pi * time))
    plants = [
        PublicPlant(plant, "bouc_wen", "rich", 100.0, write_recordings(tmp_path, plant, [run] * 3), f"commitment {plant}")
        for plant in answers
    ]
    (tmp_path / plants[-1].runs[0]).write_text("time_s,position_m,current_A,force_N\n0,0,0,0\n", encoding="utf-8")
    write_trial(PublicTrial(Recipe(1, {"rich@100": 3}), tuple(plants)), tmp_path)
    return tmp_path


def test_a_catalogue_without_an_effect_can_diagnose_recordings(folder, answers, tmp_path, monkeypatch):
    def stand_in(plant, runs, *, effects):
        tried = candidates_for(effects, is_change=False)
        assert answers[plant.plant].causes[0] not in tried
        assert len(tried) > 20
        named = {"p0001": "joint_play", "p0002": "bypass_flow"}[plant.plant]
        return Submission(plant.plant, "explained", causes=(Explanation((named,), 0.9, NAN),), commitment=plant.commitment)

    monkeypatch.setattr(withhold, "diagnose_plant", stand_in)
    submissions = withhold_effects(folder, answers, tmp_path / "withheld")
    assert [submission.verdict for submission in submissions.values()] == ["explained", "explained", "failed"]
    table = withheld_table(answers, submissions)
    assert "An effect is named, wrongly, for 1 of 2 plants; the diagnosis failed on 1." in table
    assert "failed: InputError: " in table
    assert "bypass_flow" not in table
