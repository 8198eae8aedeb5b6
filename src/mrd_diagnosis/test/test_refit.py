"""Refits: white errors, folds left out, the null distribution, model comparison."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter1d
from scipy.stats import kstest

from mrd_diagnosis.decision.verdict import verdict_on_gap
from mrd_diagnosis.diagnosis import RunNoise
from mrd_diagnosis.fitting.base_fit import LinearisedRefit, with_effect
from mrd_diagnosis.fitting.null_distribution import draw_null_errors, draw_null_gains
from mrd_diagnosis.fitting.refit import PLAUSIBLE_STEP, averaged_over_period, refit, scaled_inverse, without_each
from mrd_diagnosis.fitting.run_scatter import estimate_run_scatter
from mrd_diagnosis.fitting.statistics import (
    bootstrap_counts,
    certainty,
    closed_fraction,
    effect_parameters,
    model_probabilities,
    nrmse_interval,
    tempering_of,
)
from mrd_diagnosis.fitting.weighting import RunScatter, Weighting, sum_of_squares, whitening
from mrd_diagnosis.search.effect_search import EffectFit, refit_with_effects, score_effect, start_values
from mrd_diagnosis.search.model_comparison import NO_EFFECT, compare_models, compare_on
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_runs.scales import REFERENCE
from mrd_runs.signals.smoothed_run import smooth_run
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import find_model
from mrd_sim.path import run_path
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
    still = Run(f"run{seed}", t, x, np.gradient(x, t), current, np.zeros_like(t))
    force = model.force(theta, run_path(smooth_run(still)))
    return Run(still.name, t, x, still.velocity, current, (1 + gain) * force + offset + rng.normal(0, FORCE_NOISE, len(t)))


INITIAL_RUN_SCATTER = RunScatter(0.01, 2.0)


def weighting_of(runs, scatter=INITIAL_RUN_SCATTER):
    recordings = [prepare_recording(run) for run in runs]
    noises = [RunNoise(np.full(len(r.force), FORCE_NOISE), FORCE_NOISE, 0.0, "residual") for r in recordings]
    return Weighting(recordings, noises, scatter, {"coil_lag": 0.0})


def neutral(weighting, effect, theta):
    return weighting.problem(*with_effect(BASE, theta, effect))


@pytest.fixture(scope="module")
def weighting():
    return weighting_of([run(seed) for seed in range(5)])


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
    assert not white.without_weight()(rng.normal(0, 1, 20)).any()


def test_gain_error_and_offset_of_a_run_are_estimated():
    problem = weighting_of([run(1, gain=0.03, offset=4.0)], RunScatter(0.05, 10.0)).problem(BASE, THETA)
    error = problem.modelled(THETA, 0) - problem.force
    gain, offset = problem.whitenings[0].run_errors @ error
    assert (-gain, -offset) == pytest.approx((0.03, 4.0), rel=0.1)


def test_run_scatter_is_estimated_from_the_runs():
    rng = np.random.default_rng(0)
    runs = [run(seed, *rng.normal(0, (0.02, 5.0))) for seed in range(12)]
    weighting = weighting_of(runs)
    problem = weighting.problem(BASE, THETA)
    scatter = estimate_run_scatter(refit(problem, fit_least_squares(problem, THETA)[0], weighting.folds))
    assert 0.01 < scatter.gain < 0.035
    assert 2.5 < scatter.offset < 9.0


def test_a_true_model_leaves_white_errors_of_variance_one(alone):
    assert alone.chi_square == pytest.approx(1.0, abs=0.1)
    assert alone.held_out_cost >= alone.fold_costs.sum()


def test_leaving_a_fold_out_is_fitting_without_it(weighting, alone):
    problem = alone.problem
    index = 4
    run_of_fold, fold = weighting.folds[index]
    block = problem.blocks[run_of_fold]
    sigma = np.full(block.stop - block.start, FORCE_NOISE)
    sigma[fold.start - block.start : fold.stop - block.start] = 1e9
    noise = list(weighting.noise)
    noise[run_of_fold] = replace(noise[run_of_fold], sigma=sigma)
    without = replace(weighting, noise=noise).problem(BASE, THETA)
    theta, _ = fit_least_squares(without, alone.theta)
    steps, _ = without_each(problem, problem.unit(alone.theta), np.empty(0), alone.normal_matrices, alone.gradients)
    step = steps[index]
    wrong = np.abs(problem.unit(step) - problem.unit(theta))
    standard_error = np.sqrt(np.diag(np.linalg.inv(alone.normal_matrices.sum(axis=0))))
    assert (wrong < 0.25 * standard_error).all()
    assert np.abs(problem.unit(step) - problem.unit(alone.theta)).max() > 0.1 * standard_error.min()


@pytest.mark.parametrize("known", ["by no fold", "by one fold"])
def test_a_parameter_without_information_stays_unless_it_leaves_with_its_only_fold(alone, known):
    problem, lost = alone.problem, 1
    unit = problem.unit(alone.theta)
    neutral_unit = problem.unit(problem.model.defaults)
    unit[lost] = 0.5 * neutral_unit[lost]
    matrices, gradients = alone.normal_matrices.copy(), alone.gradients.copy()
    dead = slice(0, None) if known == "by no fold" else slice(1, None)
    matrices[dead, lost, :] = matrices[dead, :, lost] = gradients[dead, lost] = 0.0
    thetas, _ = without_each(problem, unit, np.empty(0), matrices, gradients)
    expected = unit[lost] if known == "by no fold" else neutral_unit[lost]
    assert problem.unit(thetas[0])[lost] == pytest.approx(expected)


@pytest.mark.parametrize("information", [1e-6, 1e-3, 1.0, 1e3])
def test_a_parameter_that_other_folds_do_not_determine_is_held(alone, information):
    # Errors count as independent ones of variance one: the deviation of a parameter is 1 / sqrt(information).
    problem, place, folds, rng = alone.problem, 1, 10, np.random.default_rng(3)
    count = alone.normal_matrices.shape[1]
    matrices = np.repeat(1e6 * np.eye(count)[None], folds, axis=0) / folds
    gradients = rng.normal(0, np.sqrt(1e6 / folds), (folds, count))
    matrices[:, place, place] = information / folds
    gradients[:, place] = rng.normal(0, np.sqrt(information / folds), folds)
    gradients -= gradients.mean(axis=0)
    unit = np.full(count, 0.5)
    thetas, _ = without_each(problem, unit, np.empty(0), matrices, gradients)
    steps = np.abs(np.array([problem.unit(theta) for theta in thetas]) - unit)
    assert steps[:, place].max() < PLAUSIBLE_STEP
    plain = np.abs(gradients) / (1e6 * (folds - 1) / folds)
    others = [other for other in range(count) if other != place]
    assert steps[:, others] == pytest.approx(plain[:, others], rel=0.02)


def test_gains_in_noise_follow_their_null_distribution(weighting, alone):
    effects = ("moving_mass", "force_sensor_lag", "channel_delay")
    base_fit = LinearisedRefit.around(weighting, alone)
    problems = {name: neutral(weighting, name, alone.theta) for name in effects}
    noise = draw_null_errors(alone.problem, alone.theta, [FORCE_NOISE] * 5, INITIAL_RUN_SCATTER, np.random.default_rng(1))
    starts = {name: score_effect(problems[name], base_fit, EFFECTS[name]).start for name in effects}
    refits = [refit(problems[name], starts[name], weighting.folds, noise) for name in effects]
    nulls = draw_null_gains(alone, refits, np.random.default_rng(2))
    largest = max(alone.fold_costs.sum() - fitted.fold_costs.sum() for fitted in refits)
    assert nulls.p_value(largest, alone.problem) > 0.005
    # Three effects with one parameter each: about the largest of three squared normal variables.
    expected = np.max(np.random.default_rng(3).chisquare(1, (999, 3)), axis=1)
    assert kstest(nulls.gains, expected).statistic < 0.5
    assert nulls.p_value(1e6, alone.problem) == pytest.approx(1e-3)
    # While an error was not explained yet, noise had a small part in it, and so had its gains.
    before = replace(weighting, discrepancy=3.0 * FORCE_NOISE)
    flattened = replace(
        nulls, gains=0.1 * nulls.gains, noise_cost=before.problem(alone.problem.model, alone.theta).noise_cost
    )
    assert flattened.p_value(largest, alone.problem) == pytest.approx(nulls.p_value(largest, alone.problem), abs=0.1)


def test_a_fit_that_diverged_in_one_fold_makes_nothing_equally_probable():
    """The error of a diverged fit counted as a gap, a share of which may be an error of the formula."""
    rng = np.random.default_rng(0)
    problem = SimpleNamespace(residuals=lambda theta: np.random.default_rng(1).normal(size=800))

    def fitted(costs, cost):
        return SimpleNamespace(
            held_out_costs=np.array(costs), fold_costs=np.full(8, cost / 8), chi_square=1.0, problem=problem, theta=None
        )

    right, none, wrong = fitted([62.5] * 8, 500.0), fitted([250.0] * 7 + [np.inf], 2000.0), fitted([187.5] * 8, 1500.0)
    assert model_probabilities([right, none, wrong], rng)[0] > 0.99


def test_a_score_predicts_the_gain_of_a_fit():
    model = BASE.with_effects(find_effects(["flow_asymmetry"]))
    theta = np.append(THETA, [0.05, 1.5e-4])
    weighting_with_asymmetry = weighting_of([run(seed, model=model, theta=theta) for seed in range(5)])
    problem = weighting_with_asymmetry.problem(BASE, THETA)
    alone = refit(problem, fit_least_squares(problem, THETA)[0], weighting_with_asymmetry.folds)
    base_fit = LinearisedRefit.around(weighting_with_asymmetry, alone)
    scores = {
        name: score_effect(neutral(weighting_with_asymmetry, name, alone.theta), base_fit, EFFECTS[name])
        for name in ("flow_asymmetry", "moving_mass", "coil_lag", "load_cell_gain")
    }
    assert max(scores, key=lambda name: scores[name].gain) == "flow_asymmetry"
    start = scores["flow_asymmetry"].start
    fitted = refit(weighting_with_asymmetry.problem(model, start), start, weighting_with_asymmetry.folds)
    assert fitted.theta[-2] == pytest.approx(0.05, abs=0.01)
    assert alone.fold_costs.sum() - fitted.fold_costs.sum() == pytest.approx(scores["flow_asymmetry"].gain, rel=0.2)
    assert scores["load_cell_gain"].gain < 0.03 * scores["flow_asymmetry"].gain
    assert fitted.chi_square < 1.1 < alone.chi_square


def test_an_effect_with_which_the_model_diverges_scores_nothing(weighting, alone):
    """A damper whose viscosity is negative at some current is unstable behind a spring: its force overflows, or is none."""
    base_fit = LinearisedRefit.around(weighting, alone)
    problem = neutral(weighting, "series_compliance", alone.theta)
    for diverged in np.full((2, len(problem.force)), [[1e200], [np.nan]]):
        stub = SimpleNamespace(model=problem.model, force=problem.force, residuals=lambda theta, errors=diverged: errors)
        assert score_effect(stub, base_fit, EFFECTS["series_compliance"]).gain == 0.0
        assert not np.isfinite(sum_of_squares(diverged))


def test_a_model_that_diverges_predicts_nothing(weighting, monkeypatch):
    """Its force may be finite where the squares of its derivatives are not."""
    problem = neutral(weighting, "cavitation", THETA)
    monkeypatch.setattr(type(problem), "jacobian", lambda self, unit, *_: np.full((len(self.force), len(self.free)), 1e200))
    diverged = refit(problem, problem.theta(problem.unit(problem.model.defaults)), weighting.folds)
    assert diverged.held_out_cost == np.inf
    assert np.isfinite(diverged.information).all()
    assert effect_parameters(diverged).keys() >= {"cavitation.stiffness"}


def test_a_clearly_better_refit_has_all_the_probability(weighting, alone):
    worse = replace(alone, held_out_costs=alone.held_out_costs * 1.5)
    assert model_probabilities([alone, worse], np.random.default_rng(0)) == pytest.approx([1.0, 0.0], abs=1e-3)
    assert model_probabilities([alone, alone], np.random.default_rng(0)) == pytest.approx([0.5, 0.5])
    costs = alone.held_out_costs + np.eye(len(alone.held_out_costs))[0] * 50.0
    worse_in_one_fold = replace(alone, held_out_costs=costs)
    sure = model_probabilities([alone, worse_in_one_fold], np.random.default_rng(0))[0]
    assert 0.5 < sure < 1.0  # a bootstrap sample may lack the fold in which they differ


@pytest.mark.parametrize("cost", [100.0, np.inf, np.nan])
def test_a_fit_that_diverges_makes_no_others_alike(alone, cost):
    worse, other = (replace(alone, held_out_costs=alone.held_out_costs * factor) for factor in (1.5, 1.1))
    diverged = replace(alone, held_out_costs=alone.held_out_costs * cost)
    without_it = model_probabilities([alone, worse, other], np.random.default_rng(0))
    assert model_probabilities([alone, worse, other, diverged], np.random.default_rng(0)) == pytest.approx(
        [*without_it, 0.0]
    )


def test_what_the_best_explanation_leaves_says_how_inexact_formulas_are(alone):
    """The same lead is decisive beside noise, and not beside an error ten times as large."""
    lead, wrong = 0.06, replace(alone, held_out_chi_squares=11.0 * alone.held_out_chi_squares)
    probabilities = []
    for best in (alone, wrong):
        others = [replace(best, held_out_costs=best.held_out_costs * (1.0 + behind)) for behind in (0.5, lead)]
        probabilities.append(model_probabilities([best, *others], np.random.default_rng(0))[0])
    assert probabilities[0] > 0.95
    assert 0.55 < probabilities[1] < 0.75


def test_which_effect_acts_depends_more_on_its_formula_than_whether_any_does(alone):
    """A look-alike a little behind stays open where formulas leave an error, also one that counts as noise of a change."""

    def shares(best, effects):
        none, alike = (replace(best, held_out_costs=best.held_out_costs * factor) for factor in (4.0, 1.2))
        return dict(zip("abc", model_probabilities([best, none, alike], np.random.default_rng(0), effects), strict=True))

    effects = ["end_stop", "", "hardening_spring"]
    wrong = replace(alone, held_out_chi_squares=11.0 * alone.held_out_chi_squares)
    compared = replace(alone, problem=replace(alone.problem, unexplained=0.9))
    assert shares(alone, effects) == pytest.approx(shares(alone, None))
    for best in (wrong, compared):
        of_all, of_effects = shares(best, None), shares(best, effects)
        assert of_effects["b"] == pytest.approx(of_all["b"])
        assert of_effects["c"] > max(3 * of_all["c"], 0.05)
        assert of_effects["a"] > of_effects["c"]


@given(st.floats(0.0, 0.99), st.floats(0.1, 10.0))
def test_the_closed_fraction_is_a_share_of_the_gap_beyond_noise(share, noise):
    rng = np.random.default_rng(0)
    floor = noise * rng.uniform(0.5, 2.0, 8)
    before = floor + rng.uniform(1.0, 5.0, 8)
    after = before - share * (before - floor)
    closed = closed_fraction(before, after, floor, bootstrap_counts(8, rng))
    assert closed.value == pytest.approx(share)
    assert closed.lower <= closed.value + 1e-9
    assert closed.upper >= closed.value - 1e-9


@pytest.mark.parametrize("units", [4, 8])
def test_intervals_of_few_units_cover(units):
    rng, draws = np.random.default_rng(0), 400
    covered = np.zeros(2)
    for _ in range(draws):
        gap, noise = rng.lognormal(-0.08, 0.4, units), np.full(units, 0.1)  # its mean is 1
        share = rng.normal(0.7, 0.15, units)
        counts = bootstrap_counts(units, rng)
        error = nrmse_interval(noise + gap, np.ones(units), 1.0, counts)
        closed = closed_fraction(noise + gap, noise + (1.0 - share) * gap, noise, counts)
        covered += error.lower < np.sqrt(1.1) < error.upper, closed.lower < 0.7 < closed.upper
    assert (covered >= 0.9 * draws).all()
    assert (covered <= 0.98 * draws).all()


@pytest.mark.parametrize("averaged", [False, True])
def test_the_interval_of_a_play_contains_it_for_averaged_and_instantaneous_samples(averaged):
    play, fine = 7e-5, 32
    model = find_model("bouc_wen", effects=["backlash"])
    values_of = {"backlash.play": play, "backlash.resistance": 150.0, "backlash.film": MOST_FILM, "coil_lag": 0.0}
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 800.0} | values_of)
    runs = []
    for seed in range(4):
        fine_run = run(seed, model=model, theta=theta, rate=500.0 * fine)
        force = uniform_filter1d(fine_run.force, fine) if averaged else fine_run.force
        columns = (fine_run.time, fine_run.position, fine_run.velocity, fine_run.current, force)
        runs.append(Run(fine_run.name, *(column[::fine] for column in columns)))
    weighting = weighting_of(runs)
    refitted = refit(weighting.problem(model, theta), theta, weighting.folds)
    interval = effect_parameters(refitted)["backlash.play"].value
    assert interval.lower < play < interval.upper
    assert interval.upper - interval.lower < 0.2 * play


@pytest.mark.parametrize("step", [1, 4])
@pytest.mark.parametrize("force", ["straight lines", "jump"])
def test_samples_are_averaged_over_their_period(force, step):
    """The exact mean of straight lines between the counted samples, and the mean over where a jump may be."""
    parts = 80  # of a sampling period
    fine = np.arange(-parts // 2, 5 * step * parts + parts // 2) + 0.5  # from half a period before the first counted sample
    counted = step * parts * np.arange(6)
    if force == "jump":
        forces = [7.0 * (fine > place) for place in range(2 * step * parts, 3 * step * parts)]
        sampled = np.array([0.0, 0.0, 0.0, 7.0, 7.0, 7.0])
    else:
        sampled = np.random.default_rng(0).normal(size=6)
        forces = [np.interp(fine, counted, sampled)]
    means = np.mean([np.asarray(f)[sample : sample + parts] for f in forces for sample in counted], axis=1)
    problem = SimpleNamespace(blocks=[slice(1, 7)], recordings=[SimpleNamespace(step=step)])
    averaged = averaged_over_period(np.concatenate([[100.0], sampled]), problem)
    assert averaged[2:-1] == pytest.approx(means.reshape(-1, 6).mean(axis=0)[1:-1], rel=0.03)
    assert averaged[0] == 100.0


@pytest.mark.parametrize("matrix", [np.zeros((2, 2)), np.diag([0.0, 4.0]), np.empty((0, 0))])
def test_where_nothing_is_known_the_inverse_is_large_and_finite(matrix):
    inverse = scaled_inverse(matrix, 1e-12)
    assert np.isfinite(inverse).all()
    unknown = np.diag(matrix) == 0.0
    assert (np.diag(inverse)[unknown] > 1e12).all()
    assert np.diag(inverse)[~unknown] == pytest.approx(1.0 / np.diag(matrix)[~unknown])
    assert np.array_equal(inverse @ np.zeros(len(matrix)), np.zeros(len(matrix)))


def test_every_effect_has_start_values_within_its_bounds():
    for effect in EFFECTS.values():
        for variant in start_values(effect, np.linspace(-900.0, 900.0, 10)):
            assert set(variant) == {parameter.name for parameter in effect.parameters}
            assert all(p.lower <= variant[p.name] <= p.upper for p in effect.parameters)
            assert variant[effect.parameters[0].name] != effect.parameters[0].default


def test_a_discrepancy_restricts_gain_and_offset_of_the_runs(weighting):
    wrong = THETA.copy()
    wrong[0] *= 3
    updated = weighting.updated(BASE, wrong)
    assert updated.discrepancy > 20.0
    assert updated.error_correlation > 3.0
    assert updated.noise_cost < 0.1 * weighting.samples
    assert weighting.updated(BASE, THETA).discrepancy < 0.5


@pytest.mark.parametrize("true", [("gas_spring",), ("moving_mass", "gas_spring")])
def test_an_effect_that_another_one_makes_superfluous_is_dropped(true):
    model = find_model("bouc_wen", effects=true)
    typical = {f"{name}.{key}": value for name in true for key, value in EFFECTS[name].typical.items()}
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 800.0, "coil_lag": 0.0} | typical)
    weighting = weighting_of([run(seed, model=model, theta=theta) for seed in range(5)])
    alone = refit(weighting.problem(BASE, THETA), THETA, weighting.folds)
    chosen, fitted = [], alone
    for present, name in ((), "moving_mass"), (("moving_mass",), "gas_spring"):
        (fit,) = refit_with_effects(weighting, LinearisedRefit.around(weighting, fitted), [name], 1, present=present)
        chosen, fitted = [*chosen, fit], fit.refit
    comparison = compare_models(weighting, alone, chosen, chosen[:1], np.random.default_rng(0))
    assert set(comparison.effects) == set(true)
    assert [len(step.problem.model.effects) for step in comparison.chain] == list(range(1, len(true) + 1))
    assert comparison.best.chi_square < 1.2
    assert comparison.alternatives.keys() == set(true)


def test_what_looks_like_a_cause_is_fitted_in_its_place_though_others_do_more_by_themselves(delayed):
    comparison, _ = delayed
    names = ["flow_asymmetry", "settling", "mains_hum", "load_cell_drift", "gas_spring", "moving_mass", "force_sensor_lag"]
    chosen = EffectFit(("channel_delay",), comparison.best, 1.0, 1.0)
    folds = len(comparison.best.held_out_costs)
    singles = [
        EffectFit((name,), replace(comparison.base, held_out_costs=np.full(folds, 1e3 + rank)), 0.0, 0.0)
        for rank, name in enumerate(names)
    ]
    compared = compare_on(comparison.weighting, comparison.base, [chosen], [chosen, *singles])
    tried = set(compared.alternatives["channel_delay"]) - {"channel_delay", NO_EFFECT}
    assert tried == {*names[:4], "moving_mass", "force_sensor_lag"}


@pytest.fixture(scope="module")
def delayed():
    """Comparison on runs whose force channel is delayed, and the reduced chi-square of the model without effects."""
    model = find_model("bouc_wen", effects=["channel_delay"])
    theta = model.vector({"yield_force": 60.0, "yield_force_per_A": 800.0, "coil_lag": 0.0, "channel_delay.delay": 0.01})
    weighting = weighting_of([run(seed, model=model, theta=theta) for seed in range(5)])
    alone = refit(weighting.problem(BASE, THETA), THETA, weighting.folds)
    (fit,) = refit_with_effects(weighting, LinearisedRefit.around(weighting, alone), ["channel_delay"], 1)
    return compare_models(weighting, alone, [fit], [fit], np.random.default_rng(0)), alone.chi_square


def verdict(delayed, probabilities_of_delay, p_value_of_delay=0.01):
    comparison, chi_square = delayed
    probabilities_of_causes = {"channel_delay": probabilities_of_delay}
    p_values = {"channel_delay": p_value_of_delay}
    return verdict_on_gap(comparison, chi_square, probabilities_of_causes, p_values, np.random.default_rng(0))


def test_a_certain_effect_is_explained_and_an_uncertain_one_is_ambiguous(delayed):
    assert verdict(delayed, {"channel_delay": 0.9, "": 0.1}) == "explained"
    assert verdict(delayed, {"channel_delay": 0.4, "": 0.6}) == "ambiguous"


def test_a_likelier_damper_model_makes_the_effect_unknown(delayed):
    comparison, chi_square = delayed
    extended = comparison.with_alternative_models({"sigmoid": comparison.base}), chi_square
    # Without a fit of the damper model, no probability can speak for it.
    assert verdict(delayed, {"channel_delay": 0.4, "sigmoid": 0.6}) == "ambiguous"
    assert verdict(extended, {"channel_delay": 0.4, "sigmoid": 0.3, "": 0.3}) == "ambiguous"
    assert verdict(extended, {"channel_delay": 0.4, "sigmoid": 0.6}) == "unknown_effect"


def test_without_a_chosen_effect_a_gap_is_unknown(delayed):
    comparison, chi_square = delayed
    without = comparison.without_effects()
    assert verdict_on_gap(without, chi_square, {}, {}, np.random.default_rng(0)) == "unknown_effect"


def test_an_error_that_noise_explains_is_no_gap(delayed):
    comparison, _ = delayed
    certain = {"channel_delay": {"channel_delay": 1.0}}
    assert verdict_on_gap(comparison, 1.05, certain, {"channel_delay": 0.01}, np.random.default_rng(0)) == "no_gap"


@pytest.mark.parametrize("gap", [-1.0, 0.0, 1e-300, 5e-324])
@pytest.mark.parametrize("lead", [-1e30, -1.0, 0.0, 1.0, 1e30])
def test_explanations_that_close_nothing_make_no_infinite_quotients(gap: float, lead: float) -> None:
    assert certainty(lead, gap) == (0.5 if lead == 0 else float(lead > 0))
    assert tempering_of(1e6, gap) == 1.0


def test_what_follows_from_the_scale_of_a_damper_is_no_parameter_that_differs_from_its_default():
    scales = replace(REFERENCE, stroke=5.0 * REFERENCE.stroke)
    model = find_model("bouc_wen", effects=["lvdt_nonlinearity"], scales=scales)
    weighting = weighting_of([run(0)])
    theta = model.vector({})
    refitted = refit(weighting.problem(model, theta), theta, weighting.folds)
    free = {p.name for p in model.parameters if "." in p.name and p.free}
    assert free
    assert effect_parameters(refitted).keys() == free
