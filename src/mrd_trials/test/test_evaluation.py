"""The evaluation by itself: true map, closure against exactly known noise, baseline methods."""

import ast
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import mrd_diagnosis
import mrd_trials
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import make_problem
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_trials.baseline_methods import run_baseline_methods
from mrd_trials.bench_session import BenchSession, as_run
from mrd_trials.closure import ClosureMeter
from mrd_trials.records import GapBin
from mrd_trials.true_map import axis_series, shares_of_bins, travel_since_reversal, true_map
from mrd_trials.truth import BenchCommand, TrueInstruments, TruePlant

EFFECTS = {"moving_mass": {"mass": 3.0, "frequency": 100.0, "damping": 0.3}}


@dataclass(frozen=True)
class Plant:
    session: BenchSession
    runs: list[Run]


@pytest.fixture(scope="module")
def plant():
    """A plant with a moving mass, three runs for the diagnosis, two fresh ones."""
    time = np.arange(4 * 8000) / 8000
    commands = tuple(
        BenchCommand(
            time,
            0.006 * np.sin(2 * np.pi * time + k) + 0.003 * np.sin(2 * np.pi * (4 + 0.5 * k) * time),
            np.where((time * (k + 1)) % 2 < 1, 0.1, 0.3),
        )
        for k in range(5)
    )
    names = tuple(f"run_{k}" for k in range(5))
    session = BenchSession(names, commands, TrueInstruments(200.0, averaged=False), TruePlant("bouc_wen", {}), 11, 12, 13)
    return Plant(session, [as_run(*named) for named in zip(names, session.record(EFFECTS), strict=True)])


def test_trials_use_only_the_public_api_of_the_diagnosis():
    # Only `learn` judges no diagnosis: it makes the weights of one.
    files = [file for file in Path(mrd_trials.__file__).parent.rglob("*.py") if file.name != "learn.py"]
    assert len(files) > 20
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mrd_diagnosis"):
                assert node.module == "mrd_diagnosis", file
                assert {alias.name for alias in node.names} <= set(mrd_diagnosis.__all__), file
            if isinstance(node, ast.Import):
                assert not any(alias.name.startswith("mrd_diagnosis") for alias in node.names), file


def test_travel_since_reversal():
    position = np.array([0.0, 1.0, 3.0, 3.0, 2.0, 0.0, 1.0])
    assert travel_since_reversal(position).tolist() == [0.0, 1.0, 3.0, 0.0, 1.0, 0.0, 1.0]


def test_ends_and_steps_of_the_true_map_are_those_of_the_motion_and_the_current():
    time = np.arange(1000) / 500
    position, current = 0.01 * np.sin(np.pi * time), np.where(time < 1.0, 0.2, 0.5)
    run = Run("run", time, position, np.gradient(position, time), current, np.zeros(1000))
    series = axis_series([run], [slice(0, 1000)])
    assert series["end"][0] == pytest.approx(0.01, rel=1e-2)
    assert series["end"][250] == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.isinf(series["step"][:500]))
    np.testing.assert_allclose(series["step"][500:], time[500:] - 1.0, atol=2.1e-3)


def test_shares_of_bins():
    values, weights = np.array([-0.1, 0.5, 1.0, 2.5, 4.0]), np.array([1.0, 2.0, 3.0, 4.0, 10.0])
    assert shares_of_bins(values, weights, [(0.0, 1.0), (1.0, 2.0), (2.0, 3.0)]) == [0.15, 0.15, 0.7]
    assert shares_of_bins(np.array([1.0, 2.0, 2.0]), np.ones(3), [(1.0, 1.0), (2.0, 2.0)]) == [1 / 3, 2 / 3]


def test_the_true_map_of_a_mass_lies_at_high_accelerations_and_frequencies(plant):
    acceleration, frequency = np.array([0.0, 0.5, 1.0, 2.0, 5.0]), np.array([0.0, 3.0, 8.0, 100.0])
    bins = [GapBin("acceleration", *ends, 0.0) for ends in pairwise(acceleration)]
    bins += [GapBin("frequency", *ends, 0.0) for ends in pairwise(frequency)]
    bins += [GapBin("run", k, k, 0.0) for k in (1.0, 2.0, 3.0)] + [GapBin("sign", k, k, 0.0) for k in (-1.0, 1.0)]
    shares = true_map(plant.session, EFFECTS, "bouc_wen", bins)
    assert [(b.axis, b.lower, b.upper) for b in shares] == [(b.axis, b.lower, b.upper) for b in bins]
    for axis in ("acceleration", "frequency", "run", "sign"):
        assert sum(b.share for b in shares if b.axis == axis) == pytest.approx(1.0, abs=0.02)
    of_acceleration, of_frequency = ([b.share for b in shares if b.axis == axis] for axis in ("acceleration", "frequency"))
    assert np.argmax(of_acceleration) == 3
    assert np.argmax(of_frequency) == 1


def test_without_effects_there_is_no_true_map(plant):
    assert true_map(plant.session, {}, "bouc_wen", [GapBin("sign", 1.0, 1.0, 0.0)]) == ()


def test_closure_of_the_true_effect_is_whole_and_without_it_none(plant):
    given, fresh = plant.runs[:3], plant.runs[3:]
    meter = ClosureMeter.from_session(plant.session, EFFECTS, "bouc_wen", given, fresh)
    closures = {}
    for effects in ((), ("moving_mass",)):
        model = find_model("bouc_wen", effects=list(effects))
        problem, _ = make_problem(model, meter.recordings[:3], fixed={"coil_lag": 0.0})
        start = np.array([{"moving_mass.mass": 1.0}.get(p.name, p.default) for p in model.parameters])
        theta, _ = fit_least_squares(problem, problem.project(start[None])[0][0])
        parameters = dict(zip(model.names, map(float, theta), strict=True))
        closures[effects] = meter.on_given_runs(effects, parameters), meter.on_fresh_runs(effects, parameters)
    assert closures["moving_mass",] == pytest.approx((1.0, 1.0), abs=0.05)
    assert closures[()] == pytest.approx((0.0, 0.0), abs=0.02)


def test_baseline_methods_rank_a_strong_effect_first(plant):
    rankings = run_baseline_methods(plant.runs[:3], "bouc_wen")
    for method in ("score", "in_sample", "bic"):
        assert rankings[method][0] == "moving_mass", method
    assert rankings.keys() == {"correlation", "score", "in_sample", "bic", "random"}
    assert {"", *rankings["random"]} == set(rankings["bic"])
