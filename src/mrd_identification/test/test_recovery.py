"""Statistics of identification: known parameters are recovered, intervals cover them, and warnings are given where due."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter, sawtooth

from mrd_identification import identify
from mrd_identification.fit_warnings import fit_warnings
from mrd_identification.least_squares import fit_least_squares, levenberg_marquardt
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, prepare_recording
from mrd_identification.residual_correlation import correlation_length
from mrd_identification.uncertainty import uncertainty
from mrd_runs import Run
from mrd_sim.models import MODELS, find_model
from mrd_sim.parameter import Parameter
from mrd_sim.path import make_path

LEVELS = (0.0, 0.1, 0.25, 0.4, 0.6, 0.8, 1.0)  # A
LINES = ((0.5, 6e-3), (1.5, 4e-3), (4.0, 3e-3), (7.0, 2e-3))  # Hz, m: up to 15 mm and 0.22 m/s


def simulate_run(model, theta, time, motion, current, name="run"):
    """Return a recording of a damper from its exact motion; identification uses the position only."""
    position, velocity, acceleration = motion
    force = model.force(theta, make_path(time, position, velocity, acceleration, current))
    return Run(name, time, position, velocity, current, force)


def multisine(time, lines, phases):
    w, amplitude = 2 * np.pi * np.array([f for f, _ in lines]), np.array([a for _, a in lines])
    angle = np.outer(time, w) + phases
    return np.sin(angle) @ amplitude, np.cos(angle) @ (amplitude * w), -np.sin(angle) @ (amplitude * w**2)


def simulate_experiment(model, theta, seed, seconds=5.0, rate=500.0):
    """Simulate a multisine while the current is switched at random between levels from 0 to 1 A."""
    random = np.random.default_rng(seed)
    time = np.arange(int(rate * seconds)) / rate
    motion = multisine(time, LINES, random.uniform(0, 2 * np.pi, len(LINES)))
    hold = int(0.15 * rate)
    current = np.repeat(random.choice(LEVELS, len(time) // hold + 1), hold)[: len(time)]
    return simulate_run(model, theta, time, motion, current, f"run{seed}")


def unit_box(model):
    """Return a problem without recordings, which scales the free parameters of a model to the unit box."""
    free = tuple(index for index, parameter in enumerate(model.parameters) if parameter.free)
    return Problem(model, [], free, model.defaults)


def true_parameters(model, seed=0):
    """Return parameters up to a quarter of the way from the defaults to a bound.

    No coefficient is limited by its lower bound at any of the currents, where it could not be identified.
    """
    random = np.random.default_rng(seed)
    problem = unit_box(model)
    start = problem.unit(model.defaults)
    for _ in range(1000):
        side = np.where(start < 0.02, 1, np.where(start > 0.98, 0, random.integers(0, 2, len(start))))
        theta = problem.theta(start + random.uniform(0.08, 0.25, len(start)) * (side - start))
        if all(
            model.at_current(theta, current)[quantity.name] > 1.2 * quantity.lower
            for quantity in model.coefficients
            if quantity.per_ampere and not quantity.multiplies and quantity.law != "constant"
            for current in LEVELS
        ):
            return theta
    raise AssertionError(f"{model.id}: no parameters whose coefficients are all above their lower bounds")


def with_noise(run, deviation, seed):
    return replace(run, force=run.force + deviation * np.random.default_rng(seed).standard_normal(len(run)))


def with_force(recording: Recording, force: np.ndarray) -> Recording:
    run = replace(recording.run, force=force)
    return replace(recording, smoothed=replace(recording.smoothed, run=run))


# ---------------------------------------------------------------------------------------------------------- recovery


@pytest.mark.parametrize("name", MODELS)
def test_known_parameters_are_recovered_without_noise(name):
    model = MODELS[name]
    theta = true_parameters(model)
    runs = [simulate_experiment(model, theta, seed) for seed in (1, 2)]
    fit = identify(runs[:1], name, held_out=runs[1:], population=20, generations=10, seeds=1, profile=False)
    assert fit.pooled_fitted.nrmse < 1e-4
    assert fit.pooled_held_out.nrmse < 1e-4
    # All parameters are recovered, so no parameter of any model is redundant.
    assert fit.theta == pytest.approx(theta, rel=0.01)
    # What rounding leaves may be correlated for long.
    assert [warning for warning in fit.warnings if "the residuals are correlated" not in warning] == []


@pytest.mark.parametrize("name", MODELS)
def test_known_parameters_are_recovered_with_noise(name):
    model = MODELS[name]
    theta = true_parameters(model, seed=1)
    runs = [simulate_experiment(model, theta, seed) for seed in (3, 4)]
    seed = list(MODELS).index(name)
    runs = [with_noise(run, 0.02 * np.std(run.force), 10 * seed + place) for place, run in enumerate(runs)]
    fit = identify(runs, name, population=16, generations=8, seeds=1, profile=False)
    assert fit.held_out_by == "leave-one-run-out"
    assert fit.pooled_fitted.nrmse == pytest.approx(0.02, rel=0.05)
    assert fit.pooled_held_out.nrmse == pytest.approx(0.02, rel=0.1)
    free = [(estimate, true) for estimate, true in zip(fit.estimates, theta, strict=True) if not estimate.fixed]
    assert sum(estimate.on_bound for estimate, _ in free) <= 1
    for estimate, true in free:
        if not estimate.on_bound:
            deviation = (estimate.upper - estimate.lower) / 3.92
            assert abs(estimate.value - true) < 4.5 * deviation, estimate.parameter.name
            assert deviation < 0.05 * (estimate.parameter.upper - estimate.parameter.lower), estimate.parameter.name


@pytest.mark.parametrize(("name", "seed"), [("hyperbolic_tangent", 7), ("modified_bouc_wen", 3)])
def test_the_search_finds_the_optimum_that_least_squares_alone_misses(name, seed):
    model = MODELS[name]
    problem = unit_box(model)
    theta = problem.theta(np.random.default_rng(seed).uniform(0.1, 0.9, len(problem.free)))
    run = simulate_experiment(model, theta, 1, seconds=3.0, rate=250.0)
    full, _ = make_problem(model, [prepare_recording(run)])
    _, cost = fit_least_squares(full, full.project(model.defaults[None])[0][0])
    assert np.sqrt(2 * cost / len(full.force)) > 0.05 * np.std(full.force)
    fit = identify([run], name, profile=False)
    assert fit.pooled_fitted.nrmse < 1e-4
    assert fit.theta == pytest.approx(theta, rel=0.01)


def test_a_trial_that_diverges_costs_too_much_without_a_word():
    """Residuals whose squares overflow printed a warning of NumPy."""
    problem = SimpleNamespace(
        loss="linear",
        theta=lambda unit: unit,
        residuals=lambda unit: np.full(9, 1e-3 if unit[0] < 0.5 else 1e200) + unit[0] - 0.9,
        robust_weights=np.ones_like,
        jacobian=lambda unit, moving: np.ones((9, 1)),
    )
    unit, cost = levenberg_marquardt(problem, np.array([0.1]), np.arange(1), 20)
    assert 0.1 < unit[0] < 0.5
    assert np.isfinite(cost)


@pytest.mark.parametrize("loss", ["linear", "huber", "soft_l1"])
def test_least_squares_agree_with_scipy_also_on_bounds(loss):
    model = find_model("bouc_wen")
    run = simulate_experiment(model, model.vector({"viscous": 0.0, "viscous_per_A": 500.0}), 1, seconds=2.0)
    run = with_noise(replace(run, force=run.force - 200.0 * run.velocity), 30.0, 1)
    problem = replace(make_problem(model, [prepare_recording(run)])[0], loss=loss, loss_scale=30.0)
    theta, cost = fit_least_squares(problem, model.defaults)
    reference = least_squares(
        lambda unit: problem.residuals(problem.theta(unit)),
        problem.unit(model.defaults).clip(1e-4, 1 - 1e-4),
        jac=problem.jacobian,
        bounds=(0.0, 1.0),
        x_scale="jac",
        loss=loss,
        f_scale=30.0,
        xtol=1e-12,
        ftol=1e-12,
    )
    assert theta[model.names.index("viscous")] == 0.0
    assert cost <= reference.cost * (1 + 1e-9)
    assert cost == pytest.approx(reference.cost, rel=1e-4)
    assert cost == pytest.approx(problem.cost(theta))


# --------------------------------------------------------------------------------------------------------- intervals


def autoregressive_noise(random, count, tau):
    """Return noise of variance 1 whose correlation decays as exp(-t / tau), tau in samples."""
    a = np.exp(-1.0 / tau)
    return lfilter([np.sqrt(1 - a * a)], [1, -a], random.standard_normal(count + int(20 * tau)))[-count:]


def coverage(name, errors, *, seconds, rate, share=0.02, repeats=200, profile=False):
    """Return whether 95 % intervals contain the truth (repeats, free), nan where there is no interval.

    Each repeat has other errors; its fit starts at the truth.
    """
    model = MODELS[name]
    theta = true_parameters(model)
    recordings = [prepare_recording(simulate_experiment(model, theta, seed, seconds, rate)) for seed in (1, 2)]
    forces = [model.force(theta, recording.path) for recording in recordings]
    deviation = share * np.std(np.concatenate(forces))
    random = np.random.default_rng(list(MODELS).index(name))
    holds = []
    for _ in range(repeats):
        measured = [
            with_force(recording, force + deviation * errors(random, len(force)))
            for recording, force in zip(recordings, forces, strict=True)
        ]
        problem, _ = make_problem(model, measured)
        estimate, _ = fit_least_squares(problem, theta)
        result = uncertainty(problem, estimate, profile=profile)
        lower, upper = (result.profile_lower, result.profile_upper) if profile else (result.lower, result.upper)
        true = theta[list(problem.free)]
        holds.append(np.where(np.isnan(lower), np.nan, (lower <= true) & (true <= upper)))
    return np.array(holds)


def assert_covers(holds):
    assert np.isnan(holds).mean() < 0.1
    by_parameter = np.nanmean(holds, axis=0)
    assert 0.90 <= np.nanmean(holds) <= 0.99, by_parameter
    assert by_parameter.min() >= 0.86, by_parameter


class Location(Problem):
    """A problem whose only parameter is the force itself."""

    def forces(self, theta):
        return np.full(len(self.force), theta[0])

    def jacobian(self, unit, indices=None):
        return np.full((len(self.force), 1), self.scale(self.theta(unit))[0])


@pytest.mark.parametrize("loss", ["linear", "soft_l1", "huber"])
def test_intervals_of_a_robust_location_cover_the_truth(loss):
    model = SimpleNamespace(parameters=(Parameter("force", "N", 0.0, -10.0, 10.0, "location"),), linear=())
    random = np.random.default_rng(4)
    covered = []
    for _ in range(400):
        recording = SimpleNamespace(force=random.standard_normal(100), weight=1.0)
        problem = Location(model, [recording], (0,), np.zeros(1), loss=loss, loss_scale=0.5)
        theta, _ = fit_least_squares(problem, np.zeros(1))
        result = uncertainty(problem, theta, profile=len(covered) == 0)
        if not covered:
            profile = result.profile_upper - result.profile_lower
            assert profile == pytest.approx(result.upper - result.lower, rel=0.15)
        covered.append(bool(result.lower[0] <= 0.0 <= result.upper[0]))
    assert 0.92 <= np.mean(covered) <= 0.98


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", MODELS)
def test_intervals_cover_the_truth_with_white_errors(name):
    assert_covers(coverage(name, lambda random, count: random.standard_normal(count), seconds=4.0, rate=250.0))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["bingham", "bouc_wen"])
def test_intervals_cover_the_truth_with_correlated_errors(name):
    """The errors are correlated over 0.1 s, which is 10 samples."""
    assert_covers(coverage(name, lambda random, count: autoregressive_noise(random, count, 10.0), seconds=30.0, rate=100.0))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["bingham", "bouc_wen"])
def test_intervals_cover_the_truth_with_slow_errors_under_fast_ones(name):
    """8 % of the variance is correlated over 0.3 s; it dominates the uncertainty of an offset and a stiffness."""

    def errors(random, count):
        return np.sqrt(0.92) * random.standard_normal(count) + np.sqrt(0.08) * autoregressive_noise(random, count, 30.0)

    assert_covers(coverage(name, errors, seconds=40.0, rate=100.0))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["sigmoid", "modified_lugre"])
def test_profiles_cover_the_truth(name):
    """There is so much noise that the objective is not a parabola and some profiles end on a bound."""
    holds = coverage(
        name, lambda random, count: random.standard_normal(count), seconds=4.0, rate=250.0, share=0.15, profile=True
    )
    assert_covers(holds)


@pytest.mark.parametrize(
    ("tau", "share", "least", "most"), [(0.0, 0.0, 1, 1), (10.0, 1.0, 12, 64), (50.0, 1.0, 60, 260), (30.0, 0.08, 30, 128)]
)
def test_correlation_length_sees_slow_errors_under_fast_ones(tau, share, least, most):
    random = np.random.default_rng(0)
    residuals = np.sqrt(1 - share) * random.standard_normal(20000)
    if tau:
        residuals += np.sqrt(share) * autoregressive_noise(random, len(residuals), tau)
    assert least <= correlation_length(residuals) <= most


def test_correlation_length_of_constant_residuals_is_one_sample():
    assert correlation_length(np.zeros(100)) == 1
    assert correlation_length(np.ones(1)) == 1


@pytest.fixture(scope="module")
def curved():
    """A sigmoid that two sines hardly determine: the objective is not a parabola."""
    model = find_model("sigmoid")
    time = np.arange(2000) / 200.0
    runs = [
        with_noise(
            simulate_run(model, model.defaults, time, multisine(time, [(f, 8e-3)], 0.0), np.full(2000, 0.3)),
            30.0,
            int(10 * f),
        )
        for f in (0.7, 2.0)
    ]
    problem, _ = make_problem(model, [prepare_recording(run) for run in runs])
    theta, _ = fit_least_squares(problem, model.defaults)
    return problem, theta, uncertainty(problem, theta)


def test_profile_ends_where_the_refitted_objective_has_risen(curved):
    """With all other parameters refitted the objective is equally high at both ends, at different distances."""
    problem, theta, result = curved
    best = problem.cost(theta)
    place = [parameter.name for parameter in problem.parameters].index("steepness")
    index = problem.free[place]
    rises = []
    for end in (result.profile_lower[place], result.profile_upper[place]):
        start = theta.copy()
        start[index] = end
        constrained, _ = make_problem(problem.model, problem.recordings, fixed={"steepness": float(end)})
        rises.append(fit_least_squares(constrained, start)[1] - best)
    assert rises[0] == pytest.approx(rises[1], rel=0.25)
    lower, upper = (np.log(end[place] / theta[index]) for end in (result.profile_lower, result.profile_upper))
    assert abs(-lower / upper - 1.0) > 0.3


def test_profile_of_a_linear_model_is_the_covariance_interval_at_two_evaluations_per_parameter(monkeypatch):
    model = find_model("polynomial")
    theta = true_parameters(model)
    run = with_noise(simulate_experiment(model, theta, 1), 5.0, 0)
    problem, _ = make_problem(model, [prepare_recording(run)])
    theta, _ = fit_least_squares(problem, theta)
    evaluations = []
    evaluate = Problem.cost
    monkeypatch.setattr(Problem, "cost", lambda self, theta: evaluations.append(1) or evaluate(self, theta))
    result = uncertainty(problem, theta)
    assert result.profile_lower == pytest.approx(result.lower)
    assert result.profile_upper == pytest.approx(result.upper)
    assert len(evaluations) <= 1 + 2 * len(problem.free)


def test_a_parameter_on_a_bound_has_a_profile_on_the_inner_side():
    """The fluid has no viscosity: the estimate is 0, and the profile limits how large it may be."""
    model = find_model("linear_viscous")
    theta = model.vector({"viscous": 0.0, "viscous_per_A": 0.0, "offset": 0.0})
    time = np.arange(1000) / 200.0
    run = with_noise(simulate_run(model, theta, time, multisine(time, LINES, np.zeros(4)), np.zeros(1000)), 10.0, 2)
    problem, _ = make_problem(model, [prepare_recording(run)])
    fitted, _ = fit_least_squares(problem, theta)
    result = uncertainty(problem, fitted)
    speed = np.std(problem.recordings[0].path.velocity)
    assert result.on_bound[0]
    assert result.profile_lower[0] == 0.0
    assert result.profile_upper[0] == pytest.approx(1.96 * 10.0 / speed / np.sqrt(len(problem.force)), rel=0.2)
    assert 0.0 < result.beyond[0] < 1.0


def test_without_errors_intervals_have_no_width_and_there_are_no_warnings():
    """The measured force equals the modelled one to the last digit."""
    for name in ("bingham", "modified_bouc_wen"):
        model = find_model(name)
        theta = true_parameters(model)
        recording = prepare_recording(simulate_experiment(model, theta, 1))
        exact = with_force(recording, model.force(theta, recording.path))
        problem, _ = make_problem(model, [exact])
        result = uncertainty(problem, theta)
        for ends in (result.lower, result.upper, result.profile_lower, result.profile_upper):
            assert ends == pytest.approx(theta[list(problem.free)], rel=1e-6)
        assert np.isfinite(result.correlation).all()
        assert fit_warnings(problem, theta, result, [theta, theta], "runs") == []


def test_all_parameters_may_be_on_their_bounds():
    model = find_model("linear_viscous")
    run = with_noise(simulate_experiment(model, model.defaults, 1), 10.0, 1)
    problem, _ = make_problem(model, [prepare_recording(run)], fixed={"offset": 0.0, "coil_lag": 0.0})
    theta = model.vector({"viscous": 0.0, "viscous_per_A": 0.0, "offset": 0.0, "coil_lag": 0.0})
    result = uncertainty(problem, theta)
    assert result.on_bound.all()
    assert np.isnan(result.lower).all()
    # The optimum of both is inside the bounds, not beyond them.
    assert (result.beyond == 0.0).all()


# ---------------------------------------------------------------------------------------------------------- warnings


def warnings_after_fit(problem, theta, *, seed_thetas=None, **options):
    theta, _ = fit_least_squares(problem, theta)
    return fit_warnings(problem, theta, uncertainty(problem, theta, **options), seed_thetas or [theta], "runs")


def warnings_for(model, runs, theta=None, **options):
    model = find_model(model)
    problem, _ = make_problem(model, [prepare_recording(run) for run in runs])
    return warnings_after_fit(problem, model.defaults if theta is None else theta, **options)


def simulate_with_held_currents(model, theta, lines, *, rate, seconds, current=LEVELS, seed=0):
    """Simulate a multisine while the current is held for 1 s at each level."""
    model = find_model(model)
    time = np.arange(int(rate * seconds)) / rate
    levels = np.random.default_rng(seed).choice(current, int(seconds) + 1).repeat(int(rate))[: len(time)]
    return simulate_run(model, theta, time, multisine(time, lines, np.zeros(len(lines))), levels)


def triangle(speeds, rate=500.0):
    """Return time and position of strokes of 20 mm, back and forth, at one constant speed after the other."""
    parts, times, start = [], [], 0.0
    for speed in speeds:
        period = 0.04 / speed
        time = np.arange(int(2 * period * rate)) / rate
        parts.append(0.01 * sawtooth(2 * np.pi * time / period, 0.5))
        times.append(start + time)
        start = times[-1][-1] + 1 / rate
    return np.concatenate(times), np.concatenate(parts)


def assert_warnings(warnings, *expected):
    """Require exactly these warnings, by their beginnings, in this order."""
    assert len(warnings) == len(expected), warnings
    for sentence, beginning in zip(warnings, expected, strict=True):
        assert re.match(beginning, sentence), sentence


@pytest.mark.parametrize("profile", [False, True])
def test_a_good_experiment_gives_no_warning(profile):
    """Offset and stiffness are 0 and their narrow intervals include it, which needs no warning."""
    model = find_model("modified_dahl")
    theta = model.vector({"offset": 0.0})
    runs = [with_noise(simulate_experiment(model, theta, seed), 20.0, seed) for seed in (1, 2)]
    assert_warnings(warnings_for("modified_dahl", runs, theta, profile=profile))


def test_a_yield_travel_passed_within_a_sample_is_not_identifiable():
    model = find_model("bouc_wen")

    def warnings_at(rate):
        seconds = 1000 // rate
        runs = [
            simulate_with_held_currents("bouc_wen", model.defaults, [(2.5, 0.01)], rate=rate, seconds=seconds, seed=seed)
            for seed in (1, 2)
        ]
        return warnings_for("bouc_wen", [with_noise(run, 20.0, seed) for seed, run in enumerate(runs, 1)])

    assert_warnings(
        warnings_at(25),
        r"yield_travel is not identifiable from these runs: 90 % .* reversals of the rod; sample faster",
        r"shape is on its upper bound, 1\.5\. It is hardly determined: .* every value from the bound to 0\.5",
    )
    assert not any("not identifiable" in sentence for sentence in warnings_at(250))


def test_a_lag_that_shows_in_few_samples_is_not_attributed_to_reversals():
    """The current is switched once."""
    model = find_model("linear_viscous")
    theta = model.vector({"coil_lag": 0.02})
    time = np.arange(2000) / 100.0
    current = np.where(time < 8.13, 0.2, 0.6)
    run = with_noise(simulate_run(model, theta, time, multisine(time, LINES, np.zeros(4)), current), 30.0, 3)
    assert_warnings(
        warnings_for("linear_viscous", [run], theta),
        r"coil_lag is not identifiable from these runs: 90 % .* is in \d+ samples only",
    )


def test_a_single_current_gives_two_warnings():
    exact = simulate_with_held_currents(
        "bouc_wen", find_model("bouc_wen").defaults, LINES, rate=250, seconds=10, current=(0.3,)
    )
    run, unseen = (with_noise(exact, 20.0, seed) for seed in (1, 2))
    fit = identify([run], "bouc_wen", held_out=[unseen], population=16, generations=8, seeds=1)
    assert_warnings(
        fit.warnings, "coil_lag is fixed at 0: the current never changes", "The slopes over current are fixed at 0: all runs"
    )


def test_two_confounded_parameters_are_named_as_a_pair():
    """At two nearly equal speeds only the sum of yield force and viscous force is determined."""
    model = find_model("bingham")
    time, position = triangle((0.02, 0.022))
    zero = np.zeros_like(time)
    recording = prepare_recording(Run("triangle", time, position, np.gradient(position, time), zero + 0.3, zero))
    force = model.force(model.defaults, recording.path)
    run = with_noise(replace(recording.run, force=force), 100.0, 0)
    problem, _ = make_problem(model, [with_force(recording, run.force)], fixed={"creep_speed": 2e-3})
    assert_warnings(
        warnings_after_fit(problem, model.defaults),
        "viscous may be 0: the runs are fitted equally well by every value from 0 to 3.* N s/m",
        r"yield_force and viscous change the force in nearly the same way \(correlation -0\.99\d\), .*; fix one of them",
    )


def test_correlated_parameters_with_narrow_intervals_give_no_warning():
    """A rate that almost vanishes at 1 A is correlated with its slope, but both are known to a few percent."""
    model = find_model("normalised_bouc_wen")
    theta = true_parameters(model)
    runs = [with_noise(simulate_experiment(model, theta, seed), 20.0, seed) for seed in (1, 2)]
    problem, _ = make_problem(model, [prepare_recording(run) for run in runs])
    fitted, _ = fit_least_squares(problem, theta)
    result = uncertainty(problem, fitted, profile=False)
    names = [parameter.name for parameter in problem.parameters]
    assert abs(result.correlation[names.index("rho"), names.index("rho_per_A")]) > 0.98
    assert_warnings(fit_warnings(problem, fitted, result, [fitted], "runs"))


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        (300.0, r"\. The best fit lies outside this bound; the parameter may compensate for missing physics$"),
        (0.0, r"; the runs are fitted equally well by every value from the bound to \d.* N s/m$"),
    ],
)
def test_an_optimum_outside_a_bound_is_reported(missing, expected):
    """``missing`` is a negative viscosity, which the bound excludes."""
    model = find_model("bingham")
    theta = model.vector({"viscous": 0.0})
    runs = [simulate_experiment(model, theta, seed) for seed in (1, 2)]
    runs = [with_noise(replace(run, force=run.force - missing * run.velocity), 20.0, 9) for run in runs]
    assert_warnings(warnings_for("bingham", runs, theta), r"viscous is on its lower bound, 0 N s/m" + expected)


def test_an_interval_that_reaches_to_a_bound_is_reported():
    model = find_model("modified_dahl")
    theta = model.vector({"series_stiffness": 1e7})
    runs = [
        with_noise(simulate_with_held_currents("modified_dahl", theta, [(2.5, 8e-3)], rate=25, seconds=10, seed=s), 50.0, s)
        for s in (1, 2)
    ]
    assert_warnings(
        warnings_for("modified_dahl", runs, theta),
        r"The runs limit series_stiffness on one side only: .* from \S+ MN/m to its upper bound, 20 MN/m",
    )


def test_a_parameter_without_effect_on_the_force_is_reported():
    """At 0 A the yield force is 0, so the steepness of its curve has no effect."""
    model = find_model("algebraic")
    theta = model.vector({"yield_force": 0.0})
    run = with_noise(simulate_with_held_currents("algebraic", theta, LINES, rate=100, seconds=10, current=(0.0,)), 20.0, 1)
    problem, _ = make_problem(model, [prepare_recording(run)], fixed={"yield_force": 0.0})
    warnings = fit_warnings(problem, problem.base, uncertainty(problem, problem.base), [problem.base], "runs")
    none = " is not identifiable from these runs: it does not change the modelled force at all"
    assert_warnings(warnings, "steepness" + none, "position_weight" + none)


def test_searches_that_ended_in_a_worse_optimum_are_counted():
    model = find_model("bingham")
    runs = [with_noise(simulate_experiment(model, model.defaults, seed), 20.0, seed) for seed in (1, 2)]
    elsewhere = model.vector({"viscous": 3000.0})
    best = model.defaults
    assert_warnings(
        warnings_for("bingham", runs, seed_thetas=[best, elsewhere, best]),
        "1 of 3 searches from different seeds ended in a worse local optimum",
    )
    # The objectives of two nearly exact fits have a large ratio, which does not matter.
    exact, _ = make_problem(model, [prepare_recording(with_noise(simulate_experiment(model, best, 1), 3e-4, 3))])
    near = best * (1 + 1e-6)
    assert exact.cost(near) > 1.02 * exact.cost(best)
    warnings = fit_warnings(exact, best, uncertainty(exact, best), [best, near], "runs")
    assert not any("worse local optimum" in warning for warning in warnings)


def test_too_short_a_run_has_no_intervals_and_a_warning():
    model = find_model("bingham")
    run = simulate_experiment(model, model.defaults, 1, seconds=1.5)
    slow = replace(run, force=run.force + 30 * np.sin(4 * run.time))
    fit = identify([slow], "bingham", population=16, generations=8, seeds=1)
    assert all(np.isnan(estimate.lower) for estimate in fit.estimates)
    expected = r"There are no confidence intervals: .* only \d+ independent segments, and [67] parameters need 1[12];"
    assert any(re.match(expected, warning) for warning in fit.warnings)
