"""A comparison ranks models by held-out error, with intervals from common resamples, and tells which are on par."""

import json

import jsonschema
import numpy as np
import pytest

from mrd_base import InputError
from mrd_base.json_file import read_schema
from mrd_base.quantities import per_cent
from mrd_identification import compare, identify
from mrd_identification.compare_file import sentence, write_comparison
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
    assert "diagnose RUN... --model bouc_wen --output DIR</code>" in page
    content = json.loads((tmp_path / "compare.json").read_text())
    assert content["schema"] == "mrd-comparison/3"
    jsonschema.validate(content, read_schema("mrd_identification", "compare"))
    table = (tmp_path / "compare.md").read_text()
    for model in content["models"]:
        assert f"| `{model['name']}` | {model['free_parameters']} | {per_cent(model['nrmse']['value'])} |" in table
        jsonschema.validate(json.loads((tmp_path / model["fit"]).read_text()), read_schema("mrd_identification", "fit"))
        assert model["name"] in page


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
