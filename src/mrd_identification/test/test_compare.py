"""A comparison ranks models by held-out error, with intervals from common resamples, and tells which are on par."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from mrd_base import InputError
from mrd_base.json_file import read_schema
from mrd_base.quantities import per_cent
from mrd_identification import Method, compare, identify, metrics
from mrd_identification.cli.compare import estimated_seconds
from mrd_identification.compare import _bootstrap, parse_row, rank
from mrd_identification.compare_file import sentence, write_comparison
from mrd_identification.fit import pooled_metrics
from mrd_identification.resampling import bootstrap_interval
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_sim.path import make_path

MODELS = ("linear_viscous", "bingham", "bouc_wen", "bouc_wen:quadratic")


def simulate(name, seed, current=None):
    """Simulate a noisy run of a Bouc-Wen damper along a multisine."""
    random = np.random.default_rng(seed)
    time = np.arange(0, 5, 0.004)
    position, velocity, acceleration = np.zeros((3, len(time)))
    for frequency, amplitude in ((0.7, 8e-3), (2.3, 3e-3)):
        w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
        position += amplitude * np.sin(w * time + phase)
        velocity += amplitude * w * np.cos(w * time + phase)
        acceleration -= amplitude * w**2 * np.sin(w * time + phase)
    level = random.choice([0.0, 0.2, 0.4], 10).repeat(len(time) // 10) if current is None else np.full(len(time), current)
    model = find_model("bouc_wen")
    force = model.force(model.vector({"yield_travel": 4e-4}), make_path(time, position, velocity, acceleration, level))
    return Run(name, time, position, velocity, level, force + 5.0 * random.standard_normal(len(time)))


@pytest.fixture(scope="module")
def comparison():
    return compare(
        [simulate("a", 1), simulate("b", 2)], MODELS, held_out=[simulate("c", 3)], population=16, generations=8, seeds=1
    )


def test_models_are_ranked_by_held_out_error(comparison):
    assert [entry.name for entry in comparison.entries][2:] == ["bingham", "linear_viscous"]
    assert {entry.name for entry in comparison.entries[:2]} == {"bouc_wen", "bouc_wen:quadratic"}
    for entry in comparison.entries:
        assert entry.lower < entry.nrmse < entry.upper
        assert entry.nrmse == pytest.approx(entry.fit.pooled_held_out.nrmse)
    assert comparison.best.difference == 0.0
    assert comparison.held_out_by == "runs"
    assert comparison.resampled == "segments"


def test_models_that_do_not_differ_significantly_are_on_par_and_the_simplest_is_named(comparison):
    assert [entry.on_par for entry in comparison.entries] == [True, True, False, False]
    assert comparison.simplest.name == "bouc_wen"
    assert "bouc_wen" in sentence(comparison)


def test_each_fit_is_what_identify_returns(comparison):
    alone = identify(
        [simulate("a", 1), simulate("b", 2)],
        "bingham",
        held_out=[simulate("c", 3)],
        population=16,
        generations=8,
        seeds=1,
        profile=False,
    )
    entry = next(entry for entry in comparison.entries if entry.name == "bingham")
    assert np.array_equal(entry.fit.theta, alone.theta)


def test_files_follow_their_schema_and_the_page_needs_no_network(comparison, tmp_path):
    page = write_comparison(comparison, tmp_path).read_text()
    assert "<script src=" not in page
    assert len(page.encode()) < 1_000_000
    assert "diagnose RUN... --held-out RUN... --model bouc_wen --output DIR</code>" in page
    content = json.loads((tmp_path / "compare.json").read_text())
    assert content["schema"] == "mrd-comparison/3"
    jsonschema.validate(content, read_schema("mrd_identification", "compare"))
    table = (tmp_path / "compare.md").read_text()
    for model in content["models"]:
        assert f"| `{model['name']}` | {model['free_parameters']} | {per_cent(model['nrmse']['value'])} |" in table
        jsonschema.validate(json.loads((tmp_path / model["fit"]).read_text()), read_schema("mrd_identification", "fit"))
        assert model["name"] in page


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_model_that_diverges_is_last_and_leaves_the_others_their_intervals(comparison, tmp_path, value):
    first, *others = comparison.entries
    result = replace(first.fit.held_out[0], modelled=np.where(first.fit.held_out[0].run.time > 3.0, value, 0.0))
    result = replace(result, metrics=metrics(result.measured_counted, result.modelled_counted))
    diverged = replace(first.fit, held_out=(result,), pooled_held_out=pooled_metrics([result]))
    ranked = rank([entry.name for entry in (first, *others)], [diverged, *(entry.fit for entry in others)])
    assert [entry.name for entry in ranked.entries] == [*(entry.name for entry in others), first.name]
    assert [entry.on_par for entry in ranked.entries] == [True, False, False, False]
    assert all(entry.lower < entry.nrmse < entry.upper for entry in ranked.entries[:-1])
    assert "diverges" in ranked.summary()
    assert "diverges" in write_comparison(ranked, tmp_path).read_text()
    assert json.loads((tmp_path / "compare.json").read_text())["models"][-1]["nrmse"]["value"] is None
    with pytest.raises(InputError, match=f"the force of {first.name} diverges"):
        rank([first.name], [diverged])


@pytest.mark.parametrize("units", [5, 9])
def test_intervals_of_few_runs_cover_the_truth(units):
    random = np.random.default_rng(units)
    force = np.tile([-1.0, 1.0], units)
    runs = [slice(2 * run, 2 * run + 2) for run in range(units)]
    covered = []
    for _ in range(600):
        first, second = (np.repeat(random.normal(mean, 0.1, units), 2) for mean in (0.5, 0.6))
        nrmse, drawn = _bootstrap(force, [first, second], runs)
        lower, upper = bootstrap_interval(nrmse[0], drawn[0], units)
        between = bootstrap_interval(nrmse[1] - nrmse[0], drawn[1] - drawn[0], units)
        covered.append(
            (lower <= np.hypot(0.5, 0.1) <= upper, between[0] <= np.hypot(0.6, 0.1) - np.hypot(0.5, 0.1) <= between[1])
        )
    shares = np.mean(covered, axis=0)
    assert (shares >= 0.91).all()
    assert (shares <= 0.98).all()


def test_the_estimated_time_counts_the_selection_of_effects():
    rows = [parse_row(name, Method()) for name in ("bingham", "bingham+auto")]
    plain, selected = (estimated_seconds([method], 1000) for _, method in rows)
    assert selected == pytest.approx(12 * plain)


def test_five_held_out_runs_are_resampled():
    runs = [simulate(f"run{seed}", seed) for seed in range(5)]
    by_runs = compare(runs, ["linear_viscous", "bingham"], population=16, generations=4, seeds=1)
    assert by_runs.held_out_by == "leave-one-run-out"
    assert by_runs.resampled == "runs"
    assert by_runs.units == 5


def test_a_short_held_out_run_gives_no_interval(tmp_path):
    run = simulate("a", 1)
    short = Run("short", run.time[:150], *(s[:150] for s in (run.position, run.velocity, run.current, run.force)))
    comparison = compare([run], ["linear_viscous", "bingham"], held_out=[short], population=8, generations=2, seeds=1)
    assert comparison.units < 10
    assert all(np.isnan(entry.lower) for entry in comparison.entries)
    assert [entry.on_par for entry in comparison.entries] == [True, False]
    assert comparison.simplest is comparison.best
    assert "nan" not in write_comparison(comparison, tmp_path).read_text(encoding="utf-8").partition("<h2>Ranking")[2][:3000]


def test_unusable_comparisons_are_one_line():
    run = simulate("a", 1)
    with pytest.raises(InputError, match="one run and no held-out run"):
        compare([run], ["bingham"])
    with pytest.raises(InputError, match="expected each of them once"):
        compare([run, run], ["bingham", "bingham"])
    with pytest.raises(InputError, match="no run is left out in turn"):
        compare([run, run], ["bingham"], least_squares=False)
    with pytest.raises(InputError, match="unknown current law nosuch"):
        compare([run, run], ["bingham:nosuch"])
    with pytest.raises(InputError, match="unknown model nosuch"):
        compare([run, run], ["nosuch"])
