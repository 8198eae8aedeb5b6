"""The selection of effects finds those that act, takes none where none acts, and never looks at held-out runs."""

import json
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_identification import compare, identify, read_fit, write_fit
from mrd_identification.cli.identify import main
from mrd_identification.compare_file import write_comparison
from mrd_identification.effect_selection import Selection, left_out_errors, parts_of
from mrd_identification.identify import Solution
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.method import Method
from mrd_identification.nsga2 import Front
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import prepare_recording
from mrd_identification.report import write_report
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_sim.parameter import Parameter
from mrd_sim.path import make_path

OPTIONS = {"effects": ["auto"], "seeds": 1, "population": 16, "generations": 8, "profile": False}
PLAY = {"joint_play.play": 4e-4, "joint_play.resistance": 2.5e4}
MASS = {"moving_mass.mass": 5.0}


def simulate(name, seed, values=None, *, model="bouc_wen", seconds=4.0, noise=10.0):
    """Simulate a noisy run of a damper with the effects that ``values`` name, along a multisine and three currents."""
    random = np.random.default_rng(seed)
    time = np.arange(0, seconds, 0.004)
    position, velocity, acceleration = np.zeros((3, len(time)))
    for frequency, amplitude in ((0.7, 8e-3), (2.3, 3e-3), (4.1, 1e-3)):
        w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
        position += amplitude * np.sin(w * time + phase)
        velocity += amplitude * w * np.cos(w * time + phase)
        acceleration -= amplitude * w**2 * np.sin(w * time + phase)
    current = np.repeat(random.permutation([0.0, 0.2, 0.4]), -(-len(time) // 3))[: len(time)]
    values = values or {}
    damper = find_model(model, None, list(dict.fromkeys(key.partition(".")[0] for key in values if "." in key)))
    force = damper.force(damper.vector(values), make_path(time, position, velocity, acceleration, current))
    return Run(name, time, position, velocity, current, force + noise * random.standard_normal(len(time)))


def runs_of(values=None, count=5, seed=0, **options):
    return [simulate(f"run{index}", 10 * seed + index, values, **options) for index in range(count)]


@pytest.fixture(scope="module")
def with_play():
    return identify(runs_of(PLAY), "bouc_wen", held_out=[simulate("unseen", 99, PLAY)], **OPTIONS)


def test_a_known_effect_is_found_and_predicts_unseen_runs(with_play):
    assert with_play.selection.effects == ("joint_play",)
    assert [effect.id for effect in with_play.model.effects] == ["joint_play"]
    assert with_play.values["joint_play.play"] == pytest.approx(PLAY["joint_play.play"], rel=0.1)
    without = identify(runs_of(PLAY), "bouc_wen", held_out=[simulate("unseen", 99, PLAY)], **{**OPTIONS, "effects": []})
    assert with_play.pooled_held_out.nrmse < 0.7 * without.pooled_held_out.nrmse
    (step,) = with_play.selection.added
    assert step.nrmse_before == pytest.approx(without.pooled_fitted.nrmse, rel=0.1)
    assert step.nrmse_after == pytest.approx(with_play.pooled_fitted.nrmse, rel=0.1)


def test_two_effects_are_found():
    fit = identify(runs_of(PLAY | MASS), "bouc_wen", **OPTIONS)
    assert set(fit.selection.effects) == {"joint_play", "moving_mass"}
    improvements = [step.improvement for step in fit.selection.added]
    assert improvements[0] > improvements[1]
    assert any("helped to select the effects" in warning for warning in fit.warnings)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [1, 6])
def test_no_effect_is_taken_where_none_acts(seed, count):
    fit = identify(runs_of(seed=seed, count=count), "bouc_wen", **OPTIONS)
    assert fit.selection.effects == ()
    assert fit.selection.next_best.improvement < 0.02
    assert fit.selection.of_runs == (count > 1)
    assert not fit.model.effects


def test_held_out_runs_never_influence_the_choice(with_play):
    """Held-out runs of another damper, with another effect, change nothing but the prediction error."""
    other = [simulate("other", 7, {"gas_spring.stiffness": 4000.0}, noise=30.0)]
    fit = identify(runs_of(PLAY), "bouc_wen", held_out=other, **OPTIONS)
    assert replace(fit.selection, elapsed=0.0) == replace(with_play.selection, elapsed=0.0)
    assert np.array_equal(fit.theta, with_play.theta)
    assert fit.pooled_held_out.nrmse > 2 * with_play.pooled_held_out.nrmse


def test_an_effect_of_a_single_run_is_found():
    fit = identify([simulate("alone", 3, PLAY, seconds=12.0)], "bouc_wen", **OPTIONS)
    assert "joint_play" in fit.selection.effects
    assert not fit.selection.of_runs
    assert fit.held_out_by == "none"


def test_two_effects_that_do_the_same_are_both_named():
    """A gas spring without curvature and crosstalk from the position both add k x."""
    runs = runs_of({"channel_crosstalk.from_position": 1500.0}, model="bingham")
    (step,) = identify(runs, "bingham", **OPTIONS).selection.added
    assert {"gas_spring", "channel_crosstalk"} <= {step.effect, *step.equally_good}


def test_effects_that_are_given_stay_and_are_not_selected():
    fit = identify(runs_of(PLAY), "bouc_wen", **{**OPTIONS, "effects": ["moving_mass", "auto"]})
    assert fit.selection.effects == ("joint_play",)
    assert {effect.id for effect in fit.model.effects} == {"moving_mass", "joint_play"}


def test_the_error_of_a_part_is_that_of_a_fit_without_it():
    recordings = [prepare_recording(run) for run in runs_of(PLAY)]
    problem, _ = make_problem(find_model("bouc_wen"), recordings)
    theta, _ = fit_least_squares(problem, problem.base)
    parts, of_runs = parts_of(problem)
    assert of_runs
    errors = left_out_errors(problem, problem.unit(theta), parts)
    for index, error in enumerate(errors):
        rest, _ = make_problem(find_model("bouc_wen"), [r for other, r in enumerate(recordings) if other != index])
        refitted, _ = fit_least_squares(rest, theta)
        assert error == pytest.approx(np.sum(problem.errors(refitted)[problem.blocks[index]] ** 2), rel=0.02)
        assert error > np.sum(problem.errors(theta)[problem.blocks[index]] ** 2)


class Exponential(Problem):
    """The force is the exponential of the only parameter, which is far from linear."""

    def forces(self, theta):
        return np.full(len(self.force), np.exp(theta[0]))

    def jacobian(self, unit, indices=None):
        slope = self.scale(self.theta(unit))[0] * self.forces(self.theta(unit))
        return self.counted(slope)[:, None]


def test_a_part_without_which_the_optimum_is_far_away_is_predicted_from_there():
    """The first step to the optimum of the second run, 1000, would lead beyond it by far."""
    model = SimpleNamespace(parameters=(Parameter("force", "N", 0.0, -10.0, 10.0, "logarithm"),), linear=())
    runs = [SimpleNamespace(force=np.full(count, level), weight=1.0) for count, level in ((97, 1.0), (3, 1000.0))]
    problem = Exponential(model, runs, (0,), np.zeros(1))
    unit = problem.unit(np.log([problem.force.mean()]))
    errors = left_out_errors(problem, unit, [np.arange(97), np.arange(97, 100)])
    assert errors == pytest.approx([97 * 999.0**2, 3 * 999.0**2], rel=0.02)


def test_the_best_seed_is_chosen_by_the_loss_with_its_scale(monkeypatch):
    module = import_module("mrd_identification.identify")
    runs = runs_of(count=1, seconds=2.0)
    problem, _ = make_problem(find_model("bingham"), [prepare_recording(run) for run in runs])
    theta, _ = fit_least_squares(problem, problem.base)
    scales, cost = [], Problem.cost
    monkeypatch.setattr(Problem, "cost", lambda self, theta: scales.append(self.loss_scale) or cost(self, theta))
    monkeypatch.setattr(module, "estimate_starts", lambda model, theta, recordings: recordings)
    monkeypatch.setattr(module, "select_effects", lambda *_: Selection((), None, 5, False, {}, {}))
    solutions = [Solution(Front(theta[None], np.ones((1, 2)), 0), theta, 0.0)] * 2
    module.select(runs, "bingham", Method(loss="huber"), solutions)
    assert len(scales) == 2
    assert all(scale > 5.0 for scale in scales)  # the noise is 10 N


def test_parts_are_runs_or_stretches_and_cover_every_sample():
    for count, parts_expected in ((1, 5), (2, 6), (5, 5), (23, 20)):
        problem, _ = make_problem(find_model("bingham"), [prepare_recording(r) for r in runs_of(count=count, seconds=1.0)])
        parts, of_runs = parts_of(problem)
        assert len(parts) == parts_expected
        assert of_runs == (count >= 5)
        assert np.array_equal(np.concatenate(parts), np.arange(len(problem.force)))


def test_files_and_page_show_the_selection(with_play, tmp_path):
    stored = read_fit(write_fit(with_play, tmp_path))
    assert stored.effects == ["joint_play"]
    assert [step["effect"] for step in stored.content["selection"]["added"]] == ["joint_play"]
    page = write_report(with_play, tmp_path).read_text()
    assert "Selected effects" in page
    assert f"{100 * with_play.selection.added[0].improvement:.1f}" in page


def test_progress_rises_to_the_total():
    seen = []
    identify(runs_of(count=2, seconds=2.0), "bingham", progress=lambda done, _: seen.append(done), **OPTIONS)
    assert seen == sorted(seen)
    assert seen[-1] == 8 * (2 + 30)


def test_a_comparison_has_rows_with_effects(tmp_path):
    rows = ["bouc_wen", "bouc_wen+auto", "bouc_wen:quadratic+joint_play"]
    options = {**OPTIONS, "effects": []}
    comparison = compare(runs_of(PLAY), rows, held_out=[simulate("unseen", 99, PLAY)], **options)
    assert comparison.entries[-1].name == "bouc_wen"
    page = write_comparison(comparison, tmp_path).read_text()
    content = json.loads((tmp_path / "compare.json").read_text())
    assert {row["name"]: row["effects"] for row in content["models"]} == {
        "bouc_wen": [], "bouc_wen+auto": ["joint_play"], "bouc_wen:quadratic+joint_play": ["joint_play"]
    }  # fmt: skip
    assert "bouc_wen+auto: the selected effects are joint_play" in page
    assert "bouc_wen+auto: the selected effects are joint_play" in (tmp_path / "compare.md").read_text()


def test_unusable_requests_are_one_line():
    runs = runs_of(count=2, seconds=1.0)
    for rows, options in ((["bingham", "bingham+auto"], {}), (["bingham"], {"effects": ["auto"]})):
        with pytest.raises(InputError, match="auto selects effects by all fitted runs"):
            compare(runs, rows, **options)
    with pytest.raises(InputError, match="effect auto is named twice"):
        identify(runs, "bingham", effects=["auto", "auto"])
    with pytest.raises(InputError, match="effect auto: effects are selected by least squares"):
        identify(runs, "bingham", effects=["auto"], least_squares=False)
    with pytest.raises(InputError, match="unknown effect nosuch"):
        identify(runs, "bingham", effects=["auto", "nosuch"])
    with pytest.raises(InputError, match="unknown effect nosuch"):
        compare(runs, ["bingham+nosuch"])


def test_the_tool_prints_what_it_selected(tmp_path, monkeypatch, capsys):
    files = []
    for run in runs_of(PLAY):
        files.append(str(tmp_path / f"{run.name}.csv"))
        columns = np.stack([run.time, run.position, run.current, run.force], axis=1)
        np.savetxt(files[-1], columns, "%.9g", ",", header="time_s,position_m,current_A,force_N", comments="")
    options = ["--model", "bouc_wen", "--effects", "auto", "--population", "16", "--generations", "8", "--seeds", "1"]
    monkeypatch.setattr("sys.argv", ["identify", *files, *options, "--no-profile", "--output", str(tmp_path / "fit")])
    main()
    printed = capsys.readouterr().out
    assert "joint_play was added: on 5 runs left out in turn it removes" in printed
    assert "effect was added: the best" in printed
