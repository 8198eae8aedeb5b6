"""A simulated damper with known values, of any size, and a test bench that records it."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from mrd_runs import Run, make_run
from mrd_sim.models import find_model
from mrd_sim.path import make_path

Array = NDArray[np.float64]

RATE = 1000.0
SHARES = (0.25, 0.5, 1.0)


@dataclass(frozen=True)
class SimulatedDamper:
    """A damper with viscosity, yield force per ampere, gas spring and seal friction, and the noise of its load cell in N."""

    force: float = 1000.0
    stroke: float = 0.02
    speed: float = 0.2
    current: float = 1.0
    gas_force: float = 80.0
    gas_stiffness: float = 1500.0
    drag: float = 20.0
    lag: float = 0.012
    falling: float = 0.4
    noise: float = 0.003
    model: str = "bingham"

    @property
    def viscous(self) -> float:
        """N s/m, a third of the force at full speed and current."""
        return self.force / (3.0 * self.speed)

    @property
    def yield_force(self) -> float:
        """N at the largest current."""
        return self.force / 1.5

    def resistance(self, speed: float | Array, current: float) -> float | Array:
        """Return the force in N of extension at a speed, without gas."""
        return self.viscous * speed + self.yield_force * current / self.current + self.drag

    def gas_spring(self, position: float) -> float:
        """Return the force in N of extension that the gas adds at a position in m."""
        rate = 0.3 / self.stroke / 2.2
        return self.gas_stiffness / (1.2 * rate) * (1.0 - (1.0 + rate * position) ** -1.2)

    def record(self, name: str, position: Array, current: Array, seed: int = 0) -> Run:
        """Record the damper along a motion in m at `RATE`, both with the noise of their sensors."""
        random = np.random.default_rng(seed)
        time = np.arange(len(position)) / RATE
        velocity = np.gradient(position, 1.0 / RATE)
        model = find_model(self.model, effects=["gas_spring", "seal_friction", "coil_lag"])
        values = {
            "yield_force": 0.0,
            "yield_force_per_A": self.yield_force / self.current,
            "creep_speed": 1e-3 * self.speed,
            "viscous": self.viscous,
            "viscous_per_A": 0.0,
            "offset": -self.gas_force,
            "coil_lag": 0.0,
            "coil_lag.lag": self.lag,
            "coil_lag.falling": self.falling,
            "gas_spring.stiffness": self.gas_stiffness,
            "gas_spring.curvature": 0.3 / self.stroke,
            "seal_friction.coulomb": self.drag,
            "seal_friction.stiction": 0.0,
            "seal_friction.presliding": 1e-3 * self.stroke,
        }
        # Not by `vector`, whose limits belong to the scales of recordings.
        theta = np.array([values.get(name, default) for name, default in zip(model.names, model.vector({}), strict=True)])
        force = model.force(theta, make_path(time, position, velocity, np.gradient(velocity, 1.0 / RATE), current))
        force = force + random.normal(0.0, self.noise * self.force, len(time))
        measured = position + random.normal(0.0, 1e-4 * self.stroke, len(time))
        sensed = current + random.normal(0.0, 2e-3 * self.current, len(time))
        columns = {"time_s": time, "position_m": measured, "current_A": sensed, "force_N": force}
        return make_run(name, columns, {"source": f"{name}.csv"})

    def sine(self, name: str, speed: float, current: float, cycles: int = 5, seed: int = 0) -> Run:
        """Record sines over the whole stroke with a peak speed in m/s."""
        amplitude = 0.5 * self.stroke
        time = np.arange(round(cycles * 2 * np.pi * amplitude / speed * RATE)) / RATE
        return self.record(name, amplitude * np.sin(speed / amplitude * time), np.full(len(time), current), seed)

    def triangle(self, name: str, speed: float, current: float | Array, cycles: float = 2.5, seed: int = 0) -> Run:
        """Record triangles over the whole stroke at a speed in m/s; the current in A may be a series that is repeated."""
        time = np.arange(round(cycles * 2 * self.stroke / speed * RATE)) / RATE
        position = self.stroke * np.abs((speed * time / self.stroke + 0.5) % 2 - 1) - 0.5 * self.stroke
        return self.record(name, -position, np.resize(current, len(time)), seed)

    def set(self) -> list[Run]:
        """Record sines of three speeds at three currents, slow triangles of two speeds, and current steps at two speeds."""
        runs = [
            self.sine(f"sine_{share:g}_{level:g}", share * self.speed, level * self.current, seed=7 * n + k)
            for n, share in enumerate(SHARES)
            for k, level in enumerate((0.0, 0.4, 1.0))
        ]
        runs += [
            self.triangle(f"slow_{share:g}", share * self.speed, 0.0, seed=31 + n) for n, share in enumerate((0.02, 0.04))
        ]
        return [*runs, self.steps()]

    def steps(self, share: float = 0.1, hold: float = 0.5) -> Run:
        """Record current steps between nothing and the largest current, at a share of the speed."""
        levels = np.repeat([0.0, self.current], round(hold * RATE))
        cycles = max(2.5, 80 * hold * share * self.speed / (2 * self.stroke))
        return self.triangle(f"steps_{share:g}", share * self.speed, levels, cycles, seed=41)

    def force_at_speed(self, direction: str, speed: float, current: float) -> tuple[float, float]:
        """Return the resisting force in N of the sines of `set` at a speed, and the force of the mean of both branches."""
        acts = current if self.model == "bingham" else 0.0
        resistance = (1.0 if direction == "rebound" else -1.0) * float(self.resistance(speed, acts))
        peaks = [share * self.speed for share in SHARES if 0.25 * share * self.speed <= speed <= 0.95 * share * self.speed]
        gas = [
            self.gas_spring(sign * 0.5 * self.stroke * float(np.sqrt(1.0 - (speed / peak) ** 2)))
            for peak in peaks
            for sign in (1.0, -1.0)
        ]
        return resistance, resistance - self.gas_force + float(np.mean(gas or [0.0]))

    def energy_of_sine(self, speed: float, current: float) -> float:
        """Return the energy in J that a sine over the whole stroke dissipates."""
        acts = current if self.model == "bingham" else 0.0
        friction = float(self.resistance(0.0, acts))
        return 0.5 * np.pi * self.viscous * speed * self.stroke + 2.0 * self.stroke * friction


@pytest.fixture(scope="session")
def simulated_damper() -> SimulatedDamper:
    """A damper of 1 kN with a stroke of 20 mm."""
    return SimulatedDamper()
