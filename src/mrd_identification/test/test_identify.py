"""Identification recovers known parameters with intervals, and measures its error on runs that were not fitted."""

import datetime
import json
import re
from dataclasses import replace
from functools import cache
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_base.json_file import make_folder
from mrd_base.quantities import per_cent, quantity
from mrd_base.version import VERSION
from mrd_identification import figures, identify, load_damper, metrics, read_fit, write_fit
from mrd_identification.fit_warnings import _too_few_segments
from mrd_identification.low_pass import with_force_filter
from mrd_identification.nsga2 import find_knee
from mrd_identification.problem import make_problem
from mrd_identification.recording import consecutive_modelled_forces, prepare_recording
from mrd_identification.report import MOST_RUNS, next_command, write_report
from mrd_identification.uncertainty import Uncertainty
from mrd_runs import Run
from mrd_sim.lead_in import resting_lead_in
from mrd_sim.models import find_model
from mrd_sim.path import make_path

RATE = 500.0
BRIEF = {"population": 16, "generations": 8, "seeds": 1, "profile": False}
"""A search that is long enough where least squares find the rest."""


def simulate(model, values, *, seconds=6.0, seed=0, noise=0.0, current=None, name=None):
    """Simulate a run of a model: a multisine while the current is switched at random, or at one current."""
    random = np.random.default_rng(seed)
    time = np.arange(int(RATE * seconds)) / RATE
    position = np.zeros_like(time)
    velocity, acceleration = position.copy(), position.copy()
    for frequency, amplitude in ((0.5, 9e-3), (1.5, 4e-3), (3.5, 1.2e-3), (5.5, 0.5e-3)):
        w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
        position += amplitude * np.sin(w * time + phase)
        velocity += amplitude * w * np.cos(w * time + phase)
        acceleration -= amplitude * w**2 * np.sin(w * time + phase)
    if current is None:
        current = np.repeat(random.choice([0.0, 0.1, 0.2, 0.3, 0.4], len(time) // 50 + 1), 50)[: len(time)]
    else:
        current = np.full(len(time), current)
    damper = find_model(model)
    force = damper.force(damper.vector(values), make_path(time, position, velocity, acceleration, current))
    force = force + noise * random.standard_normal(len(time))
    return Run(name or f"run{seed}", time, position, velocity, current, force)


TRUTH = {
    "yield_force": 70.0,
    "yield_force_per_A": 950.0,
    "yield_travel": 2e-4,
    "shape": 0.75,
    "viscous": 1100.0,
    "viscous_per_A": 2200.0,
    "stiffness": 1800.0,
    "offset": -45.0,
    "coil_lag": 0.006,
}


@pytest.fixture(scope="module")
def bouc_wen_fit():
    runs = [simulate("bouc_wen", TRUTH, seed=seed, noise=0.5) for seed in (1, 2)]
    return identify(
        runs, "bouc_wen", held_out=[simulate("bouc_wen", TRUTH, seed=3, noise=0.5)], population=40, generations=25, seed=4
    )


def test_bouc_wen_is_recovered(bouc_wen_fit):
    for name, value in TRUTH.items():
        assert bouc_wen_fit.values[name] == pytest.approx(value, rel=0.03), name
    assert bouc_wen_fit.pooled_held_out.nrmse < 0.005
    assert bouc_wen_fit.held_out_by == "runs"


def test_intervals_are_narrow_and_near_the_truth(bouc_wen_fit):
    free = [e for e in bouc_wen_fit.estimates if not e.fixed]
    assert len(free) >= 9
    for estimate in free:
        if estimate.parameter.name not in TRUTH:
            continue
        width = estimate.upper - estimate.lower
        assert 0 < width < 0.2 * abs(estimate.value), estimate.parameter.name
        # The only error is noise, so the truth lies within a few widths.
        assert abs(estimate.value - TRUTH[estimate.parameter.name]) < 2 * width, estimate.parameter.name


def test_front_is_sorted_and_non_dominated(bouc_wen_fit):
    norms = bouc_wen_fit.front.norms
    assert np.all(np.diff(norms[:, 0]) >= 0)
    assert np.all(np.diff(norms[:, 1]) <= 0)
    assert bouc_wen_fit.pooled_fitted.e2 <= norms[0, 0] * 1.0001


def test_same_seed_same_result():
    run = simulate("bingham", {"offset": 20.0}, seed=5, noise=1.0, seconds=3)
    first, second = (identify([run], "bingham", population=16, generations=5, seed=9, seeds=2) for _ in range(2))
    assert np.array_equal(first.theta, second.theta)
    assert np.array_equal(first.front.norms, second.front.norms)


def test_without_least_squares_the_knee_is_the_result():
    run = simulate("bingham", {}, seconds=3, noise=1.0)
    fit = identify([run], "bingham", population=16, generations=8, seed=2, least_squares=False)
    assert np.array_equal(fit.theta, fit.front.thetas[fit.front.knee])
    assert all(np.isnan(estimate.lower) for estimate in fit.estimates)
    assert any(warning.startswith("There are no confidence intervals: without least squares") for warning in fit.warnings)


def free_parameters(model, runs, **options):
    """Return the names of the free parameters, and the notes about those that the runs cannot determine."""
    problem, notes = make_problem(find_model(model), [prepare_recording(run) for run in runs], **options)
    return [parameter.name for parameter in problem.parameters], notes


def test_parameters_that_the_runs_cannot_determine_are_fixed_with_a_note():
    names, notes = free_parameters("bouc_wen", [simulate("bouc_wen", {}, seed=seed, current=0.3) for seed in (1, 2)])
    assert "coil_lag" not in names
    assert "yield_force_per_A" not in names
    assert len(notes) == 2
    names, notes = free_parameters(
        "bouc_wen", [simulate("bouc_wen", {}, current=0.1), simulate("bouc_wen", {}, current=0.3)]
    )
    assert "coil_lag" not in names
    assert "yield_force_per_A" in names


def test_two_currents_determine_straight_current_laws_only():
    runs = [simulate("bingham", {}, current=level) for level in (0.1, 0.3)]
    recordings = [prepare_recording(run) for run in runs]
    problem, notes = make_problem(find_model("bingham", "tanh"), recordings)
    assert not any(p.name.endswith("_saturation") for p in problem.parameters)
    assert any("cannot determine a curvature" in note for note in notes)
    third = prepare_recording(simulate("bingham", {}, current=0.2))
    problem, _ = make_problem(find_model("bingham", "tanh"), [*recordings, third])
    assert any(p.name.endswith("_saturation") for p in problem.parameters)


def test_parameters_can_be_fixed_and_freed():
    run = simulate("bouc_wen", {}, seconds=2)
    names, _ = free_parameters("bouc_wen", [run], fixed={"offset": 12.0}, freed=["exponent"])
    assert "offset" not in names
    assert "exponent" in names
    with pytest.raises(InputError, match="unknown parameter nosuch"):
        free_parameters("bouc_wen", [run], freed=["nosuch"])
    with pytest.raises(InputError, match=r"offset is 1e.06 N, expected -5e.05 to 5e.05"):
        free_parameters("bouc_wen", [run], fixed={"offset": 1e6})
    model = find_model("linear_viscous")
    with pytest.raises(InputError, match="every parameter is fixed"):
        free_parameters("linear_viscous", [run], fixed=dict(zip(model.names, model.defaults, strict=True)))


def test_unit_box_round_trip():
    problem, _ = make_problem(find_model("modified_bouc_wen"), [prepare_recording(simulate("modified_bouc_wen", {}))])
    unit = np.random.default_rng(0).random((5, len(problem.free)))
    assert np.allclose([problem.unit(theta) for theta in problem.theta(unit)], unit)


@cache
def weighted_recordings(noise):
    return [
        prepare_recording(simulate("bouc_wen", TRUTH, noise=noise, seed=seed), weight)
        for seed, weight in ((1, 0.5), (2, 2.0))
    ]


@pytest.mark.parametrize("offsets", [False, True])
def test_jacobian_matches_central_differences(offsets):
    model = find_model("bouc_wen", "tanh")
    recordings = weighted_recordings(1.0)
    problem, _ = make_problem(model, recordings, offsets=offsets)
    unit = problem.unit(model.vector(TRUTH))
    jacobian = problem.jacobian(unit)
    for column in range(len(problem.free)):
        step = np.zeros(len(unit))
        step[column] = 1e-6
        central = (problem.residuals(problem.theta(unit + step)) - problem.residuals(problem.theta(unit - step))) / 2e-6
        assert np.linalg.norm(jacobian[:, column] - central) <= 1e-4 * np.linalg.norm(central)


@pytest.mark.parametrize("diverged", [np.nan, np.inf, 1e180])
def test_a_derivative_that_has_diverged_is_a_difference(diverged, monkeypatch):
    problem, _ = make_problem(find_model("bouc_wen"), weighted_recordings(1.0))
    unit = 0.6 * problem.unit(problem.model.vector(TRUTH)) + 0.2
    exact = problem.jacobian(unit)
    of_problem = type(problem).forces

    def forces(self, theta):
        force = of_problem(self, theta)
        if force.ndim > 1:
            force[100:, 2] = diverged  # the second derivative of a pass
        return force

    monkeypatch.setattr(type(problem), "forces", forces)
    np.testing.assert_allclose(problem.jacobian(unit), exact, rtol=1e-2, atol=1e-3 * np.abs(exact).max())


@pytest.fixture(scope="module")
def at_constant_currents():
    runs = [simulate("bouc_wen", TRUTH, seed=k, current=level) for k, level in enumerate((0.0, 0.3, 0.8))]
    return [prepare_recording(run) for run in runs]


@pytest.mark.parametrize("effect", ["", "series_compliance", "force_sensor_lag", "current_saturation", "thermal_fade"])
@pytest.mark.parametrize("model", ["bouc_wen", "shear_thinning_bouc_wen", "polynomial"])
def test_at_constant_currents_the_derivative_to_a_slope_is_the_same_whatever_else_is_asked_for(
    model, effect, at_constant_currents
):
    """It then follows from the one to the value, where it may: not where an effect changes the current or outlasts a run."""
    damper = find_model(model, "quadratic", [effect] if effect else [])
    problem, _ = make_problem(damper, at_constant_currents)
    unit = 0.8 * problem.unit(damper.defaults) + 0.2 * np.random.default_rng(1).random(len(problem.free))
    together = problem.jacobian(unit)
    alone = np.concatenate([problem.jacobian(unit, [place]) for place in range(len(unit))], axis=1)
    np.testing.assert_allclose(together, alone, rtol=1e-6, atol=1e-9 * np.abs(alone).max())


@pytest.mark.parametrize("offsets", [False, True])
@pytest.mark.parametrize("model", ["bouc_wen", "modified_bouc_wen", "polynomial"])
def test_projection_is_the_bounded_optimum_of_the_linear_parameters(model, offsets):
    """No change of a linear parameter within its bounds lowers the error, and the norms are those of the full model."""
    damper = find_model(model)
    recordings = weighted_recordings(3.0)
    problem, _ = make_problem(damper, recordings, offsets=offsets)
    thetas, norms = problem.project(problem.theta(np.random.default_rng(0).random((3, len(problem.free)))))
    assert np.allclose(norms, problem.norms(thetas), rtol=1e-6)
    for theta in thetas:
        gradient = problem.jacobian(problem.unit(theta)).T @ problem.residuals(theta)
        unit = problem.unit(theta)
        size = np.linalg.norm(problem.jacobian(unit), axis=0) * np.linalg.norm(problem.residuals(theta))
        for index in np.flatnonzero(problem.linear):
            slope = gradient[index] / size[index]
            assert abs(slope) < 1e-6 or (unit[index] < 1e-9 and slope > 0) or (unit[index] > 1 - 1e-9 and slope < 0)


def test_run_offsets_do_not_influence_the_fit_and_are_reported():
    runs = [simulate("bouc_wen", TRUTH, seed=seed) for seed in (1, 2, 3)]
    shifted = [
        Run(run.name, run.time, run.position, run.velocity, run.current, run.force + shift)
        for run, shift in zip(runs, (20.0, -30.0, 10.0), strict=True)
    ]
    fit = identify(shifted, "bouc_wen", seed=1, offsets=True, **BRIEF)
    assert fit.run_offsets == pytest.approx((20.0, -30.0, 10.0), abs=0.5)
    assert fit.values["yield_force"] == pytest.approx(TRUTH["yield_force"], rel=0.01)
    assert fit.values["offset"] == pytest.approx(TRUTH["offset"], abs=0.5)


def test_an_effect_is_identified_with_the_model(tmp_path):
    damper = find_model("bingham", None, ["moving_mass"])
    truth = damper.vector({"moving_mass.mass": 3.0, "viscous": 1500.0})
    runs = []
    for seed in (1, 2):
        run = simulate("bingham", {}, seed=seed)
        path = make_path(run.time, run.position, run.velocity, np.gradient(run.velocity, run.time), run.current)
        noise = np.random.default_rng(seed).standard_normal(len(run))
        force = damper.force(truth, path) + noise
        runs.append(Run(run.name, run.time, run.position, run.velocity, run.current, force))
    fit = identify(runs, "bingham", effects=["moving_mass"], **BRIEF)
    (mass,) = (e for e in fit.estimates if e.parameter.name == "moving_mass.mass")
    assert mass.lower < 3.0 < mass.upper
    assert mass.value == pytest.approx(3.0, rel=0.05)
    stored = read_fit(write_fit(fit, tmp_path))
    assert stored.effects == ["moving_mass"]
    damper = load_damper(tmp_path / "fit.json")
    assert damper.model.names == fit.model.names
    assert np.array_equal(damper.theta, fit.theta)
    with pytest.raises(InputError, match=r"unknown effect nosuch \(known: "):
        identify(runs, "bingham", effects=["nosuch"])


def test_a_run_begins_in_the_state_in_which_the_run_before_has_ended():
    damper = find_model("bingham", None, ["thermal_fade"])
    truth = damper.vector({"thermal_fade.fade": 2e-4, "viscous": 1500.0})
    without_heat = [simulate("bingham", {}, seed=seed) for seed in (1, 2, 3)]
    forces = consecutive_modelled_forces(damper, truth, [prepare_recording(run) for run in without_heat])
    runs = [replace(run, force=force) for run, force in zip(without_heat, forces, strict=True)]
    fit = identify(runs[:2], "bingham", effects=["thermal_fade"], held_out=runs[2:], **BRIEF)
    assert all(result.metrics.nrmse < 1e-3 for result in (*fit.fitted, *fit.held_out))


def test_outliers_hardly_change_a_fit_with_a_robust_loss():
    run = simulate("bingham", {"viscous": 1500.0}, seed=1, noise=1.0)
    random = np.random.default_rng(0)
    force = run.force + np.where(random.random(len(run)) < 0.02, 400.0, 0.0)
    outliers = Run("outliers", run.time, run.position, run.velocity, run.current, force)
    plain, robust = (identify([outliers], "bingham", loss=loss, **BRIEF) for loss in ("linear", "huber"))
    assert abs(robust.values["offset"]) < 0.3 < abs(plain.values["offset"])
    widths = [next(e.upper - e.lower for e in fit.estimates if e.parameter.name == "offset") for fit in (plain, robust)]
    assert widths[1] < 0.5 * widths[0]


def test_weights_decide_between_runs_with_different_parameters():
    runs = [
        simulate("linear_viscous", {"viscous": viscous}, seed=1, current=0.0, seconds=seconds)
        for viscous, seconds in ((2000.0, 2), (4000.0, 5))
    ]

    def viscous(weights):
        return identify(runs, "linear_viscous", weights=weights, **BRIEF).values["viscous"]

    assert viscous("force") < viscous("runs") < viscous("samples")
    assert viscous([1.0, 1e-6]) == pytest.approx(2000.0, rel=1e-3)
    with pytest.raises(InputError, match="expected 2 positive numbers"):
        viscous([1.0, -1.0])


def test_norms_are_those_of_the_paper():
    measured = np.array([1.0, 2.0, 3.0, 4.0])
    result = metrics(measured, measured + np.array([0.0, 3.0, 0.0, -4.0]))
    assert result.e2 == pytest.approx(5 / 4)
    assert result.einf == pytest.approx(4 / 4)
    assert result.rmse == pytest.approx(2.5)
    assert result.nrmse == pytest.approx(2.5 / np.std(measured))


def test_knee_is_farthest_below_the_line_between_the_ends():
    assert find_knee(np.array([[0.0, 1.0], [0.1, 0.2], [0.5, 0.15], [1.0, 0.0]])) == 1
    assert find_knee(np.array([[3.0, 4.0]])) == 0


def test_fit_file_round_trip_and_schema(bouc_wen_fit, tmp_path):
    path = write_fit(bouc_wen_fit, tmp_path)
    stored = read_fit(path)
    assert stored.model == "bouc_wen"
    assert stored.values == pytest.approx(bouc_wen_fit.values)
    assert sum(point["knee"] for point in stored.content["pareto_front"]) == 1
    content = json.loads(path.read_text())
    del content["parameters"]["offset"]["unit"]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="parameters/offset: 'unit' is a required property"):
        read_fit(path)
    path.write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        read_fit(path)


def test_report_needs_no_network(bouc_wen_fit, tmp_path):
    page = write_report(bouc_wen_fit, tmp_path).read_text()
    assert "<script src=" not in page
    assert "yield_force_per_A" in page
    assert page.count("<figure") >= 4
    assert page.count("<script") == 3  # data, uPlot and what draws with it


def test_the_page_writes_quantities_with_prefixes():
    assert quantity(0.0001247, "m") == "124.7 µm"
    assert quantity(-0.0123, "m/A") == "-12.3 mm/A".replace("-", "\N{MINUS SIGN}")
    assert quantity(80.0, "N") == "80 N"
    assert quantity(-80.0, "N") == "\N{MINUS SIGN}80 N"
    assert quantity(float("nan"), "N") == "nan N"
    assert quantity(123456.0, "N s/m") == "123.5 kN s/m"
    assert quantity(0.0, "s") == "0 s"
    assert quantity(0.001, "1/A") == "0.001 1/A"
    assert quantity(1.5, "") == "1.5"


def test_every_run_can_be_chosen_the_worst_first(bouc_wen_fit, tmp_path):
    (result, *_) = bouc_wen_fit.fitted
    runs = tuple(
        replace(result, run=replace(result.run, name=name), metrics=replace(result.metrics, nrmse=error))
        for name, error in (("good", 0.1), ("bad", 0.9), *((f"other_{i}", 0.5) for i in range(MOST_RUNS - 1)))
    )
    page = write_report(replace(bouc_wen_fit, fitted=runs, held_out=()), tmp_path).read_text()
    assert re.findall(r'<details name="run"( open|)><summary>(\w+), ', page)[0] == (" open", "bad")
    assert page.count('<details name="run"') == MOST_RUNS
    assert "The 1 runs" not in page
    assert "The run with the least error is left out." in page
    assert len(page.encode()) < 1_000_000
    # A standard set of ten runs is there as a whole.
    page = write_report(replace(bouc_wen_fit, fitted=runs[:10], held_out=()), tmp_path).read_text()
    assert page.count('<details name="run"') == 10
    assert "left out" not in page.partition('<div class="figures">')[0]
    assert len(page.encode()) < 1_000_000


def test_a_fit_says_and_draws_itself(bouc_wen_fit):
    lines = bouc_wen_fit.summary().splitlines()
    assert lines[0] == bouc_wen_fit.sentence
    assert lines[1].split() == ["parameter", "value", "95", "%", "interval"]
    for estimate, line in zip(bouc_wen_fit.estimates, lines[2:], strict=False):
        assert line.startswith(f"{estimate.parameter.name} ")
        assert f" {quantity(estimate.value, estimate.parameter.unit)}  " in line
        assert len(line) <= 80
    assert lines[2 + len(bouc_wen_fit.estimates) :] == [f"note: {warning}" for warning in bouc_wen_fit.warnings]
    assert [line.name for line in bouc_wen_fit.plot().data[:2]] == ["measured", "model"]


def test_the_errors_are_drawn_as_they_are(bouc_wen_fit):
    (result, *_) = bouc_wen_fit.fitted
    wave = 5.0 * np.sin(2 * np.pi * 10.0 * result.run.time)
    noise = np.random.default_rng(0).normal(0.0, 2.0, len(result.run))
    for errors, at_period in ((wave, 1.0), (noise, 0.0)):
        histogram, normal, autocorrelation = figures.residuals([replace(result, modelled=result.run.force + errors)]).data
        lags, values = np.array(autocorrelation.x), np.array(autocorrelation.y)
        assert values[0] == 1.0
        assert values[np.argmin(np.abs(lags - 0.1))] == pytest.approx(at_period, abs=0.15)
        width = histogram.x[1] - histogram.x[0]
        assert sum(histogram.y) * width == pytest.approx(1.0, abs=0.01)
        # A wave spends most of its time at its ends, noise in the middle.
        middle = np.argmin(np.abs(np.array(histogram.x)))
        assert (histogram.y[middle] > 0.8 * normal.y[middle]) == (errors is noise)


def test_report_draws_no_intervals_where_there_are_none(bouc_wen_fit, tmp_path):
    without = tuple(replace(estimate, lower=np.nan, upper=np.nan) for estimate in bouc_wen_fit.estimates)
    page = write_report(replace(bouc_wen_fit, estimates=without), tmp_path).read_text()
    assert "Confidence intervals" not in page
    assert "Correlation of the estimates" not in page
    assert "There are no intervals" in page


def test_no_interval_reaches_beyond_what_a_parameter_can_be():
    # The data hardly show the lag of the coil, which is 0.
    fit = identify([simulate("bingham", {"coil_lag": 0.0}, noise=5.0)], "bingham", population=16, generations=5)
    assert all(e.lower >= e.parameter.limits[0] for e in fit.estimates if np.isfinite(e.lower))


def test_a_very_good_fit_does_not_explain_everything(bouc_wen_fit, tmp_path):
    assert "explains 99.99" in bouc_wen_fit.sentence
    page = write_report(bouc_wen_fit, tmp_path).read_text()
    assert all(f"held out, NRMSE {per_cent(of.metrics.nrmse)}" in page for of in bouc_wen_fit.held_out)


def test_report_says_what_it_shows_and_where_it_comes_from(bouc_wen_fit, tmp_path):
    files = [replace(of, run=replace(of.run, info={"source": f"rig/{of.run.name}.csv"})) for of in bouc_wen_fit.fitted]
    page = write_report(replace(bouc_wen_fit, fitted=tuple(files)), tmp_path).read_text()
    # Somebody who cannot see the figures is told what each of them draws.
    assert page.count('role="img"') == page.count('class="plot"')
    assert 'aria-label="Chart of force, N over velocity, mm/s and position, mm: measured, model"' in page
    runs = " ".join(of.run.info["source"] for of in files)
    assert f"diagnose {runs} --held-out RUN... --model bouc_wen --output DIR</code>" in page
    assert len(page.encode()) < 1_000_000
    footer = page.partition("<footer>")[2]
    assert f"mrd {VERSION} on {datetime.date.today().year}-" in footer
    assert all(f"<code>rig/{of.run.name}.csv</code>" in footer for of in files)


def test_where_a_parameter_is_on_its_bound_other_models_are_the_next_step(bouc_wen_fit):
    on_bound = replace(bouc_wen_fit.estimates[0], on_bound=True)
    free = [replace(estimate, on_bound=False) for estimate in bouc_wen_fit.estimates]
    assert " compare " in next_command(replace(bouc_wen_fit, estimates=(on_bound, *free[1:])))
    assert " diagnose " in next_command(replace(bouc_wen_fit, estimates=tuple(free)))


def test_the_next_command_repeats_what_the_runs_are(bouc_wen_fit):
    free = tuple(replace(estimate, on_bound=False) for estimate in bouc_wen_fit.estimates)

    def of(result, source, word):
        info = {"source": source} | ({"force_filter": word} if word else {})
        return replace(result, run=replace(result.run, info=info))

    passes = tuple(of(result, "a b.csv", "lowpass:40") for result in bouc_wen_fit.fitted)
    unseen = of(bouc_wen_fit.held_out[0], "c.csv", "lowpass:40")
    alike = replace(bouc_wen_fit, estimates=free, fitted=passes, held_out=(unseen,))
    assert "diagnose 'a b.csv' --held-out c.csv --force-filter lowpass:40 --model" in next_command(alike)
    other = replace(alike, held_out=(of(bouc_wen_fit.held_out[0], "c.csv", ""),))
    assert "--force-filter run1=lowpass:40 --force-filter run2=lowpass:40 --model" in next_command(other)
    assert "--held-out" not in next_command(replace(alike, held_out_by="leave-one-run-out"))


def test_unusable_input_is_one_line():
    run = simulate("bingham", {}, seconds=2)
    copy = replace(run, name="copy", force=run.force.copy())
    for other in (run, copy, replace(copy.without_start(0.5), name="copy")):
        for runs, held_out in (([run], [other]), ([run, other], [])):
            with pytest.raises(InputError, match=f"run0 and {other.name} are the same recording"):
                identify(runs, "bingham", held_out=held_out)
    motionless = Run("motionless", run.time, 0 * run.position, 0 * run.velocity, run.current, run.force)
    with pytest.raises(InputError, match="unknown model nosuch"):
        identify([run], "nosuch")
    with pytest.raises(InputError, match="no runs"):
        identify([], "bingham")
    with pytest.raises(InputError, match="motionless: position never changes"):
        identify([motionless], "bingham")
    with pytest.raises(InputError, match="loss 'nosuch': expected linear, soft_l1, huber"):
        identify([run], "bingham", loss="nosuch")
    with pytest.raises(InputError, match="weights 'nosuch': expected samples, runs, force, or a number"):
        identify([run], "bingham", weights="nosuch")
    with pytest.raises(InputError, match="population 2"):
        identify([run], "bingham", population=2)


def test_a_run_that_is_left_out_does_not_influence_its_prediction():
    """There are two currents; one alone does not determine the slopes over current, and the prediction error shows it."""
    runs = [simulate("bingham", {}, seed=1, current=0.1), simulate("bingham", {}, seed=2, current=0.4)]
    options = {**BRIEF, "seed": 1}
    fit = identify(runs, "bingham", **options)
    assert any(warning.startswith("The held-out error of run1, run2 is too large:") for warning in fit.warnings)
    for index, result in enumerate(fit.held_out):
        alone = identify([runs[1 - index]], "bingham", held_out=[runs[index]], **options)
        assert result.metrics.nrmse > 0.3
        assert result.metrics.nrmse == pytest.approx(alone.pooled_held_out.nrmse, rel=0.05)


def test_a_run_without_which_fewer_parameters_are_determined_is_named():
    """Whatever else is noted: a filter, or a law that two currents make a straight line."""
    runs = [simulate("bingham", {}, seed=seed, current=0.1 * seed, seconds=2.0) for seed in (1, 2, 3)]
    runs = [with_force_filter(run, "lowpass:200") for run in runs]
    options = {"laws": "quadratic", "population": 8, "generations": 1, "seeds": 1, "profile": False}
    fit = identify(runs, "bingham", **options)
    assert any(warning.startswith("The held-out error of run1, run2, run3 is too large:") for warning in fit.warnings)


def test_a_prediction_does_not_know_the_start_that_was_found_with_other_parameters():
    predicted = import_module("mrd_identification.identify")._predicted
    damper = find_model("bouc_wen")
    recording = prepare_recording(simulate("bouc_wen", TRUTH, seconds=2.0, noise=0.5))
    wrong = replace(recording, path=recording.path.led_in(resting_lead_in(5e-3, 1e-2, 0.01)))
    first, second = (predicted(damper, damper.vector(TRUTH), [], [each])[0] for each in (recording, wrong))
    assert np.array_equal(first.modelled, second.modelled)


def test_parameters_that_never_have_an_interval_do_not_count_as_those_that_need_segments():
    problem = SimpleNamespace(run_offsets=0)
    sensitivity = np.ones((9, 4)) * [1.0, 1.0, 1.0, 0.0]
    nan = np.full(4, np.nan)
    uncertain = Uncertainty(nan, nan, nan, nan, np.eye(4), np.zeros(4, bool), np.zeros(4), 1.0, 8, sensitivity)
    assert _too_few_segments(problem, uncertain) == []
    assert "3 parameters need 8" in _too_few_segments(problem, replace(uncertain, segments=7))[0]


def test_without_least_squares_no_run_is_left_out_in_turn():
    runs = [simulate("bingham", {}, seed=seed, seconds=3) for seed in (1, 2)]
    fit = identify(runs, "bingham", population=16, generations=4, least_squares=False)
    assert fit.held_out_by == "none"
    assert any("prediction error is unknown" in warning for warning in fit.warnings)


@pytest.mark.parametrize("rate", [25, 100, 1000])
def test_noise_of_the_current_sensor_is_not_a_change_of_current(rate):
    random = np.random.default_rng(rate)
    time = np.arange(20 * rate) / rate
    noise = 0.0067 * random.standard_normal(len(time))

    def names(current):
        return free_parameters("bingham", [Run("run", time, np.sin(time), np.cos(time), current, np.cos(time))])[0]

    assert "coil_lag" not in names(0.2 + noise)
    assert "coil_lag" in names(0.2 + 0.05 * (np.sin(5 * time) > 0) + noise)
    assert "coil_lag" in names(np.where(random.random(len(time) // 5 + 1).repeat(5)[: len(time)] > 0.5, 0.15, 0.0))


@pytest.mark.parametrize("output", ["", "file", "file/below"])
def test_an_output_folder_that_cannot_be_written_is_refused(output, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"--output .*expected a folder"):
        make_folder(str(tmp_path / output) if output else "")
