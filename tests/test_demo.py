"""The demo: a fault that is hidden in the simulated bench is named by the diagnosis."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from mrd_diagnosis import diagnose
from mrd_runs import Run
from mrd_sim.effects import EFFECTS
from mrd_sim.plant import read_damper
from mrd_sim.simulate import measure_plans, write_csv
from mrd_trajectory.experiment import read_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def demo(monkeypatch):
    monkeypatch.chdir(ROOT)
    specification = importlib.util.spec_from_file_location("demo", ROOT / "setup/demo.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def recorded(demo, plant: Path, seed: int) -> list[Run]:
    """Record the demo's experiments as a bench would, without ROS."""
    settings = read_settings(ROOT / "config/bench.yaml")
    experiments = [read_experiment(file) for file in sorted(demo.EXPERIMENTS.glob("*.yaml"))]
    plans = [plan(experiment, settings.limits, settings.force_envelope) for experiment in experiments]
    return measure_plans(plans, read_damper(plant).build(), np.random.default_rng(seed))


def test_the_seed_draws_the_fault(demo):
    assert demo.draw_fault(3) == demo.draw_fault(3)
    drawn = [demo.draw_fault(seed) for seed in range(200)]
    assert {effect for effect, _ in drawn} == set(demo.FAULTS)
    for effect, values in drawn:
        size = EFFECTS[effect].parameters[0].name
        assert 1.0 <= values.pop(size) / EFFECTS[effect].typical[size] <= demo.LARGEST
        assert values.items() <= EFFECTS[effect].typical.items()


def test_the_hidden_fault_is_all_that_the_bench_has_beside_the_shipped_one(demo, tmp_path):
    effect, values = demo.draw_fault(3)
    hidden = read_damper(demo.hide((effect, values), tmp_path / "sealed.yaml")).build()
    shipped = read_damper(demo.PLANT).build({effect: values})
    assert hidden.model.names == shipped.model.names
    assert np.array_equal(hidden.theta, shipped.theta)


def test_the_error_left_tells_a_corrected_simulator_from_one_that_lacks_the_fault(demo, tmp_path):
    hidden = demo.hide(("joint_play", {"play": 4e-4}), tmp_path / "sealed.yaml")
    runs = recorded(demo, hidden, 1)
    files = [tmp_path / f"{run.name}.csv" for run in runs]
    for run, file in zip(runs, files, strict=True):
        write_csv(run, file, velocity=False)
    right, wrong = demo.error_left(hidden, files), demo.error_left(demo.PLANT, files)
    assert right < 0.03
    assert wrong > 4 * right


@pytest.mark.slow
def test_the_shipped_bench_has_nothing_that_a_diagnosis_finds(demo):
    """A lag of the coil that nobody had asked for was the first thing that a diagnosis of this bench named."""
    diagnosis = diagnose(recorded(demo, demo.PLANT, 1), "bouc_wen")
    assert (diagnosis.verdict, diagnosis.causes) == ("no_gap", ())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 11))
def test_the_diagnosis_names_the_hidden_fault_alone(demo, tmp_path, seed):
    effect, values = demo.draw_fault(seed)
    diagnosis = diagnose(recorded(demo, demo.hide((effect, values), tmp_path / "sealed.yaml"), seed), "bouc_wen")
    assert [cause.effect for cause in diagnosis.causes] == [effect]
    assert diagnosis.gap.after.value < 0.7 * diagnosis.gap.before.value
