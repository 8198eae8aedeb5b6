"""A trial is what its recipe says, the same again from the same seed, and its answers lie elsewhere."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import read_runs
from mrd_trials.cli.make import work
from mrd_trials.excitation import FRESH, motions, parse_tier, read_recorded
from mrd_trials.make import Order, Recipe, Session, make, make_plant, plan_trial, read_trial
from mrd_trials.records import Answer, read_records
from mrd_trials.seal import commitment, unseal
from mrd_trials.strength import strength_for
from mrd_trials.truth import EFFECTS

SMALL = Recipe(3, {"sine@100": 2}, {"null": 0.5, "single": 0.5, "pair": 0.0, "absent": 0.0})


def test_every_kind_has_its_share_and_every_effect_its_turn():
    orders, left_out = plan_trial(Recipe(1, {"rich@500": 200, "sine@500": 20}))
    assert left_out == []
    assert Counter(order.kind for order in orders if order.tier.excitation == "rich") == {
        "null": 50,
        "single": 80,
        "pair": 30,
        "absent": 40,
    }
    assert len({order.plant for order in orders}) == 220
    known = {name for name, effect in EFFECTS.items() if effect.in_catalogue}
    rich = [order for order in orders if order.tier.excitation == "rich"]
    singles = Counter(order.effects[0] for order in rich if order.kind == "single")
    assert singles.keys() == known
    assert max(singles.values()) - min(singles.values()) <= 1
    assert {order.effects[0] for order in rich if order.kind == "absent"} == EFFECTS.keys() - known
    nulls = [order for order in rich if order.kind == "null"]
    assert sum(order.base != "bouc_wen" for order in nulls) == len(nulls) // 2
    assert all(len(set(order.effects)) == 2 for order in rich if order.kind == "pair")


def test_the_same_recipe_gives_the_same_plants_and_another_seed_others():
    recipe = Recipe(1, {"rich@500": 40})
    assert plan_trial(recipe) == plan_trial(recipe)
    assert plan_trial(recipe) != plan_trial(replace(recipe, seed=2))


def test_names_of_plants_say_nothing():
    orders, _ = plan_trial(Recipe(1, {"rich@500": 100}))
    kinds = [order.kind for order in orders]
    assert kinds != sorted(kinds)
    assert len(set(kinds[:20])) == 4


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (Recipe(1, {"slow@500": 3}), "tier slow@500: expected replay, or one of rich"),
        (Recipe(1, {"rich@fast": 3}), "tier rich@fast"),
        (Recipe(1, {"rich@1": 3}), "10 to 4000 Hz"),
        (Recipe(1, {"rich@500": 3}, {"null": 0.5}), "add up to 1"),
        (Recipe(1, {"rich@500": 3}, {"ghost": 1.0}), "expected shares of"),
    ],
)
def test_a_recipe_that_cannot_be_made_is_refused(recipe, message):
    with pytest.raises(InputError, match=message):
        plan_trial(recipe)


def test_replay_without_recordings_is_left_out_with_a_word(tmp_path):
    orders, left_out = plan_trial(Recipe(1, {"replay": 4, "sine@100": 2}, recorded=str(tmp_path)))
    assert len(orders) == 2
    assert left_out == [f"4 plants of the tier replay: no recordings in {tmp_path}"]


def test_answers_do_not_go_where_the_diagnosis_looks(tmp_path):
    with pytest.raises(InputError, match="lies in"):
        make(SMALL, tmp_path / "trial", tmp_path / "trial" / "answers.jsonl")


def test_a_trial_is_made_goes_on_and_is_sealed(tmp_path):
    folder, path = tmp_path / "trial", tmp_path / "answers.jsonl"
    assert make(SMALL, folder, path) == []
    trial = read_trial(folder)
    commitments = {exhibit.plant: exhibit.commitment for exhibit in trial.exhibits}
    answers = unseal(path, commitments)
    assert sorted(answer.kind for answer in answers.values()) == ["null", "single"]
    text = (folder / "trial.json").read_text()
    assert not any(name in text for name in EFFECTS)
    for exhibit in trial.exhibits:
        assert len(exhibit.runs) == 3
        assert len(list((folder / "fresh" / exhibit.plant).iterdir())) == FRESH
        runs = read_runs([str(folder / file) for file in exhibit.runs])
        assert all(run.acceleration is not None and np.ptp(run.force) > 10.0 for run in runs)
        assert all(run.rate == pytest.approx(100.0, rel=1e-3) for run in runs)

    # One answer and its plant are lost: they are made again, the rest is kept.
    kept, lost = trial.exhibits
    path.write_text("".join(line for line in path.read_text().splitlines(True) if kept.plant in line))
    before = (folder / lost.runs[0]).read_text()
    done = []
    make(SMALL, folder, path, progress=lambda n, of: done.append((n, of)))
    assert done == [(2, 2)]
    assert (folder / lost.runs[0]).read_text() == before
    again = {exhibit.plant: exhibit.commitment for exhibit in read_trial(folder).exhibits}
    assert again[kept.plant] == kept.commitment
    same = read_records(Answer, path)[lost.plant]
    assert commitment(same) == again[lost.plant]
    assert replace(same, salt="") == replace(answers[lost.plant], salt="")
    with pytest.raises(InputError, match="another recipe"):
        make(replace(SMALL, seed=4), folder, path)
    kept = path.read_text()
    with pytest.raises(InputError, match="holds answers of another trial"):
        make(replace(SMALL, seed=4), tmp_path / "other", path)
    assert path.read_text() == kept


@pytest.mark.parametrize("count", ["nan", "inf", "2.7", "-1", ""])
def test_a_count_that_is_none_is_refused(count, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["make", str(tmp_path), "--seed", "1", "--plants", f"rich@500={count}"])
    with pytest.raises(InputError, match=f"--plants: found 'rich@500={count}', expected NAME= and a whole number from 0"):
        work()


def test_a_plant_can_be_put_on_the_bench_again_for_one_more_run():
    orders, _ = plan_trial(SMALL)
    session = Session.of(orders[0])
    first = session.record({})
    again = session.record({}, [session.motions[0]])
    assert len(again) == len(first) + 1
    assert all(np.array_equal(one.force, other.force) for one, other in zip(first, again, strict=False))
    assert not np.array_equal(again[-1].force, again[0].force)


def test_an_effect_that_cannot_be_seen_gives_way_in_a_pair():
    # A sine shows little of a gas spring, whatever its size: the damper's own stiffness does the same.
    tier = parse_tier("sine@100")
    effects, targets, spare = ("flow_asymmetry", "gas_spring"), (5.0, 5.0), ("side_load_friction",)
    order = Order("p0001", "pair", tier, (5, 1), "bouc_wen", effects, targets, spare=spare)
    answer, _ = make_plant(order)
    assert set(answer.causes) == {"flow_asymmetry", "side_load_friction"}
    assert answer.signal_to_floor > 3.0


def test_a_folder_that_is_no_trial_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"is no trial, expected trial\.json"):
        read_trial(tmp_path)
    (tmp_path / "trial.json").write_text("{}")
    with pytest.raises(InputError, match="is no trial"):
        read_trial(tmp_path)


@pytest.mark.parametrize("tier", ["rich@500", "sine@500", "paper@25"])
def test_motions_begin_at_rest_and_keep_within_the_stroke(tier):
    moves = motions(parse_tier(tier), np.random.default_rng(5))
    assert len({name for name, _ in moves}) == len(moves) > FRESH
    for _, move in moves:
        assert np.abs(move.position).max() < 0.0265
        assert move.current.min() >= 0.0
        assert abs(move.position[1] - move.position[0]) < 1e-6


def test_recordings_are_read_by_damper(tmp_path):
    for gain, name in enumerate("abc", 1):
        rows = "".join(f"{0.01 * k},{1e-4 * k},0,{gain * k}\n" for k in range(50))
        path = tmp_path / "press" / f"{name}.csv"
        path.parent.mkdir(exist_ok=True)
        path.write_text("time_s,position_m,current_A,force_N\n" + rows)
    (tmp_path / "few").mkdir()
    found = read_recorded(tmp_path)
    assert [run.name for run in found["press"]] == ["a", "b", "c"]
    assert found.keys() == {"press"}


@pytest.mark.parametrize("power", [1.0, 2.0, 5.0])
def test_a_strength_meets_its_target(power):
    strength, reached = strength_for(5.0, lambda size: 0.3 * size**power, 100.0)
    assert reached == 0.3 * strength**power == pytest.approx(5.0, rel=0.25)


def test_a_strength_stays_plausible():
    assert strength_for(5.0, lambda size: 1e-3 * size**2, 6.0) == (6.0, 1e-3 * 6.0**2)


def test_strength_beyond_a_threshold():
    def signal(size):
        return 1e-4 + 400.0 * max(size - 1.3, 0.0) ** 2

    strength, reached = strength_for(5.0, signal, 6.0)
    assert reached == signal(strength)
    assert abs(np.log(reached / 5.0)) < 0.25
