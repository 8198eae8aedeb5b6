"""Plants are made as designed, an interrupted trial is continued, and the answers lie elsewhere."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_trials.bench_session import BenchSession
from mrd_trials.cli.make import work
from mrd_trials.commitments import commitment, open_answers
from mrd_trials.excitation import FRESH_RUNS, parse_tier
from mrd_trials.make import _draw_effects, make_plant, make_trial
from mrd_trials.records import GroundTruth, read_records
from mrd_trials.trial_design import PlantDesign, Recipe, design_trial
from mrd_trials.trial_folder import read_fresh_runs, read_given_runs, read_trial
from mrd_trials.truth import EFFECTS, TrueInstruments, TruePlant, draw_parameters

SMALL = Recipe(3, {"sine@100": 2}, {"null": 0.5, "single": 0.5, "pair": 0.0, "absent": 0.0})


def test_answers_in_the_folder_of_the_trial_are_refused(tmp_path):
    with pytest.raises(InputError, match="lies in"):
        make_trial(SMALL, tmp_path / "trial", tmp_path / "trial" / "answers.jsonl")


def test_a_trial_is_made_continued_and_sealed(tmp_path):
    folder, path = tmp_path / "trial", tmp_path / "answers.jsonl"
    assert make_trial(SMALL, folder, path) == []
    trial = read_trial(folder)
    answers = open_answers(path, trial.commitments)
    assert sorted(answer.kind for answer in answers.values()) == ["null", "single"]
    for answer in answers.values():
        assert answer.formulas.keys() == answer.effects.keys()
        assert all(EFFECTS[effect].formula(name).family == "development" for effect, name in answer.formulas.items())
    text = (folder / "trial.json").read_text()
    assert not any(name in text for name in EFFECTS)
    for plant in trial.plants:
        assert len(read_fresh_runs(folder, plant.plant)) == FRESH_RUNS
        runs = read_given_runs(folder, plant)
        assert len(runs) == 3
        assert all(run.acceleration is not None and np.ptp(run.force) > 10.0 * plant.size.force for run in runs)
        assert all(run.rate == pytest.approx(100.0, rel=1e-3) for run in runs)

    # An answer is lost: its plant is made again, the other one is kept.
    kept, lost = trial.plants
    path.write_text("".join(line for line in path.read_text().splitlines(True) if kept.plant in line))
    before = (folder / lost.runs[0]).read_text()
    done = []
    make_trial(SMALL, folder, path, progress=lambda *counts: done.append(counts))
    assert done == [(2, 2)]
    assert (folder / lost.runs[0]).read_text() == before
    again = read_trial(folder).commitments
    assert again[kept.plant] == kept.commitment
    same = read_records(GroundTruth, path)[lost.plant]
    assert commitment(same) == again[lost.plant]
    assert replace(same, salt="") == replace(answers[lost.plant], salt="")
    with pytest.raises(InputError, match="another recipe"):
        make_trial(replace(SMALL, seed=4), folder, path)
    content = path.read_text()
    with pytest.raises(InputError, match="holds answers of another trial"):
        make_trial(replace(SMALL, seed=4), tmp_path / "other", path)
    assert path.read_text() == content


@pytest.mark.parametrize("count", ["nan", "inf", "2.7", "-1", ""])
def test_a_count_that_is_not_a_whole_number_is_refused(count, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["make", str(tmp_path), "--seed", "1", "--plants", f"rich@500={count}"])
    with pytest.raises(InputError, match=f"--plants: found 'rich@500={count}', expected NAME= and a whole number from 0"):
        work()


def test_a_further_run_of_a_plant_can_be_recorded():
    designs, _ = design_trial(SMALL)
    session = BenchSession.from_design(designs[0])
    first = session.record({})
    again = session.record({}, [session.commands[0]])
    assert len(again) == len(first) + 1
    assert all(np.array_equal(before.force, after.force) for before, after in zip(first, again, strict=False))
    assert not np.array_equal(again[-1].force, again[0].force)


def test_an_undetectable_effect_of_a_pair_is_substituted():
    # On a sine, the stiffness of the damper does the same as a gas spring.
    tier = parse_tier("sine@100")
    effects, targets, substitutes = ("flow_asymmetry", "gas_spring"), (5.0, 5.0), ("side_load_friction",)
    design = PlantDesign("p0001", "pair", tier, (5, 1), "bouc_wen", effects, targets, substitutes=substitutes)
    truth, runs, reference = make_plant(design)
    assert len(runs) > FRESH_RUNS
    assert not reference
    assert set(truth.causes) == {"flow_asymmetry", "side_load_friction"}
    assert truth.signal_to_floor > 3.0


def test_where_no_effect_can_be_made_strong_enough_the_strongest_is_taken(monkeypatch):
    signals = iter([0.02, 0.08, 0.05])
    monkeypatch.setattr("mrd_trials.make.find_strength", lambda *_: (0.5, next(signals)))
    monkeypatch.setattr("mrd_trials.make.ReferenceFit.from_runs", lambda *_, **__: None)
    formulas = {name: effect.draw_formula("development", np.random.default_rng(0)) for name, effect in EFFECTS.items()}
    session = SimpleNamespace(
        formulas=formulas, effect_seed=1, fit_seed=1, given_runs=lambda _: [], strength_of=lambda _, effects: len(effects)
    )
    tried = ("gas_spring", "end_stop", "backlash")
    design = PlantDesign("p0001", "single", parse_tier("semireal"), (5, 1), "", tried[:1], (1.0,), substitutes=tried[1:])
    effects, strength = _draw_effects(design, session)
    assert list(effects) == ["end_stop"]
    assert strength == 1


def test_the_simulator_of_a_black_box_has_no_parameter_of_the_damper_exactly():
    plant = TruePlant("spencer", draw_parameters("spencer", np.random.default_rng(1)))
    simulator, again = (BenchSession((), (), TrueInstruments(100.0), plant, 0, 0, seed).simulator for seed in (3, 3))
    assert simulator == again
    off = [value / plant.parameters[name] - 1.0 for name, value in simulator.parameters.items()]
    assert simulator.parameters.keys() == plant.parameters.keys()
    assert 0.0 < np.abs(off).min() < np.abs(off).max() < 0.05


@pytest.mark.slow
def test_effects_beside_a_black_box_are_as_strong_over_its_own_noise_as_their_target():
    design = PlantDesign("p0001", "single", parse_tier("black_box@100"), (5, 1), "dahl", ("force_sensor_lag",), (5.0,))
    truth, runs, simulated = make_plant(design)
    assert 3.0 < truth.signal_to_floor < 8.0
    given = runs[:-FRESH_RUNS]
    off = [np.std(run.force - np.interp(run.time, sim.time, sim.force)) for run, sim in zip(given, simulated, strict=True)]
    session = BenchSession.from_design(design)
    quiet = session.given_runs({})
    noise = [
        np.std(run.force - np.interp(run.time, sim.time, sim.force))
        for run, sim in zip(quiet, session.simulated_runs(quiet), strict=True)
    ]
    assert np.sum(np.square(off)) > 2.0 * np.sum(np.square(noise))
    strength_of = session.strength_beside_simulator()
    assert strength_of({}) == 0.0
    # The damper's own stiffness does what a linear spring of gas does.
    spring = {"gas_spring": {"stiffness": 2500.0, "curvature": 5.0}}
    added = [run.force - other.force for run, other in zip(session.given_runs(spring), quiet, strict=True)]
    assert np.sum(np.square([np.std(force) for force in added])) > 10.0 * np.sum(np.square(noise))
    assert strength_of(spring) < 0.5


def test_a_folder_that_is_not_a_trial_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"is not a trial, expected trial\.json"):
        read_trial(tmp_path)
    (tmp_path / "trial.json").write_text("{}")
    with pytest.raises(InputError, match=r"does not describe a trial \(format 1, expected 7\)"):
        read_trial(tmp_path)
    (tmp_path / "trial.json").write_text('{"format": 5}')
    with pytest.raises(InputError, match="does not describe a trial"):
        read_trial(tmp_path)
