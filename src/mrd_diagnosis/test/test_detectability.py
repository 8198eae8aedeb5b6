"""What recordings can tell of effects, on planned runs of which everything is known."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_diagnosis import diagnose
from mrd_diagnosis.detectability import coverage, largest_size, simulate_base_fit, sized
from mrd_diagnosis.effect_search import NO_GAP
from mrd_diagnosis.refit import refit
from mrd_diagnosis.weighting import with_effect
from mrd_identification.recording import prepare_recording
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

EXPERIMENT = "{{name: {}, duration_s: 6.0, rate_hz: 500.0, rod: {{waveform: {}}}, coil: {{waveform: {}}}}}"
PLANS = [
    plan(parse_experiment(EXPERIMENT.format(*of), of[0]), Limits(), ForceEnvelope())
    for of in (
        ("slow", "sine, amplitude_mm: 6.0, frequency_hz: 0.4", "constant, level_mA: 100.0"),
        ("switched", "sine, amplitude_mm: 5.0, frequency_hz: 1.1", "prbs, low_mA: 50.0, high_mA: 300.0, bit_s: 0.2"),
        ("fast", "sine, amplitude_mm: 4.0, frequency_hz: 4.0", "constant, level_mA: 0.0"),
    )
]
OWN = {"coil_lag": 0.0}


@pytest.fixture(scope="module")
def known():
    return simulate_base_fit(PLANS, Damper("bouc_wen", OWN), np.random.default_rng(0))


def test_what_the_model_takes_up_is_said(known):
    for found in coverage(*known, ["load_cell_gain", "current_sensor_error"]):
        assert found.smallest == np.inf
        assert found.remark == "the model's own parameters take it up"


def test_what_the_rod_never_reaches_does_not_show(known):
    (found,) = coverage(*known, ["end_stop"])  # beyond 8 mm from mid-stroke
    assert found.smallest == np.inf
    assert found.remark == "it does not act in these runs"
    assert not found.shares.any()


def test_more_than_plausible_may_be_needed(known):
    (found,) = coverage(*known, ["seal_friction"], needed=1e9)
    assert found.smallest == np.inf
    assert found.remark == "even the largest plausible size would not show"
    assert found.shares.sum() == pytest.approx(1.0)


def test_evidence_lies_in_the_runs_that_excite_an_effect(known):
    found = {each.effect: each for each in coverage(*known, ["coil_lag", "moving_mass", "seal_friction"])}
    assert found["coil_lag"].shares[1] > 0.95  # the only run in which the current changes
    assert found["moving_mass"].shares[2] > 0.5  # the fast one
    for each in found.values():
        assert each.remark == ""
        assert each.shares.sum() == pytest.approx(1.0)
        assert 0.0 < each.smallest < largest_size(EFFECTS[each.effect])


def test_twice_the_size_has_four_times_the_evidence(known):
    once, twice = (coverage(*known, ["moving_mass"], needed=needed)[0].smallest for needed in (1000.0, 4000.0))
    assert twice == pytest.approx(2 * once, rel=0.05)


@pytest.mark.parametrize("effect", ["seal_friction", "moving_mass", "coil_lag"])
def test_a_recorded_effect_shows_as_was_foreseen(known, effect):
    """Twice the smallest size lowers the error of the fit by about four times what is needed."""
    weighting, base_fit = known
    (found,) = coverage(weighting, base_fit, [effect])
    values = sized(EFFECTS[effect], 2 * found.smallest)
    damper = Damper("bouc_wen", OWN, effects={effect: values})
    # The floor is that of the runs without it.
    runs = measure_plans(PLANS, damper, np.random.default_rng(4))
    recordings = [
        replace(prepare_recording(run), counted=other.counted) for run, other in zip(runs, weighting.recordings, strict=True)
    ]
    recorded = replace(weighting, recordings=recordings)
    base = Damper("bouc_wen", OWN)
    alone = refit(recorded.problem(base.model, base.theta), base.theta, recorded.folds)
    model, theta = with_effect(base.model, alone.theta, effect)
    for name, value in values.items():
        theta[model.names.index(f"{effect}.{name}")] = value
    both = refit(recorded.problem(model, theta), theta, recorded.folds)
    gain = float(alone.cost.sum() - both.cost.sum()) / ((NO_GAP - 1.0) * recorded.samples)
    assert 2.5 < gain < 6.5


@pytest.mark.parametrize("effect", ["seal_friction", "moving_mass", "coil_lag"])
def test_from_the_smallest_size_on_a_diagnosis_names_an_effect(known, effect):
    (found,) = coverage(*known, [effect])
    for factor, named in (1.2, [effect]), (0.3, []):
        values = sized(EFFECTS[effect], factor * found.smallest)
        runs = measure_plans(PLANS, Damper("bouc_wen", OWN, effects={effect: values}), np.random.default_rng(5))
        assert [cause.effect for cause in diagnose(runs, "bouc_wen").causes] == named, factor
