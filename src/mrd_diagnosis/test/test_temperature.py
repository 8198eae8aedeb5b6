"""A diagnosis of a damper whose fluid depends on its temperature, with and without a thermometer."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mrd_diagnosis import diagnose
from mrd_identification.needs import LEAST_TEMPERATURE_CHANGE, temperature_changes
from mrd_sim.damper import Damper
from mrd_sim.heating import Heating
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

EFFECTS = (
    "temperature_dependence",
    "thermal_fade",
    "settling",
    "load_cell_drift",
    "load_cell_gain",
    "gas_spring",
    "coil_lag",
)
SIZES = {"viscous": 0.02, "yield_force": 0.004}
EXPERIMENTS = (
    """
rod: {waveform: multisine, amplitude_mm: 14, lowest_hz: 0.3, highest_hz: 4, period_s: 10, rolloff: 1.2, seed: 0}
coil: {waveform: aprbs, low_mA: 0, high_mA: 300, shortest_s: 0.05, longest_s: 0.3, count: 8, seed: 1}""",
    """
rod: {waveform: triangle, amplitude_mm: 12, slope_mm_per_s: 60}
coil: {waveform: staircase, levels_mA: [0, 200, 400, 200], hold_s: 0.7}""",
    """
rod: {waveform: sine, amplitude_mm: 6, frequency_hz: 2.5}
coil: {waveform: prbs, low_mA: 50, high_mA: 350, bit_s: 0.1, order: 7, seed: 2}""",
)


@pytest.fixture(scope="module")
def runs():
    """Three runs during which a damper of little heat capacity warms up."""
    settings = read_settings(None)
    plans = [
        plan(
            parse_experiment(f"name: run{number}\nduration_s: 10\nrate_hz: 250{text}", f"run{number}"),
            settings.limits,
            settings.force_envelope,
        )
        for number, text in enumerate(EXPERIMENTS)
    ]
    damper = Damper("bouc_wen", {"yield_force": 60.0, "offset": -40.0}, effects={"temperature_dependence": SIZES})
    return measure_plans(plans, damper, np.random.default_rng(1), heating=Heating(heat_capacity=20.0))


def test_the_dependence_on_the_temperature_is_named_with_its_sizes(runs):
    temperatures = np.concatenate([run.temperature for run in runs])
    assert 20.0 < np.ptp(temperatures) < 60.0
    diagnosis = diagnose(runs, "bouc_wen", effects=EFFECTS)
    assert [cause.effect for cause in diagnosis.causes] == ["temperature_dependence"]
    (cause,) = diagnosis.causes
    for name, size in SIZES.items():
        found = cause.parameters[f"temperature_dependence.{name}"].value
        assert found.value == pytest.approx(size, rel=0.1)
    assert diagnosis.gap.closed_fraction.value > 0.9
    assert re.match(r"The viscous force falls by [12]\.\d+ ± 0\.\d+ % per K and the yield force by 0\.", diagnosis.sentence)


def test_without_a_temperature_that_changes_it_is_not_tried(runs):
    cold = [replace(run, temperature=None) for run in runs]
    steady = [replace(run, temperature=np.full(len(run), 300.0)) for run in runs]
    assert temperature_changes(runs)
    assert not temperature_changes([*runs[:2], cold[2]])
    assert not temperature_changes(steady)
    ramp = np.linspace(0.0, 1.1 * LEAST_TEMPERATURE_CHANGE, len(runs[0]))
    assert temperature_changes([replace(runs[0], temperature=300.0 + ramp)])
    diagnosis = diagnose(cold, "bouc_wen", effects=("temperature_dependence", "coil_lag"))
    reasons = {entry.effect: entry.why for entry in diagnosis.untestable}
    assert reasons == {"temperature_dependence": "no temperature of the damper that changes was recorded in every run"}
    assert diagnosis.verdict == "unknown_effect"
