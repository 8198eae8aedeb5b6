"""A comparison ranks models by unseen error, with intervals from common resamples, and says which are on par."""

import json

import jsonschema
import numpy as np
import pytest

from mrd_base import InputError
from mrd_identification import compare, identify
from mrd_identification.compare_file import sentence, write_comparison
from mrd_identification.json_file import read_schema
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_sim.path import make_path

LADDER = ("linear_viscous", "bingham", "bouc_wen", "bouc_wen:quadratic")


def simulated(name, seed, current=None):
    """A run of a noisy Bouc-Wen damper along a multisine."""
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
def found():
    return compare(
        [simulated("a", 1), simulated("b", 2)], LADDER, held_out=[simulated("c", 3)], population=16, generations=8, seeds=1
    )


def test_models_are_ranked_by_unseen_error(found):
    assert [entry.name for entry in found.entries][2:] == ["bingham", "linear_viscous"]
    assert {entry.name for entry in found.entries[:2]} == {"bouc_wen", "bouc_wen:quadratic"}
    for entry in found.entries:
        assert entry.lower < entry.nrmse < entry.upper
        assert entry.nrmse == pytest.approx(entry.fit.pooled_held_out.nrmse)
    assert found.entries[0].behind == 0.0
    assert found.judged_by == "runs"
    assert found.resampled == "stretches"


def test_what_the_judges_cannot_tell_apart_is_on_par_and_the_simplest_is_named(found):
    assert [entry.on_par for entry in found.entries] == [True, True, False, False]
    assert found.simplest.name == "bouc_wen"
    assert "bouc_wen" in sentence(found)


def test_an_entry_is_what_identify_gives(found):
    alone = identify(
        [simulated("a", 1), simulated("b", 2)],
        "bingham",
        held_out=[simulated("c", 3)],
        population=16,
        generations=8,
        seeds=1,
        profile=False,
    )
    entry = next(entry for entry in found.entries if entry.name == "bingham")
    assert np.array_equal(entry.fit.theta, alone.theta)


def test_files_hold_to_their_schema_and_need_no_network(found, tmp_path):
    page = write_comparison(found, tmp_path).read_text()
    assert "<script src=" not in page
    content = json.loads((tmp_path / "compare.json").read_text())
    jsonschema.validate(content, read_schema("mrd_identification", "compare"))
    table = (tmp_path / "compare.md").read_text()
    for model in content["models"]:
        assert f"| `{model['name']}` | {model['free_parameters']} | {model['nrmse']['value']:.4f} |" in table
        jsonschema.validate(json.loads((tmp_path / model["fit"]).read_text()), read_schema("mrd_identification", "fit"))
        assert model["name"] in page


def test_with_five_judged_runs_these_are_resampled():
    runs = [simulated(f"run{seed}", seed) for seed in range(5)]
    by_runs = compare(runs, ["linear_viscous", "bingham"], population=16, generations=4, seeds=1)
    assert by_runs.judged_by == "leave-one-run-out"
    assert by_runs.resampled == "runs"
    assert by_runs.units == 5


def test_too_little_to_judge_by_gives_no_interval(tmp_path):
    run = simulated("a", 1)
    short = Run("short", run.time[:150], *(s[:150] for s in (run.position, run.velocity, run.current, run.force)))
    found = compare([run], ["linear_viscous", "bingham"], held_out=[short], population=8, generations=2, seeds=1)
    assert found.units < 10
    assert all(np.isnan(entry.lower) for entry in found.entries)
    assert [entry.on_par for entry in found.entries] == [True, False]
    assert found.simplest is found.entries[0]
    assert write_comparison(found, tmp_path).exists()


def test_unusable_comparisons_are_one_line():
    run = simulated("a", 1)
    with pytest.raises(InputError, match="nothing to judge by"):
        compare([run], ["bingham"])
    with pytest.raises(InputError, match="expected each one once"):
        compare([run, run], ["bingham", "bingham"])
    with pytest.raises(InputError, match="no run is left out in turn"):
        compare([run, run], ["bingham"], least_squares=False)
    with pytest.raises(InputError, match="unknown current law nosuch"):
        compare([run, run], ["bingham:nosuch"])
    with pytest.raises(InputError, match="unknown model nosuch"):
        compare([run, run], ["nosuch"])
