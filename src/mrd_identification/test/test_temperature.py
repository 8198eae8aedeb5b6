"""Recovery of a fluid's dependence on its measured temperature."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_identification import identify
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_identification.uncertainty import uncertainty
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_sim.path import make_path

MODEL = find_model("bouc_wen", effects=["temperature_dependence"])
SIZES = ("temperature_dependence.viscous", "temperature_dependence.yield_force")
RATE, SECONDS = 200.0, 10.0
LINES = ((0.5, 6e-3), (1.5, 4e-3), (4.0, 3e-3))  # Hz, m


def drawn_parameters(rng):
    """Return parameters of a damper and of its fluid, from a wide range of both."""
    values = {
        "yield_force": rng.uniform(40.0, 150.0),
        "yield_force_per_A": rng.uniform(500.0, 1500.0),
        "yield_travel": rng.uniform(1e-4, 3e-4),
        "viscous": rng.uniform(500.0, 2000.0),
        "viscous_per_A": rng.uniform(500.0, 4000.0),
        "stiffness": rng.uniform(500.0, 2000.0),
        "offset": rng.uniform(-80.0, 80.0),
        "coil_lag": 0.0,
        SIZES[0]: rng.uniform(0.005, 0.03),
        SIZES[1]: rng.uniform(0.001, 0.006),
    }
    return MODEL.vector(values)


def record(theta, rng, share=0.02):
    """Return two runs during which a damper warms up from 20 °C to 60 °C, with noise on its force and temperature."""
    runs = []
    for name, start in (("cool", 293.15), ("warm", 313.15)):
        time = np.arange(int(RATE * SECONDS)) / RATE
        position, velocity, acceleration = np.zeros((3, len(time)))
        for frequency, amplitude in LINES:
            w, phase = 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi)
            position += amplitude * np.sin(w * time + phase)
            velocity += amplitude * w * np.cos(w * time + phase)
            acceleration -= amplitude * w**2 * np.sin(w * time + phase)
        current = np.repeat(rng.choice([0.0, 0.2, 0.5, 1.0], 40), len(time) // 40)
        temperature = start + 20.0 * time / SECONDS
        path = make_path(time, position, velocity, acceleration, current)
        force = MODEL.force(theta, replace(path, temperature=np.interp(np.cumsum(path.dt), time, temperature)))
        noise = share * np.std(force) * rng.standard_normal(len(time))
        read = temperature + rng.normal(0.0, 0.2, len(time))
        runs.append(Run(name, time, position, velocity, current, force + noise, temperature=read))
    return runs


def test_both_sizes_are_found_from_a_cold_start():
    rng = np.random.default_rng(1)
    theta = drawn_parameters(rng)
    fit = identify(
        record(theta, rng), "bouc_wen", effects=("temperature_dependence",), population=16, generations=8, seeds=1
    )
    estimates = {estimate.parameter.name: estimate for estimate in fit.estimates if estimate.parameter.name in SIZES}
    assert len(estimates) == 2
    for name, true in zip(SIZES, theta[[MODEL.names.index(name) for name in SIZES]], strict=True):
        assert abs(estimates[name].value - true) < 3 * (estimates[name].upper - estimates[name].lower) / 3.92
        assert estimates[name].upper - estimates[name].lower < 0.2 * true
    assert fit.pooled_fitted.nrmse == pytest.approx(0.02, rel=0.1)


def test_a_run_without_a_temperature_is_named():
    rng = np.random.default_rng(1)
    cool, warm = record(drawn_parameters(rng), rng)
    with pytest.raises(InputError, match=r"^warm has no temperature of the damper, which temperature_dependence needs"):
        identify([cool, replace(warm, temperature=None)], "bouc_wen", effects=("temperature_dependence",))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_intervals_cover_the_sizes_of_twenty_dampers():
    """Five recordings of each, so that the share is known to 2 %."""
    holds = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        theta = drawn_parameters(rng)
        for _ in range(5):
            problem, _ = make_problem(MODEL, [prepare_recording(run) for run in record(theta, rng)])
            estimate, _ = fit_least_squares(problem, problem.base)
            found = uncertainty(problem, estimate, profile=False)
            places = [problem.free.index(MODEL.names.index(name)) for name in SIZES]
            true = theta[list(problem.free)]
            holds.append([found.lower[place] <= true[place] <= found.upper[place] for place in places])
    assert 0.90 <= np.mean(holds) <= 0.99, np.mean(holds, axis=0)
