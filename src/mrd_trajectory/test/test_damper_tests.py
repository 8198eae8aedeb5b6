"""Damper tests: what they expand to, that it keeps the limits of a bench of any size, and what they refuse."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_trajectory.damper_tests import DAMPER_TESTS, damper_test_table
from mrd_trajectory.damper_tests.endurance import peak_force_change
from mrd_trajectory.experiment import Experiment, parse_experiment, read_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import GeneratorSettings, read_settings
from mrd_trajectory.steps import experiments_of, is_damper_test, read_experiments, read_step
from mrd_trajectory.waveforms import Sine, Staircase, Triangle

CONFIG = Path(__file__).parents[3] / "config"
BENCH = read_settings(CONFIG / "bench.yaml")
REQUIRED = {"endurance": {"cycles": 50, "every": 20}}


def write(folder: Path, test: str, **fields: Any) -> Path:
    path = folder / "t.yaml"
    path.write_text(yaml.safe_dump({"name": "t", "test": test, **REQUIRED.get(test, {}), **fields}))
    return path


def expand(folder: Path, test: str, bench: GeneratorSettings = BENCH, **fields: Any) -> list[Experiment]:
    return list(read_experiments(write(folder, test, **fields), bench))


@st.composite
def benches(draw: st.DrawFn) -> GeneratorSettings:
    """Draw benches of 5 N to 400 kN and 1 mm to 0.5 m, with dampers that use a part of the force at rest."""

    def decades(lower: float, upper: float) -> float:
        return 10 ** draw(st.floats(math.log10(lower), math.log10(upper)))

    stroke, force = decades(1e-3, 0.5), decades(5, 4e5)
    speed = stroke * decades(0.2, 20)  # from a fifth of the stroke in a second to twenty of them
    acceleration = max(0.01, speed**2 / stroke * decades(0.1, 30))
    jerk = max(0.1, acceleration**2 / speed * decades(0.1, 10))
    current = decades(0.01, 10)
    limits = Limits(
        stroke, draw(st.floats(0, 0.1)) * stroke, speed, min(acceleration, 200), min(jerk, 1e6), force, 0.0, current
    )
    envelope = ForceEnvelope(
        offset=draw(st.floats(0, 0.3)) * force,
        yield_force=draw(st.floats(0, 0.4)) * force,
        yield_slope=force / current * decades(0.1, 10),
        viscosity=force / speed * decades(0.03, 3),
        viscosity_slope=force / speed / current * decades(0.03, 3),
    )
    return GeneratorSettings(setpoint_rate=100.0, limits=limits, force_envelope=envelope)


@pytest.mark.parametrize("test", DAMPER_TESTS)
@settings(max_examples=15)  # a plan of many turns takes a tenth of a second
@given(bench=benches())
def test_what_a_test_chooses_keeps_the_limits_of_any_bench(test: str, bench: GeneratorSettings) -> None:
    step = DAMPER_TESTS[test](name="t", **REQUIRED.get(test, {}))
    experiments = experiments_of(step, bench)
    assert len({one.name for one in experiments}) == len(experiments)
    for experiment in experiments:
        peaks = plan(experiment, bench.limits, bench.force_envelope).peaks
        assert all(peak.value <= peak.limit * (1 + 1e-6) for peak in peaks if peak.quantity != "least current")
        amplitude = experiment.rod.amplitude
        assert amplitude > 0.05 * bench.limits.reach or test == "speed_sweep"
