"""Detectable sizes of effects, on planned runs of which everything is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_diagnosis import diagnose
from mrd_diagnosis.decision import candidates
from mrd_diagnosis.evidence.detectability import (
    Detectability,
    detectable_sizes,
    largest_size,
    scaled_effect,
    simulate_base_fit,
)
from mrd_diagnosis.fitting.base_fit import with_effect
from mrd_diagnosis.fitting.refit import refit
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.quantities import format_quantity
from mrd_identification.recording import prepare_recording
from mrd_runs.scales import REFERENCE
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

EXPERIMENT = "{{name: {}, duration_s: 6.0, rate_hz: 500.0, rod: {{waveform: {}}}, coil: {{waveform: {}}}}}"
PLANS = [
    plan(parse_experiment(EXPERIMENT.format(*texts), texts[0]), Limits(), ForceEnvelope())
    for texts in (
        ("slow", "sine, amplitude_mm: 6.0, frequency_hz: 0.4", "constant, level_mA: 100.0"),
        ("switched", "sine, amplitude_mm: 5.0, frequency_hz: 1.1", "prbs, low_mA: 50.0, high_mA: 300.0, bit_s: 0.2"),
        ("fast", "sine, amplitude_mm: 4.0, frequency_hz: 4.0", "constant, level_mA: 0.0"),
    )
]
PARAMETERS = {"coil_lag": 0.0}


@pytest.fixture(scope="module")
def base_fit_of_plans():
    return simulate_base_fit(PLANS, Damper("bouc_wen", PARAMETERS), np.random.default_rng(0))


def test_an_effect_that_the_model_absorbs_is_untestable(base_fit_of_plans):
    for detectability in detectable_sizes(*base_fit_of_plans, ["load_cell_gain", "current_sensor_error"]):
        assert detectability.smallest_size == np.inf
        assert detectability.remark == "the model's own parameters take it up"


def test_an_end_stop_that_the_rod_never_reaches_is_undetectable(base_fit_of_plans):
    (detectability,) = detectable_sizes(*base_fit_of_plans, ["end_stop"])  # beyond 8 mm from mid-stroke
    assert detectability.smallest_size == np.inf
    assert detectability.remark == "it does not act in these runs"
    assert not detectability.information.any()


def test_more_than_plausible_may_be_needed(base_fit_of_plans):
    (detectability,) = detectable_sizes(*base_fit_of_plans, ["seal_friction"], needed=1e9)
    assert detectability.smallest_size == np.inf
    assert detectability.remark == "even the largest plausible size would not show"
    assert detectability.information.sum() == pytest.approx(1.0)


def test_evidence_lies_in_the_runs_that_excite_an_effect(base_fit_of_plans):
    detectability = {
        entry.effect: entry for entry in detectable_sizes(*base_fit_of_plans, ["coil_lag", "moving_mass", "seal_friction"])
    }
    assert detectability["coil_lag"].information[1] > 0.95  # the only run in which the current changes
    assert detectability["moving_mass"].information[2] > 0.5  # the fast one
    for entry in detectability.values():
        assert entry.remark == ""
        assert entry.information.sum() == pytest.approx(1.0)
        assert 0.0 < entry.smallest_size < largest_size(EFFECTS[entry.effect])


def test_twice_the_size_has_four_times_the_evidence(base_fit_of_plans):
    once, twice = (
        detectable_sizes(*base_fit_of_plans, ["moving_mass"], needed=needed)[0].smallest_size for needed in (1000.0, 4000.0)
    )
    assert twice == pytest.approx(2 * once, rel=0.05)


@pytest.mark.parametrize("effect", ["seal_friction", "moving_mass", "coil_lag"])
def test_a_recorded_effect_lowers_the_error_as_predicted(base_fit_of_plans, effect):
    """Twice the smallest size lowers the error of the fit by about four times what is needed."""
    weighting, base_fit = base_fit_of_plans
    (detectability,) = detectable_sizes(weighting, base_fit, [effect])
    values = scaled_effect(EFFECTS[effect], 2 * detectability.smallest_size)
    damper = Damper("bouc_wen", PARAMETERS, effects={effect: values})
    # The noise is that of the runs without the effect.
    runs = measure_plans(PLANS, damper, np.random.default_rng(4))
    recordings = [
        replace(prepare_recording(run), counted=other.counted) for run, other in zip(runs, weighting.recordings, strict=True)
    ]
    recorded = replace(weighting, recordings=recordings)
    base = Damper("bouc_wen", PARAMETERS)
    alone = refit(recorded.problem(base.model, base.theta), base.theta, recorded.folds)
    model, theta = with_effect(base.model, alone.theta, effect)
    for name, value in values.items():
        theta[model.names.index(f"{effect}.{name}")] = value
    both = refit(recorded.problem(model, theta), theta, recorded.folds)
    gain = float(alone.fold_costs.sum() - both.fold_costs.sum()) / ((THRESHOLDS.noise_chi_square - 1.0) * recorded.samples)
    assert 2.5 < gain < 6.5


@pytest.mark.parametrize(
    "effect",
    ["moving_mass", pytest.param("seal_friction", marks=pytest.mark.slow), pytest.param("coil_lag", marks=pytest.mark.slow)],
)
def test_from_the_smallest_size_on_a_diagnosis_names_an_effect(base_fit_of_plans, effect):
    (detectability,) = detectable_sizes(*base_fit_of_plans, [effect])
    alike = (effect, *EFFECTS[effect].confused_with)
    for factor, named, among in (1.2, [effect], ()), (0.3, [], alike):
        values = scaled_effect(EFFECTS[effect], factor * detectability.smallest_size)
        runs = measure_plans(PLANS, Damper("bouc_wen", PARAMETERS, effects={effect: values}), np.random.default_rng(5))
        assert [cause.effect for cause in diagnose(runs, "bouc_wen", effects=among).causes] == named, factor


def test_an_effect_with_which_the_model_diverges_shows(base_fit_of_plans, monkeypatch):
    effect = EFFECTS["moving_mass"]
    huge = replace(effect, parameters=(replace(effect.parameters[0], upper=1e200),))
    monkeypatch.setitem(EFFECTS, "moving_mass", huge)
    (detectability,) = detectable_sizes(*base_fit_of_plans, ["moving_mass"])
    assert detectability.remark == ""
    assert detectability.information.sum() == pytest.approx(1.0)


def test_the_smallest_detectable_size_is_said_in_the_scale_of_its_damper(monkeypatch):
    """A mass that is too large for a small damper is an ordinary one of a press."""
    press = replace(REFERENCE, force=20.0 * REFERENCE.force)
    size = 1.5 * EFFECTS["moving_mass"].parameters[0].upper
    model = find_model("bouc_wen", scales=press)
    comparison = SimpleNamespace(weighting=None, base=None, best=SimpleNamespace(problem=SimpleNamespace(model=model)))
    found = [Detectability("moving_mass", size, 1.0, np.ones(1))]
    monkeypatch.setattr(candidates, "detectable_sizes", lambda *_: found)
    monkeypatch.setattr(candidates, "detection_threshold", lambda *_: 1.0)
    monkeypatch.setattr(candidates.LinearisedRefit, "around", lambda *_: None)
    clause, _ = candidates._detectable(comparison, ["moving_mass"])["moving_mass"]
    assert format_quantity(size, "kg") in clause
