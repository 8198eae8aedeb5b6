"""The design of a trial: shares of the kinds, turns of the effects, the same plants from the same seed."""

from collections import Counter, defaultdict
from dataclasses import replace

import pytest

from mrd_base import InputError
from mrd_trials.bench_session import BenchSession
from mrd_trials.trial_design import LEAST_RECORDINGS, SUBSTITUTES, Recipe, design_trial, stratum, with_recordings
from mrd_trials.truth import ALTERATIONS, DAMPER_FORMS, EFFECTS


def test_every_kind_has_its_share_and_every_effect_its_turn():
    designs, left_out = design_trial(Recipe(1, {"rich@500": 200, "sine@500": 20}))
    assert left_out == []
    assert Counter(design.kind for design in designs if design.tier.excitation == "rich") == {
        "null": 50,
        "single": 80,
        "pair": 30,
        "absent": 40,
    }
    assert len({design.plant for design in designs}) == 220
    known = {name for name, effect in EFFECTS.items() if effect.in_catalogue}
    rich = [design for design in designs if design.tier.excitation == "rich"]
    singles = Counter(design.effects[0] for design in rich if design.kind == "single")
    assert singles.keys() == known
    assert max(singles.values()) - min(singles.values()) <= 1
    assert {design.effects[0] for design in rich if design.kind == "absent"} == EFFECTS.keys() - known
    for kind in ("null", "single", "pair", "absent"):
        forms = [design.form for design in rich if design.kind == kind]
        assert sum(form != "bouc_wen" for form in forms) == len(forms) // 2, kind
    assert all(len(set(design.effects)) == 2 for design in rich if design.kind == "pair")


def recordings(folder, **numbers):
    """Write recordings of some dampers; a design reads no more than their names."""
    for damper, number in numbers.items():
        (folder / damper).mkdir()
        for place in range(number):
            (folder / damper / f"run_{place}.csv").write_text(f"{damper} {place}")
    return str(folder)


@pytest.mark.parametrize("tier", ["rich@500", "semireal"])
def test_every_effect_comes_at_several_strengths_and_all_strengths_equally_often(tier, tmp_path):
    shares = {"null": 0.1, "single": 0.9, "pair": 0.0, "absent": 0.0}
    designs, _ = design_trial(Recipe(1, {tier: 180}, shares, recordings(tmp_path, press=10, rig=10, bench=10)))
    strata, dampers = defaultdict(set), defaultdict(set)
    singles = [design for design in designs if design.kind == "single"]
    for design in singles:
        strata[design.effects[0]].add(stratum(design.targets[0], design.tier.excitation))
        dampers[design.effects[0]].add(design.damper or design.form)
    assert {len(names) for names in strata.values()} == {3}
    assert min(len(names) for names in dampers.values()) > 1
    numbers = Counter(stratum(design.targets[0], design.tier.excitation) for design in singles).values()
    assert max(numbers) - min(numbers) <= 0.1 * len(singles)


@pytest.mark.parametrize("dampers", [("press",), ("press", "rig"), ("press", "rig", "bench")])
def test_models_and_kinds_of_comparison_are_balanced_and_tied_to_nothing(dampers, tmp_path):
    shares = {"null": 0.1, "single": 0.9, "pair": 0.0, "absent": 0.0}
    recipe = Recipe(1, {"semireal": 40, "before_after": 40}, shares, recordings(tmp_path, **dict.fromkeys(dampers, 10)))
    designs, _ = design_trial(recipe)
    assert Counter(design.model for design in designs).most_common()[0][1] == 40
    compared = [design for design in designs if design.tier.excitation == "before_after"]
    assert not any(design.same_runs for design in designs if design.kind == "null" or design not in compared)
    kinds = Counter(design.same_runs for design in compared if design.kind == "single")
    assert kinds == {True: 18, False: 18}
    for of_plant in ("damper", "model", "background"):
        both = Counter((getattr(design, of_plant), design.same_runs) for design in compared if design.kind == "single")
        assert len(both) == 2 * len({value for value, _ in both}), of_plant
    # Backgrounds of equal number share nothing across tiers.
    assert len({design.size for design in designs}) == 8


def test_a_damper_with_few_recordings_is_left_out_of_the_tiers_that_divide_them(tmp_path):
    folder = recordings(tmp_path, press=LEAST_RECORDINGS, few=3)
    designs, left_out = design_trial(Recipe(1, {"semireal": 4, "replay": 2}, recorded=folder))
    assert {design.damper for design in designs if design.tier.excitation == "semireal"} == {"press"}
    assert {design.damper for design in designs if design.tier.excitation == "replay"} == {"press", "few"}
    assert left_out == ["damper few in the tier semireal: has 3 recordings, expected 6 at least"]


def test_other_recordings_than_those_of_the_trial_are_refused(tmp_path, monkeypatch):
    recordings(tmp_path, press=8, rig=8)
    monkeypatch.chdir(tmp_path)
    recipe = with_recordings(Recipe(1, {"semireal": 4}, recorded="."))
    monkeypatch.chdir(tmp_path.parent)
    design_trial(recipe)
    (tmp_path / "press" / "run_0.csv").write_text("other")
    (tmp_path / "rig").rename(tmp_path / "bench")
    with pytest.raises(InputError, match=r"of bench, press, rig are not those of the trial, .* press, rig as"):
        design_trial(recipe)


def test_the_same_recipe_gives_the_same_plants_and_another_seed_others():
    recipe = Recipe(1, {"rich@500": 40})
    assert design_trial(recipe) == design_trial(recipe)
    assert design_trial(recipe) != design_trial(replace(recipe, seed=2))


def test_the_families_share_no_form_no_formula_and_no_plant():
    recipe = Recipe(1, {"rich@100": 60, "sine@100": 4})
    forms, formulas, seeds = {}, {}, {}
    for family in ("development", "evaluation"):
        designs, _ = design_trial(replace(recipe, family=family))
        forms[family] = {design.form for design in designs} - {"bouc_wen"}
        assert len(forms[family]) >= 3
        assert {DAMPER_FORMS[form].family for form in forms[family]} == {family}
        drawn = [BenchSession.from_design(design).plant.formulas for design in designs if design.tier.excitation == "sine"]
        formulas[family] = {entry for plant in drawn for entry in plant.items()}
        assert all(EFFECTS[effect].formula(name).family == family for effect, name in formulas[family])
        assert all(plant.keys() == EFFECTS.keys() for plant in drawn)
        seeds[family] = {design.seed for design in designs}
    for found in (forms, formulas, seeds):
        assert found["development"].isdisjoint(found["evaluation"])


def test_names_of_plants_say_nothing():
    designs, _ = design_trial(Recipe(1, {"rich@500": 100}))
    kinds = [design.kind for design in designs]
    assert kinds != sorted(kinds)
    assert len(set(kinds[:20])) == 4


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (Recipe(1, {"slow@500": 3}), "tier slow@500: expected one of replay, semireal, before_after, or of rich"),
        (Recipe(1, {"rich@fast": 3}), "tier rich@fast"),
        (Recipe(1, {"rich@1": 3}), "10 to 4000 Hz"),
        (Recipe(1, {"rich@500": 3}, {"null": 0.5}), "add up to 1"),
        (Recipe(1, {"rich@500": 3}, {"ghost": 1.0}), "expected shares of"),
        (Recipe(1, {"rich@500": 3}, family="validation"), "family validation: expected one of development, evaluation"),
    ],
)
def test_a_recipe_that_cannot_be_made_is_refused(recipe, message):
    with pytest.raises(InputError, match=message):
        design_trial(recipe)


def test_a_replay_without_recordings_is_left_out_and_reported(tmp_path):
    designs, left_out = design_trial(Recipe(1, {"replay": 4, "sine@100": 2}, recorded=str(tmp_path)))
    assert len(designs) == 2
    assert left_out == [f"4 plants of the tier replay: no recordings in {tmp_path}"]


@pytest.mark.parametrize(
    ("strength", "name", "of_recordings"),
    [
        (0.0, "", ""),
        (0.5, "<1", "25-50 %"),
        (1.0, "1-3", "50-75 %"),
        (2.9, "1-3", "50-75 %"),
        (3.0, "3-10", ">75 %"),
        (10.0, ">10", ">75 %"),
    ],
)
def test_strata(strength, name, of_recordings):
    assert stratum(strength, "rich") == name
    assert stratum(strength, "semireal") == of_recordings


def test_all_effects_are_substitutes_equally_often(tmp_path):
    """Else the few that can always be made strong would take most places."""
    shares = {"null": 0.1, "single": 0.9, "pair": 0.0, "absent": 0.0}
    recipe = Recipe(1, {"semireal": 120}, shares, recordings(tmp_path, press=10, rig=10, bench=10))
    designs = [design for design in design_trial(recipe)[0] if design.kind == "single"]
    assert all(design.effects[0] not in design.substitutes for design in designs)
    assert {len(set(design.substitutes)) for design in designs} == {SUBSTITUTES}
    times = Counter(effect for design in designs for effect in design.substitutes)
    assert times.keys() == {name for name in ALTERATIONS if EFFECTS[name].in_catalogue}
    assert max(times.values()) - min(times.values()) <= 4
