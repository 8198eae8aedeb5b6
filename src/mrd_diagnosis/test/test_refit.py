"""Refits that know noise and scatter: white errors, parts left out, the null distribution."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter1d
from scipy.stats import kstest

from mrd_diagnosis.diagnose import _verdict as verdict
from mrd_diagnosis.diagnosis import RunNoise
from mrd_diagnosis.effect_search import BaseFit, refit_with_effects, score, start_values
from mrd_diagnosis.model_comparison import INITIAL_RUN_SCATTER, contest, estimate_run_scatter
from mrd_diagnosis.null_distribution import draw_null_errors, draw_null_gains, p_value
from mrd_diagnosis.refit import RunScatter, refit, whitening, without_each
from mrd_diagnosis.statistics import bootstrap_counts, closed, probabilities, values
from mrd_diagnosis.weighting import Weighting, with_effect
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_runs.signals.smoothed_run import smooth_run
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import find_model
from mrd_sim.path import path_of
from mrd_sim.play import MOST_FILM

FORCE_NOISE = 1.5
BASE = find_model("bouc_wen")
THETA = BASE.vector({"yield_force": 60.0, "yield_force_per_A": 800.0, "coil_lag": 0.0})


def run(seed, gain=0.0, offset=0.0, model=BASE, theta=THETA, rate=250.0, seconds=6.0):
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    phase = rng.uniform(0, 6, 3)
    x = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in zip((8e-3, 4e-3, 1e-3), (0.6, 1.7, 4.1), phase, strict=True))
    x = np.asarray(x)
    current = np.repeat(rng.uniform(0, 0.5, 12), len(t) // 12)
    current = np.concatenate([current, np.full(len(t) - len(current), current[-1])])
    found = Run(f"run{seed}", t, x, np.gradient(x, t), current, np.zeros_like(t))
    force = model.force(theta, path_of(smooth_run(found)))
    return Run(found.name, t, x, found.velocity, current, (1 + gain) * force + offset + rng.normal(0, FORCE_NOISE, len(t)))


def ground_of(runs, scatter=INITIAL_RUN_SCATTER):
    recordings = [prepare_recording(one) for one in runs]
    noises = [RunNoise(np.full(len(r.force), FORCE_NOISE), FORCE_NOISE, 0.0, "residual") for r in recordings]
    return Weighting(recordings, noises, scatter, {"coil_lag": 0.0})


def neutral(weighting, effect, theta):
    return weighting.problem(*with_effect(BASE, theta, effect))


@pytest.fixture(scope="module")
def weighting():
    return ground_of([run(seed) for seed in range(5)])


@pytest.fixture(scope="module")
def alone(weighting):
    problem = weighting.problem(BASE, THETA)
    noise = draw_null_errors(problem, THETA, [FORCE_NOISE] * 5, INITIAL_RUN_SCATTER, np.random.default_rng(0))
    return refit(problem, fit_least_squares(problem, THETA)[0], weighting.folds, noise)


@given(gain=st.floats(1e-4, 0.1), offset=st.floats(1e-3, 30.0), seed=st.integers(0, 2**32 - 1), sigma=st.floats(0.1, 10.0))
def test_whitening_is_the_inverse_root_of_the_covariance(gain, offset, seed, sigma):
    rng = np.random.default_rng(seed)
    sigmas, force = sigma * rng.uniform(0.5, 2.0, 20), rng.normal(0, 200, 20)
    white = whitening(sigmas, force, RunScatter(gain, offset))
    root = white(np.eye(20))
    covariance = np.diag(sigmas**2) + gain**2 * np.outer(force, force) + offset**2
    assert root @ covariance @ root.T == pytest.approx(np.eye(20), abs=1e-5)
    assert not white.silent()(rng.normal(0, 1, 20)).any()


def test_own_gain_and_offset_of_a_run_are_found_and_taken_out():
    found = ground_of([run(1, gain=0.03, offset=4.0)], RunScatter(0.05, 10.0)).problem(BASE, THETA)
    error = found.modelled(THETA, 0) - found.force
    gain, offset = found.whitenings[0].own @ error
    assert (-gain, -offset) == pytest.approx((0.03, 4.0), rel=0.1)


def test_scatter_is_learned_from_the_runs():
    rng = np.random.default_rng(0)
    runs = [run(seed, *rng.normal(0, (0.02, 5.0))) for seed in range(12)]
    weighting = ground_of(runs)
    problem = weighting.problem(BASE, THETA)
    found = estimate_run_scatter(refit(problem, fit_least_squares(problem, THETA)[0], weighting.folds))
    assert 0.01 < found.gain < 0.035
    assert 2.5 < found.offset < 9.0


def test_a_true_model_leaves_white_errors_of_variance_one(alone):
    assert alone.reduced_chi_square == pytest.approx(1.0, abs=0.1)
    assert alone.held_out_cost >= alone.cost.sum()


def test_leaving_a_part_out_is_fitting_without_it(weighting, alone):
    problem = alone.problem
    index = 4
    run_of, part = weighting.folds[index]
    block = problem.blocks[run_of]
    sigma = np.full(block.stop - block.start, FORCE_NOISE)
    sigma[part.start - block.start : part.stop - block.start] = 1e9
    noises = list(weighting.noises)
    noises[run_of] = replace(noises[run_of], sigma=sigma)
    without = replace(weighting, noises=noises).problem(BASE, THETA)
    theta, _ = fit_least_squares(without, alone.theta)
    step = without_each(problem, problem.unit(alone.theta), alone.normal_matrices, alone.gradients)[index]
    wrong = np.abs(problem.unit(step) - problem.unit(theta))
    standard_error = np.sqrt(np.diag(np.linalg.inv(alone.normal_matrices.sum(axis=0))))
    assert (wrong < 0.25 * standard_error).all()
    assert np.abs(problem.unit(step) - problem.unit(alone.theta)).max() > 0.1 * standard_error.min()


def test_gains_in_noise_follow_their_null_distribution(weighting, alone):
    effects = ("moving_mass", "force_sensor_lag", "channel_delay")
    base_fit = BaseFit.of(weighting, alone)
    problems = {name: neutral(weighting, name, alone.theta) for name in effects}
    noise = draw_null_errors(alone.problem, alone.theta, [FORCE_NOISE] * 5, INITIAL_RUN_SCATTER, np.random.default_rng(1))
    starts = {name: score(problems[name], base_fit, EFFECTS[name]).start for name in effects}
    trials = [refit(problems[name], starts[name], weighting.folds, noise) for name in effects]
    nulls = draw_null_gains(alone, trials, np.random.default_rng(2))
    found = max(alone.cost.sum() - trial.cost.sum() for trial in trials)
    assert p_value(found, nulls) > 0.005
    # Three effects with one parameter each: about the largest of three squared normal variables.
    expected = np.max(np.random.default_rng(3).chisquare(1, (999, 3)), axis=1)
    assert kstest(nulls, expected).statistic < 0.5
    assert p_value(1e6, nulls) == pytest.approx(1e-3)


def test_a_score_promises_what_a_fit_keeps(weighting):
    model = BASE.with_effects(find_effects(["flow_asymmetry"]))
    theta = np.append(THETA, [0.05, 1.5e-4])
    moved = ground_of([run(seed, model=model, theta=theta) for seed in range(5)])
    problem = moved.problem(BASE, THETA)
    alone = refit(problem, fit_least_squares(problem, THETA)[0], moved.folds)
    base_fit = BaseFit.of(moved, alone)
    scores = {
        name: score(neutral(moved, name, alone.theta), base_fit, EFFECTS[name])
        for name in ("flow_asymmetry", "moving_mass", "coil_lag", "load_cell_gain")
    }
    assert max(scores, key=lambda name: scores[name].gain) == "flow_asymmetry"
    start = scores["flow_asymmetry"].start
    fitted = refit(moved.problem(model, start), start, moved.folds)
    assert fitted.theta[-2] == pytest.approx(0.05, abs=0.01)
    assert alone.cost.sum() - fitted.cost.sum() == pytest.approx(scores["flow_asymmetry"].gain, rel=0.2)
    assert scores["load_cell_gain"].unabsorbed < 0.03 < scores["coil_lag"].unabsorbed
    assert fitted.reduced_chi_square < 1.1 < alone.reduced_chi_square


def test_what_has_no_doubt_has_all_the_probability(weighting, alone):
    worse = replace(alone, unseen=alone.held_out_costs * 1.5)
    assert probabilities([alone, worse], np.random.default_rng(0)) == pytest.approx([1.0, 0.0], abs=1e-3)
    assert probabilities([alone, alone], np.random.default_rng(0)) == pytest.approx([0.5, 0.5])
    one_part = replace(alone, unseen=alone.held_out_costs + np.eye(len(alone.held_out_costs))[0] * 50.0)
    sure = probabilities([alone, one_part], np.random.default_rng(0))[0]
    assert 0.5 < sure < 1.0  # a bootstrap may leave out the part that tells


@given(st.floats(0.0, 0.99), st.floats(0.1, 10.0))
def test_closed_is_the_share_of_what_noise_does_not_explain(share, noise):
    rng = np.random.default_rng(0)
    floor = noise * rng.uniform(0.5, 2.0, 8)
    before = floor + rng.uniform(1.0, 5.0, 8)
    after = before - share * (before - floor)
    found = closed(before, after, floor, bootstrap_counts(8, rng))
    assert found.value == pytest.approx(share)
    assert found.lower <= found.value + 1e-9
    assert found.upper >= found.value - 1e-9


@pytest.mark.parametrize("means", [False, True])
def test_the_interval_of_a_play_holds_it_whether_samples_are_means_or_of_an_instant(means):
    play, fine = 7e-5, 32
    model = find_model("bouc_wen", effects=["backlash"])
    values_of = {"backlash.play": play, "backlash.resistance": 150.0, "backlash.film": MOST_FILM, "coil_lag": 0.0}
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 800.0} | values_of)
    runs = []
    for seed in range(4):
        of = run(seed, model=model, theta=theta, rate=500.0 * fine)
        force = uniform_filter1d(of.force, fine) if means else of.force
        columns = (of.time, of.position, of.velocity, of.current, force)
        runs.append(Run(of.name, *(column[::fine] for column in columns)))
    weighting = ground_of(runs)
    found = values(refit(weighting.problem(model, theta), theta, weighting.folds))["backlash.play"].value
    assert found.lower < play < found.upper
    assert found.upper - found.lower < 0.2 * play


def test_every_effect_has_forms_from_which_a_fit_can_begin():
    for effect in EFFECTS.values():
        for variant in start_values(effect, np.linspace(-900.0, 900.0, 10)):
            assert set(variant) == {parameter.name for parameter in effect.parameters}
            assert all(p.lower <= variant[p.name] <= p.upper for p in effect.parameters)
            assert variant[effect.parameters[0].name] != effect.parameters[0].default


def test_while_something_is_missing_runs_are_less_free(weighting):
    wrong = THETA.copy()
    wrong[0] *= 3
    missing = weighting.updated(BASE, wrong)
    assert missing.discrepancy > 20.0
    assert missing.correlation_length > 3.0
    assert missing.expected_noise_cost < 0.1 * weighting.samples
    assert weighting.updated(BASE, THETA).discrepancy < 0.5


@pytest.mark.parametrize("true", [("gas_spring",), ("moving_mass", "gas_spring")])
def test_an_effect_that_another_one_makes_superfluous_is_dropped(true):
    model = find_model("bouc_wen", effects=true)
    typical = {f"{name}.{key}": value for name in true for key, value in EFFECTS[name].typical.items()}
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 800.0, "coil_lag": 0.0} | typical)
    weighting = ground_of([run(seed, model=model, theta=theta) for seed in range(5)])
    alone = refit(weighting.problem(BASE, THETA), THETA, weighting.folds)
    chosen, fitted = [], alone
    for present, name in ((), "moving_mass"), (("moving_mass",), "gas_spring"):
        (trial,) = refit_with_effects(weighting, BaseFit.of(weighting, fitted), [name], 1, present=present)
        chosen, fitted = [*chosen, trial], trial.refit
    found = contest(weighting, alone, chosen, chosen[:1], np.random.default_rng(0))
    assert set(found.effects) == set(true)
    assert [len(step.problem.model.effects) for step in found.chain] == list(range(1, len(true) + 1))
    assert found.best.reduced_chi_square < 1.2
    assert found.rivals.keys() == set(true)


def test_only_a_form_that_was_asked_makes_a_doubtful_effect_unknown():
    model = find_model("bouc_wen", effects=["channel_delay"])
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 800.0, "coil_lag": 0.0, "channel_delay.delay": 0.01})
    weighting = ground_of([run(seed, model=model, theta=theta) for seed in range(5)])
    alone = refit(weighting.problem(BASE, THETA), THETA, weighting.folds)
    (trial,) = refit_with_effects(weighting, BaseFit.of(weighting, alone), ["channel_delay"], 1)
    found = contest(weighting, alone, [trial], [trial], np.random.default_rng(0))

    def said(of, chances):
        return verdict(of, alone.reduced_chi_square, {"channel_delay": chances}, [0.01], np.random.default_rng(0))

    assert said(found, {"channel_delay": 0.9, "": 0.1}) == "explained"
    assert said(found, {"channel_delay": 0.4, "": 0.6}) == "ambiguous"
    asked = found.with_alternative_models({"sigmoid": found.base})
    assert said(asked, {"channel_delay": 0.4, asked.form: 0.3, "": 0.3}) == "ambiguous"
    assert said(asked, {"channel_delay": 0.4, asked.form: 0.6}) == "unknown_effect"
