"""Recordings that several tests use."""

import numpy as np
import pytest

from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_sim.simulate import write_csv


@pytest.fixture
def recorded(tmp_path) -> list[str]:
    """Write three runs of a damper whose force sensor lags by 20 ms, and return their paths."""
    model = find_model("bingham", effects=["force_sensor_lag"])
    random = np.random.default_rng(1)
    time = np.arange(1500) / 250
    paths = []
    for name in ("a", "b", "c"):
        position, velocity, acceleration = np.zeros((3, len(time)))
        for frequency, amplitude in ((0.5, 9e-3), (1.5, 4e-3), (3.5, 1.2e-3)):
            w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
            position += amplitude * np.sin(w * time + phase)
            velocity += amplitude * w * np.cos(w * time + phase)
            acceleration -= amplitude * w**2 * np.sin(w * time + phase)
        current = np.repeat(random.choice([0.0, 0.1, 0.2, 0.3], len(time) // 50), 50)
        theta = model.vector({"force_sensor_lag.lag": 0.02, "coil_lag": 0.0})
        force = model.force(theta, make_path(time, position, velocity, acceleration, current))
        force += random.standard_normal(len(time))
        paths.append(str(tmp_path / f"{name}.csv"))
        write_csv(Run(name, time, position, velocity, current, force), paths[-1])
    return paths
