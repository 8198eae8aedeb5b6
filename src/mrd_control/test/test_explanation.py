"""What explains the difference between a hybrid test and its twin, and the page that shows it."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_control.comparison import compare_with_twin, write_comparison
from mrd_control.experiment import damper_entry, read_control_experiment
from mrd_control.explanation import PARAMETERS, TRACKING, explain_difference
from mrd_control.recording import HybridRun, Timing
from mrd_control.ride import DataSheet, ride_metrics
from mrd_control.twin import run_twin
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.damper import Damper

SHIPPED = read_control_experiment(Path(__file__).resolve().parents[3] / "config/control/hybrid_test.yaml")
SHORT = replace(SHIPPED, duration=6.0, excitation=replace(SHIPPED.excitation, start=1.5))


def damper_with(parameters=None, **effects):
    entry = damper_entry(SHORT.damper)
    return Damper(entry["model"], entry["parameters"] | (parameters or {}), entry["laws"], effects)


def recorded(damper, error=None):
    """A hybrid test whose damper is another one than the twin's, and whose rod is off by an error, as if on the bench."""
    bench = run_twin(replace(SHORT, damper=damper), error)
    cycles = np.full(SHORT.samples // 4, SHORT.cycle)
    return HybridRun(SHORT, bench, Timing(cycles, 0.0 * cycles, 0.1 * cycles, 0), 0.01 * cycles, "bag")


def differences(run):
    kept = SHORT.counted
    system, twin = SHORT.system.linear(), run_twin(SHORT)
    bench, modelled = (asdict(ride_metrics(system, result.part(kept), DataSheet(), 0.0)) for result in (run.bench, twin))
    return {name: bench[name] - modelled[name] for name in bench}


def test_the_whole_difference_is_that_of_its_only_cause():
    damper = damper_with(coil_lag={"lag": 0.015, "falling": 0.3})
    run = recorded(damper)
    explanation, difference = explain_difference(run, damper), differences(run)
    assert explanation.causes == ("coil_lag", PARAMETERS, TRACKING)
    assert abs(difference["weighted"]) > 0.005
    for metric in ("acceleration", "weighted", "travel", "contact"):
        assert explanation.parts[metric]["coil_lag"] == pytest.approx(difference[metric])
        assert explanation.parts[metric][PARAMETERS] == explanation.parts[metric][TRACKING] == 0.0
        assert explanation.rest[metric] == pytest.approx(0.0, abs=1e-12)


def test_parts_and_rest_sum_to_the_difference():
    """Two effects, other parameters and a rod that is late: each has a part, and nothing is counted twice."""
    time = np.arange(SHORT.samples) / SHORT.rate
    late = 5e-4 * np.stack([np.sin(12 * time), 12 * np.cos(12 * time), -144 * np.sin(12 * time)], axis=1)
    damper = damper_with({"viscous": 1100.0}, coil_lag={"lag": 0.02}, series_compliance={"compliance": 1e-6})
    run = recorded(damper, late)
    explanation, difference = explain_difference(run, damper), differences(run)
    for metric, parts in explanation.parts.items():
        assert sum(parts.values()) + explanation.rest[metric] == pytest.approx(difference[metric], abs=1e-9), metric
    assert all(abs(part) > 1e-4 for part in explanation.parts["weighted"].values())
    # The tracking error is that of a smoothed recording.
    assert abs(explanation.rest["weighted"]) < 0.05 * abs(difference["weighted"])


def test_what_no_cause_explains_stays_the_rest():
    run = recorded(damper_with({"viscous": 1100.0}))
    explanation, difference = explain_difference(run, damper_with(coil_lag={"lag": 0.0})), differences(run)
    assert explanation.rest["weighted"] == pytest.approx(difference["weighted"])


def test_more_causes_than_can_be_tried_are_refused():
    names = ("coil_lag", "gas_spring", "seal_friction", "moving_mass", "thermal_fade")
    with pytest.raises(InputError, match="7 causes, expected at most 6"):
        explain_difference(recorded(SHORT.damper), damper_with(**{name: {} for name in names}))


def test_page_and_file_show_the_explanation(tmp_path):
    damper = damper_with(coil_lag={"lag": 0.015})
    comparison = compare_with_twin(recorded(damper), damper)
    assert comparison.explained_motion < 1e-9 < 0.005 < comparison.motion
    page = write_comparison(comparison, tmp_path).read_text()
    assert "What explains the difference" in page
    assert "Lag behind the coil current" in page
    content = json.loads((tmp_path / "hybrid_test.json").read_text())
    assert set(content["explanation"]["parts"]["weighted"]) == {"coil_lag", PARAMETERS, TRACKING}

    without = compare_with_twin(recorded(damper))
    page = write_comparison(without, tmp_path).read_text()
    assert "What explains the difference" not in page
    assert json.loads((tmp_path / "hybrid_test.json").read_text())["explanation"] is None


class NoisyDamper:
    """A damper whose measured force has noise, which the controller therefore feeds back into motion and current."""

    def __init__(self, damper, noise):
        self.model, self._damper, self._noise, self._done = damper.model, damper, noise, 0

    def __copy__(self):
        entry = damper_entry(self._damper)
        return NoisyDamper(Damper(entry["model"], entry["parameters"], entry["laws"], entry["effects"]), self._noise)

    @property
    def theta(self):
        return self._damper.theta

    def advance(self, *block):
        force = self._damper.advance(*block)
        self._done += len(force)
        return force + self._noise[self._done - len(force) : self._done]


def test_noise_that_feeds_back_does_not_bias_what_is_identified():
    """The same motion and current with noise of their own, that did not cause them, give the same parameters."""
    noise, fresh = 3.0 * np.random.default_rng(1).standard_normal((2, SHORT.samples))  # ten times that of the bench
    true = damper_with({"coil_lag": 0.015})
    bench = run_twin(replace(SHORT, damper=NoisyDamper(true, noise)))
    quiet = run_twin(replace(SHORT, damper=true))
    assert np.std(bench.travel - quiet.travel) > 1e-6  # the noise does reach the motion

    def identified(force):
        run = Run("run", bench.time, bench.rod, np.gradient(bench.rod, bench.time), bench.current, force)
        problem, _ = make_problem(true.model, [prepare_recording(run)])
        return dict(zip(true.model.names, fit_least_squares(problem, true.theta)[0], strict=True))

    for force in (bench.force, bench.force - noise + fresh):
        found = identified(force)
        assert found["coil_lag"] == pytest.approx(0.015, abs=1e-4)
        assert found["yield_force"] == pytest.approx(80.0, rel=0.01)
        assert found["yield_force_per_A"] == pytest.approx(900.0, rel=0.01)
        assert found["viscous"] == pytest.approx(900.0, rel=0.01)
