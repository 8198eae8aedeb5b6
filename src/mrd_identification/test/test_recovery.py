"""Statistics of identification: known parameters are found again, intervals hold them, warnings come when they should."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter, sawtooth

from mrd_identification import identify
from mrd_identification.fit_warnings import cautions
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import Problem, Recording, make_problem, prepare_recording
from mrd_identification.residual_correlation import correlation_length
from mrd_identification.uncertainty import uncertainty
from mrd_runs import Run
from mrd_sim.models import MODELS, find_model
from mrd_sim.path import make_path

LEVELS = (0.0, 0.1, 0.25, 0.4, 0.6, 0.8, 1.0)  # A
LINES = ((0.5, 6e-3), (1.5, 4e-3), (4.0, 3e-3), (7.0, 2e-3))  # Hz, m: up to 15 mm and 0.22 m/s


def run_of(model, theta, time, motion, current, name="run"):
    """What a damper would give, from its exact motion; identification sees the position only."""
    position, velocity, acceleration = motion
    force = model.force(theta, make_path(time, position, velocity, acceleration, current))
    return Run(name, time, position, velocity, current, force)


def sines(time, lines, phases):
    w, amplitude = 2 * np.pi * np.array([f for f, _ in lines]), np.array([a for _, a in lines])
    angle = np.outer(time, w) + phases
    return np.sin(angle) @ amplitude, np.cos(angle) @ (amplitude * w), -np.sin(angle) @ (amplitude * w**2)


def experiment(model, theta, seed, seconds=5.0, rate=500.0):
    """A multisine while the current is switched at random, from 0 to 1 A."""
    random = np.random.default_rng(seed)
    time = np.arange(int(rate * seconds)) / rate
    motion = sines(time, LINES, random.uniform(0, 2 * np.pi, len(LINES)))
    hold = int(0.15 * rate)
    current = np.repeat(random.choice(LEVELS, len(time) // hold + 1), hold)[: len(time)]
    return run_of(model, theta, time, motion, current, f"run{seed}")


def searched(model):
    free = tuple(index for index, parameter in enumerate(model.parameters) if parameter.free)
    return Problem(model, [], free, model.defaults)


def truth(model, seed=0):
    """Parameters up to a quarter of the way from the defaults to a bound, none that a floor cuts off at some current."""
    random = np.random.default_rng(seed)
    problem = searched(model)
    start = problem.unit(model.defaults)
    for _ in range(1000):
        side = np.where(start < 0.02, 1, np.where(start > 0.98, 0, random.integers(0, 2, len(start))))
        theta = problem.theta(start + random.uniform(0.08, 0.25, len(start)) * (side - start))
        if all(
            model.at_current(theta, current)[quantity.name] > 1.2 * quantity.lower
            for quantity in model.quantities
            if quantity.per_ampere and not quantity.multiplies and quantity.law != "constant"
            for current in LEVELS
        ):
            return theta
    raise AssertionError(f"{model.id}: no parameters above the floors")


def noisy(run, deviation, seed):
    return replace(run, force=run.force + deviation * np.random.default_rng(seed).standard_normal(len(run)))


# ---------------------------------------------------------------------------------------------------------- recovery


@pytest.mark.parametrize("name", MODELS)
def test_known_parameters_are_recovered_without_noise(name):
    model = MODELS[name]
    theta = truth(model)
    runs = [experiment(model, theta, seed) for seed in (1, 2)]
    fit = identify(runs[:1], name, held_out=runs[1:], seeds=1, profile=False)
    assert fit.pooled_fitted.nrmse < 1e-4
    assert fit.pooled_held_out.nrmse < 1e-4
    # No parameter of any model is redundant: every one comes back.
    assert fit.theta == pytest.approx(theta, rel=0.01)
    assert fit.warnings == ()


@pytest.mark.parametrize("name", MODELS)
def test_known_parameters_are_recovered_with_noise(name):
    model = MODELS[name]
    theta = truth(model, seed=1)
    runs = [experiment(model, theta, seed) for seed in (3, 4)]
    seed = list(MODELS).index(name)
    runs = [noisy(run, 0.02 * np.std(run.force), 10 * seed + place) for place, run in enumerate(runs)]
    fit = identify(runs, name, held_out=runs[:1], seeds=1, profile=False)
    assert fit.pooled_fitted.nrmse == pytest.approx(0.02, rel=0.05)
    found = [(e, true) for e, true in zip(fit.estimates, theta, strict=True) if not e.fixed]
    assert sum(e.on_bound for e, _ in found) <= 1
    for estimate, true in found:
        if not estimate.on_bound:
            deviation = (estimate.upper - estimate.lower) / 3.92
            assert abs(estimate.value - true) < 4.5 * deviation, estimate.parameter.name
            assert deviation < 0.05 * (estimate.parameter.upper - estimate.parameter.lower), estimate.parameter.name


@pytest.mark.parametrize(("name", "seed"), [("sigmoid", 5), ("modified_bouc_wen", 3)])
def test_the_search_finds_the_optimum_that_least_squares_alone_misses(name, seed):
    model = MODELS[name]
    problem = searched(model)
    theta = problem.theta(np.random.default_rng(seed).uniform(0.1, 0.9, len(problem.free)))
    run = experiment(model, theta, 1, seconds=3.0, rate=250.0)
    posed, _ = make_problem(model, [prepare_recording(run)])
    _, cost = fit_least_squares(posed, posed.project(model.defaults[None])[0][0])
    assert np.sqrt(2 * cost / len(posed.force)) > 0.05 * np.std(posed.force)
    fit = identify([run], name, profile=False)
    assert fit.pooled_fitted.nrmse < 1e-4
    assert fit.theta == pytest.approx(theta, rel=0.01)


@pytest.mark.parametrize("loss", ["linear", "huber", "soft_l1"])
def test_least_squares_agree_with_scipy_also_on_bounds(loss):
    model = find_model("bouc_wen")
    run = experiment(model, model.vector({"viscous": 0.0, "viscous_per_A": 500.0}), 1, seconds=2.0)
    run = noisy(replace(run, force=run.force - 200.0 * run.velocity), 30.0, 1)
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


def autoregressive(random, count, tau):
    """Unit noise whose correlation decays as exp(-t / tau), tau in samples."""
    a = np.exp(-1.0 / tau)
    return lfilter([np.sqrt(1 - a * a)], [1, -a], random.standard_normal(count + int(20 * tau)))[-count:]


def coverage(name, errors, *, seconds, rate, share=0.02, repeats=200, profile=False):
    """Whether 95 % intervals hold the truth, (repeats, free), nan where there is none; each repeat starts at the truth."""
    model = MODELS[name]
    theta = truth(model)
    recordings = [prepare_recording(experiment(model, theta, seed, seconds, rate)) for seed in (1, 2)]
    forces = [model.force(theta, recording.path) for recording in recordings]
    deviation = share * np.std(np.concatenate(forces))
    random = np.random.default_rng(list(MODELS).index(name))
    holds = []
    for _ in range(repeats):
        spoilt = [
            replace(recording, run=replace(recording.run, force=force + deviation * errors(random, len(force))))
            for recording, force in zip(recordings, forces, strict=True)
        ]
        problem, _ = make_problem(model, spoilt)
        estimate, _ = fit_least_squares(problem, theta)
        found = uncertainty(problem, estimate, profile=profile)
        lower, upper = (found.profile_lower, found.profile_upper) if profile else (found.lower, found.upper)
        true = theta[list(problem.free)]
        holds.append(np.where(np.isnan(lower), np.nan, (lower <= true) & (true <= upper)))
    return np.array(holds)


def assert_covers(holds):
    assert np.isnan(holds).mean() < 0.1
    each = np.nanmean(holds, axis=0)
    assert 0.90 <= np.nanmean(holds) <= 0.99, each
    assert each.min() >= 0.86, each


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", MODELS)
def test_intervals_cover_the_truth_with_white_errors(name):
    assert_covers(coverage(name, lambda random, count: random.standard_normal(count), seconds=4.0, rate=250.0))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["bingham", "bouc_wen"])
def test_intervals_cover_the_truth_with_errors_that_last(name):
    """0.1 s at 100 Hz."""
    assert_covers(coverage(name, lambda random, count: autoregressive(random, count, 10.0), seconds=30.0, rate=100.0))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["bingham", "bouc_wen"])
def test_intervals_cover_the_truth_with_slow_errors_under_fast_ones(name):
    """A twelfth of the variance lasts 0.3 s; it is what an offset and a stiffness are unsure of."""

    def errors(random, count):
        return np.sqrt(0.92) * random.standard_normal(count) + np.sqrt(0.08) * autoregressive(random, count, 30.0)

    assert_covers(coverage(name, errors, seconds=40.0, rate=100.0))


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["sigmoid", "modified_lugre"])
def test_profiles_cover_the_truth(name):
    """With so much noise that the objective is no parabola, and some profiles end on a bound."""
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
        residuals += np.sqrt(share) * autoregressive(random, len(residuals), tau)
    assert least <= correlation_length(residuals) <= most


def test_correlation_length_of_no_residual_is_one_sample():
    assert correlation_length(np.zeros(100)) == 1
    assert correlation_length(np.ones(1)) == 1


@pytest.fixture(scope="module")
def bent():
    """A sigmoid that two sines say little of: the objective is no parabola."""
    model = find_model("sigmoid")
    time = np.arange(2000) / 200.0
    runs = [
        noisy(run_of(model, model.defaults, time, sines(time, [(f, 8e-3)], 0.0), np.full(2000, 0.3)), 30.0, int(10 * f))
        for f in (0.7, 2.0)
    ]
    problem, _ = make_problem(model, [prepare_recording(run) for run in runs])
    theta, _ = fit_least_squares(problem, model.defaults)
    return problem, theta, uncertainty(problem, theta)


def test_profile_ends_where_the_refitted_objective_has_risen(bent):
    """With all others fitted anew the objective is equally high at both ends, although one is farther than the other."""
    problem, theta, found = bent
    best = problem.cost(theta)
    place = [parameter.name for parameter in problem.parameters].index("steepness")
    index = problem.free[place]
    rises = []
    for end in (found.profile_lower[place], found.profile_upper[place]):
        start = theta.copy()
        start[index] = end
        posed, _ = make_problem(problem.model, problem.recordings, fixed={"steepness": float(end)})
        rises.append(fit_least_squares(posed, start)[1] - best)
    assert rises[0] == pytest.approx(rises[1], rel=0.25)
    lower, upper = (np.log(end[place] / theta[index]) for end in (found.profile_lower, found.profile_upper))
    assert abs(-lower / upper - 1.0) > 0.3


def test_profile_of_a_straight_model_is_the_covariance_interval_and_costs_two_evaluations_each(monkeypatch):
    model = find_model("polynomial")
    theta = truth(model)
    run = noisy(experiment(model, theta, 1), 5.0, 0)
    problem, _ = make_problem(model, [prepare_recording(run)])
    theta, _ = fit_least_squares(problem, theta)
    counted = []
    evaluate = Problem.cost
    monkeypatch.setattr(Problem, "cost", lambda self, theta: counted.append(1) or evaluate(self, theta))
    found = uncertainty(problem, theta)
    assert found.profile_lower == pytest.approx(found.lower)
    assert found.profile_upper == pytest.approx(found.upper)
    assert len(counted) <= 1 + 2 * len(problem.free)


def test_a_parameter_on_a_bound_has_a_profile_inside():
    """The fluid has no viscosity: an estimate at 0 leaves the question how much there may be."""
    model = find_model("linear_viscous")
    theta = model.vector({"viscous": 0.0, "viscous_per_A": 0.0, "offset": 0.0})
    time = np.arange(1000) / 200.0
    still = noisy(run_of(model, theta, time, sines(time, LINES, np.zeros(4)), np.zeros(1000)), 10.0, 2)
    problem, _ = make_problem(model, [prepare_recording(still)])
    fitted, _ = fit_least_squares(problem, theta)
    found = uncertainty(problem, fitted)
    speed = np.std(problem.recordings[0].path.velocity)
    assert found.on_bound[0]
    assert found.profile_lower[0] == 0.0
    assert found.profile_upper[0] == pytest.approx(1.96 * 10.0 / speed / np.sqrt(len(problem.force)), rel=0.2)
    assert 0.0 < found.beyond[0] < 1.0


def with_force(recording: Recording, force: np.ndarray) -> Recording:
    run = replace(recording.run, force=force)
    return replace(recording, smoothed=replace(recording.smoothed, run=run))


def test_there_are_no_intervals_without_errors_but_also_no_nonsense():
    """The force is the model's own, to the last digit."""
    for name in ("bingham", "modified_bouc_wen"):
        model = find_model(name)
        theta = truth(model)
        recording = prepare_recording(experiment(model, theta, 1))
        exact = with_force(recording, model.force(theta, recording.path))
        problem, _ = make_problem(model, [exact])
        found = uncertainty(problem, theta)
        for ends in (found.lower, found.upper, found.profile_lower, found.profile_upper):
            assert ends == pytest.approx(theta[list(problem.free)], rel=1e-6)
        assert np.isfinite(found.correlation).all()
        assert cautions(problem, theta, found, [theta, theta], "runs") == []


def test_everything_on_bounds_is_no_crash():
    model = find_model("linear_viscous")
    run = noisy(experiment(model, model.defaults, 1), 10.0, 1)
    problem, _ = make_problem(model, [prepare_recording(run)], fixed={"offset": 0.0, "coil_lag": 0.0})
    theta = model.vector({"viscous": 0.0, "viscous_per_A": 0.0, "offset": 0.0, "coil_lag": 0.0})
    found = uncertainty(problem, theta)
    assert found.on_bound.all()
    assert np.isnan(found.lower).all()
    # Their bound is where the objective is highest: the data want more of both.
    assert (found.beyond == 0.0).all()


# ---------------------------------------------------------------------------------------------------------- cautions


def warned(problem, theta, *, seeds=None, **options):
    theta, _ = fit_least_squares(problem, theta)
    return cautions(problem, theta, uncertainty(problem, theta, **options), seeds or [theta], "runs")


def said_of(model, runs, theta=None, **options):
    model = find_model(model)
    problem, _ = make_problem(model, [prepare_recording(run) for run in runs])
    return warned(problem, model.defaults if theta is None else theta, **options)


def held(model, theta, lines, *, rate, seconds, current=LEVELS, seed=0):
    """Sines, the current held for 1 s at a time."""
    model = find_model(model)
    time = np.arange(int(rate * seconds)) / rate
    held = np.random.default_rng(seed).choice(current, int(seconds) + 1).repeat(int(rate))[: len(time)]
    return run_of(model, theta, time, sines(time, lines, np.zeros(len(lines))), held)


def triangle(speeds, rate=500.0):
    """Back and forth over 20 mm at constant speeds, one after the other."""
    parts, times, start = [], [], 0.0
    for speed in speeds:
        period = 0.04 / speed
        time = np.arange(int(2 * period * rate)) / rate
        parts.append(0.01 * sawtooth(2 * np.pi * time / period, 0.5))
        times.append(start + time)
        start = times[-1][-1] + 1 / rate
    return np.concatenate(times), np.concatenate(parts)


def assert_says(said, *expected):
    """Just these sentences, in this order."""
    assert len(said) == len(expected), said
    for sentence, beginning in zip(said, expected, strict=True):
        assert re.match(beginning, sentence), sentence


@pytest.mark.parametrize("profile", [False, True])
def test_nothing_is_said_of_a_good_experiment(profile):
    """Offset and stiffness are 0, and their intervals hold it: that is no fault of the experiment."""
    model = find_model("modified_dahl")
    theta = model.vector({"offset": 0.0})
    runs = [noisy(experiment(model, theta, seed), 20.0, seed) for seed in (1, 2)]
    assert_says(said_of("modified_dahl", runs, theta, profile=profile))


def test_a_yield_travel_passed_within_a_sample_is_not_identifiable():
    model = find_model("bouc_wen")

    def said(rate):
        seconds = 1000 // rate
        runs = [held("bouc_wen", model.defaults, [(2.5, 0.01)], rate=rate, seconds=seconds, seed=seed) for seed in (1, 2)]
        return said_of("bouc_wen", [noisy(run, 20.0, seed) for seed, run in enumerate(runs, 1)])

    assert_says(
        said(25),
        r"yield_travel is not identifiable from these runs: nine tenths .* reverses; sample faster",
        r"shape ended on its upper bound, 1\.5, but the runs say next to nothing of it: they fit as well with 0\.5",
    )
    assert not any("not identifiable" in sentence for sentence in said(250))


def test_a_lag_seen_in_few_samples_is_not_blamed_on_reversals():
    """The current is switched once."""
    model = find_model("linear_viscous")
    theta = model.vector({"coil_lag": 0.02})
    time = np.arange(2000) / 100.0
    current = np.where(time < 8.13, 0.2, 0.6)
    run = noisy(run_of(model, theta, time, sines(time, LINES, np.zeros(4)), current), 30.0, 3)
    assert_says(
        said_of("linear_viscous", [run], theta),
        r"coil_lag is not identifiable from these runs: nine tenths .* fall on \d+ samples only",
    )


def test_a_single_current_is_said_once_and_for_all():
    run = noisy(held("bouc_wen", find_model("bouc_wen").defaults, LINES, rate=250, seconds=10, current=(0.3,)), 20.0, 1)
    fit = identify([run], "bouc_wen", held_out=[run], population=16, generations=8, seeds=1)
    assert_says(fit.warnings, "coil_lag is fixed: the current never changes", "slopes over current are fixed at 0: all runs")


def test_two_parameters_that_go_together_are_named_as_a_pair():
    """Two nearly equal speeds: friction and viscosity add up."""
    model = find_model("bingham")
    time, position = triangle((0.02, 0.022))
    still = np.zeros_like(time)
    recording = prepare_recording(Run("triangle", time, position, np.gradient(position, time), still + 0.3, still))
    force = model.force(model.defaults, recording.path)
    run = noisy(replace(recording.run, force=force), 100.0, 0)
    problem, _ = make_problem(model, [with_force(recording, run.force)], fixed={"creep_speed": 2e-3})
    assert_says(
        warned(problem, model.defaults),
        "viscous cannot be told from 0: the runs fit as well with anything from 0 to 3.* N s/m",
        r"yield_force and viscous cannot be told apart well: correlation -0\.99\d; fix one of them",
    )


def test_correlated_parameters_that_are_known_well_are_no_worry():
    """A rate that almost vanishes at 1 A goes with its slope, and both are known to a few percent."""
    model = find_model("normalised_bouc_wen")
    theta = truth(model)
    runs = [noisy(experiment(model, theta, seed), 20.0, seed) for seed in (1, 2)]
    problem, _ = make_problem(model, [prepare_recording(run) for run in runs])
    fitted, _ = fit_least_squares(problem, theta)
    found = uncertainty(problem, fitted, profile=False)
    names = [parameter.name for parameter in problem.parameters]
    assert abs(found.correlation[names.index("rho"), names.index("rho_per_A")]) > 0.98
    assert_says(cautions(problem, fitted, found, [fitted], "runs"))


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        (300.0, "; the runs want a value beyond it, so it stands in for something that the model lacks"),
        (0.0, r"; the runs fit as well with anything from there to \d.* N s/m$"),
    ],
)
def test_a_bound_is_said_to_be_wanted_beyond_or_not(missing, expected):
    """``missing`` is a viscosity below 0, which the bound forbids."""
    model = find_model("bingham")
    theta = model.vector({"viscous": 0.0})
    runs = [experiment(model, theta, seed) for seed in (1, 2)]
    runs = [noisy(replace(run, force=run.force - missing * run.velocity), 20.0, 9) for run in runs]
    assert_says(said_of("bingham", runs, theta), r"viscous ended on its lower bound, 0 N s/m" + expected)


def test_an_open_end_is_said():
    model = find_model("modified_dahl")
    theta = model.vector({"series_stiffness": 1e7})
    runs = [noisy(held("modified_dahl", theta, [(2.5, 8e-3)], rate=25, seconds=10, seed=s), 50.0, s) for s in (1, 2)]
    assert_says(
        said_of("modified_dahl", runs, theta),
        r"series_stiffness is bounded on one side only: .* from \S+ N/m to its upper bound, 2e\+07 N/m",
    )


def test_what_has_no_effect_is_said_to_have_none():
    """Without field there is no steepness: the curve's height is 0 at 0 A."""
    model = find_model("algebraic")
    theta = model.vector({"yield_force": 0.0})
    run = noisy(held("algebraic", theta, LINES, rate=100, seconds=10, current=(0.0,)), 20.0, 1)
    problem, _ = make_problem(model, [prepare_recording(run)], fixed={"yield_force": 0.0})
    said = cautions(problem, problem.base, uncertainty(problem, problem.base), [problem.base], "runs")
    none = " is not identifiable from these runs: it does not change the modelled force at all"
    assert_says(said, "steepness" + none, "position_weight" + none)


def test_seeds_that_disagree_are_counted():
    model = find_model("bingham")
    runs = [noisy(experiment(model, model.defaults, seed), 20.0, seed) for seed in (1, 2)]
    elsewhere = model.vector({"viscous": 3000.0})
    best = model.defaults
    said = said_of("bingham", runs, seeds=[best, elsewhere, best])
    assert_says(said, "1 of 3 seeds of the search ended in another, worse optimum")
    # Of fits without error one is always much worse than another, and it does not matter.
    exact, _ = make_problem(model, [prepare_recording(experiment(model, best, 1))])
    near = best * (1 + 1e-6)
    assert exact.cost(near) > 1.02 * exact.cost(best)
    assert_says(cautions(exact, best, uncertainty(exact, best), [best, near], "runs"))


def test_too_short_a_run_has_no_intervals_and_says_so():
    model = find_model("bingham")
    run = experiment(model, model.defaults, 1, seconds=1.5)
    slow = replace(run, force=run.force + 30 * np.sin(4 * run.time))
    fit = identify([slow], "bingham", population=16, generations=8, seeds=1)
    assert all(np.isnan(estimate.lower) for estimate in fit.estimates)
    assert any(re.match(r"no intervals: .* hold \d+ independent stretches, 1[12] are needed", said) for said in fit.warnings)
