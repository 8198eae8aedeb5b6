"""The benchmark problem of real-time hybrid simulation, for its table in docs/control.md, which control.py writes.

The building, the hydraulic actuator, the specimen, their spread and the noise are those of the benchmark problem (Silva et
al., Mech. Syst. Signal Process. 135 (2020) 106381). The inverse of third order of the nominal actuator is what adaptive
model-based compensation begins with; here it does not learn.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import cont2discrete
from sections import table

from mrd_control.excitations import GroundMotion
from mrd_control.prediction import find_predictor
from mrd_control.tracking import Tracking, tracking

Array = NDArray[np.float64]
Prediction = Callable[[Any, Any, Any, Any, Any, Any], float]

RATE = 4096.0
DURATION = 40.0
PLANTS = 20
"""Plants whose parameters are drawn."""

STOREY_MASS, DAMPING_RATIO = 1000.0, 0.05
STIFFNESS = 1e7 * np.array([[2.6055, -2.3134, 0.5937], [-2.3134, 3.2561, -1.4420], [0.5937, -1.4420, 0.9267]])
POSITION_NOISE, FORCE_NOISE = np.sqrt(6.25e-14 * RATE), np.sqrt(1.16e-3 * RATE)
"""m and N rms."""
GROUND = GroundMotion(peak=1.7, seed=1)


@dataclass(frozen=True)
class Transfer:
    """Hydraulic actuator and specimen; nominal values of the benchmark problem."""

    servo_gain: float = 2.13e13
    piston: float = 4.23e6
    leakage: float = 3.3
    valve_damping: float = 425.0
    valve_stiffness: float = 1e5
    mass: float = 29.1
    damping: float = 114.6
    stiffness: float = 1.19e6

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Transfer":
        """Draw the parameters that the benchmark problem leaves uncertain."""
        return cls(
            leakage=rng.normal(3.3, 1.3),
            valve_damping=rng.normal(425.0, 3.3),
            valve_stiffness=rng.normal(1e5, 3.3e3),
            stiffness=rng.normal(1.19e6, 5e4),
        )

    @property
    def matrices(self) -> tuple[Array, Array]:
        """Matrices (5, 5) and (5, 1) for valve, its rate, force, position and speed under a commanded position."""
        a, b = np.zeros((5, 5)), np.zeros((5, 1))
        a[0, 1] = a[3, 4] = 1.0
        a[1] = [-self.valve_stiffness, -self.valve_damping, 0.0, -self.servo_gain, 0.0]
        b[1] = self.servo_gain
        a[2] = [1.0, 0.0, -self.leakage, 0.0, -self.piston]
        a[4, 2:] = np.array([1.0, -self.stiffness, -self.damping]) / self.mass
        return a, b

    @property
    def denominator(self) -> Array:
        """Coefficients of 1, s, s², s³ of the transfer from position to command, without the specimen."""
        valve = np.array([self.valve_stiffness, self.valve_damping, 1.0])
        piston = np.array([self.leakage, 1.0 + self.piston])
        closed = np.convolve(valve, piston)
        closed[0] += self.servo_gain
        return closed / self.servo_gain


NOMINAL = Transfer()


@njit(cache=True, nogil=True)
def inverse_command(
    parameters: Array, memory: Array, position: float, velocity: float, acceleration: float, measured: float
) -> float:
    """Command the wanted position and its backward differences, weighted by ``parameters`` (4,); ``memory`` holds the last
    three wanted positions.
    """
    a, b, c = memory[0], memory[1], memory[2]
    memory[0], memory[1], memory[2] = position, a, b
    first, second, third = position - a, position - 2.0 * a + b, position - 3.0 * a + 3.0 * b - c
    command = parameters[0] * position + parameters[1] * first * RATE
    return float(command + parameters[2] * second * RATE**2 + parameters[3] * third * RATE**3)


def inverse() -> tuple[Prediction, Array, Array]:
    """Return the inverse of third order of the nominal actuator."""
    return inverse_command, NOMINAL.denominator, np.zeros(3)


def ours(name: str) -> tuple[Prediction, Array, Array]:
    """Return a predictor of the catalogue, prepared for the delay of the nominal plant at low frequencies."""
    predictor = find_predictor(name)
    return predictor.kernel, *predictor.prepare(1.0 / RATE, delay(NOMINAL))


def delay(transfer: Transfer) -> float:
    """Return the delay in s of a plant at low frequencies."""
    a, b = transfer.matrices
    frequency = 2.0 * np.pi * 0.5
    response = np.linalg.solve(1j * frequency * np.eye(5) - a, b)[3, 0]
    return float(-np.angle(response) / frequency)


def building(transfer: Transfer) -> tuple[Array, Array]:
    """Return the matrices (6, 6) and (6, 2) of the building without the specimen, under ground acceleration and force."""
    mass = STOREY_MASS * np.eye(3)
    squares, shapes = np.linalg.eigh(STIFFNESS / STOREY_MASS)
    damping = STOREY_MASS * shapes @ np.diag(2.0 * DAMPING_RATIO * np.sqrt(squares)) @ shapes.T
    first = np.zeros((3, 3))
    first[0, 0] = 1.0
    rest, c, k = mass - transfer.mass * first, damping - transfer.damping * first, STIFFNESS - transfer.stiffness * first
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(rest, k), -np.linalg.solve(rest, c)]])
    b = np.zeros((6, 2))
    b[3:] = -np.linalg.solve(rest, np.stack([mass.sum(axis=1), first[0]], axis=1))
    return a, b


@njit(nogil=True)
def _run(
    predict: Any,
    parameters: Array,
    memory: Array,
    storeys: tuple[Array, Array],
    actuator: tuple[Array, Array],
    ground: Array,
    noise: Array,
) -> tuple[Array, Array]:
    """Return the wanted and the true position (n,) in m."""
    wanted, rod = np.empty(len(ground)), np.empty(len(ground))
    state, plant, speed = np.zeros(6), np.zeros(5), 0.0
    for k in range(len(ground)):
        wanted[k], rod[k] = state[0], plant[3]
        if not abs(wanted[k]) < 1.0:  # the loop is unstable
            wanted[k:] = rod[k:] = np.nan
            break
        acceleration, speed = (state[3] - speed) * RATE, state[3]
        command = predict(parameters, memory, state[0], state[3], acceleration, plant[3] + noise[0, k])
        inputs = np.array([ground[k], plant[2] + noise[1, k]])
        state = storeys[0] @ state + storeys[1] @ inputs
        plant = actuator[0] @ plant + actuator[1] @ np.array([command])
    return wanted, rod


def follow(compensation: tuple[Prediction, Array, Array], transfer: Transfer, ground: Array, seed: int) -> Tracking | None:
    """Run the building on a plant; return the tracking of the true position, or None where the loop is unstable."""
    storeys, actuator = (discrete(*matrices) for matrices in (building(transfer), transfer.matrices))
    noise = np.random.default_rng(seed).normal(size=(2, len(ground))) * [[POSITION_NOISE], [FORCE_NOISE]]
    wanted, rod = _run(*compensation, storeys, actuator, ground, noise)
    return tracking(wanted, rod, 1.0 / RATE) if np.isfinite(wanted).all() else None


def discrete(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the matrices of a linear system from sample to sample, its inputs held."""
    a, b, *_ = cont2discrete((a, b, np.eye(len(a)), np.zeros_like(b)), 1.0 / RATE)
    return np.ascontiguousarray(a), np.ascontiguousarray(b)


def benchmark_problem() -> str:
    """Return delay, NRMS and peak of each compensation on the nominal plant and on drawn ones."""
    ground = np.gradient(GROUND.base(int(DURATION * RATE), RATE)[:, 1], 1.0 / RATE)
    rng = np.random.default_rng(1)
    drawn = [Transfer.drawn(rng) for _ in range(PLANTS)]
    ways: dict[str, Callable[[], tuple[Prediction, Array, Array]]] = {
        "none": partial(ours, "none"),
        "inverse of the nominal actuator": inverse,
        "polynomial": partial(ours, "polynomial"),
        "adaptive": partial(ours, "adaptive"),
    }
    rows = []
    for name, way in ways.items():
        nominal, *others = (follow(way(), transfer, ground, seed) for seed, transfer in enumerate((NOMINAL, *drawn)))
        if nominal is None:
            rows.append([name, "unstable", "", "", ""])
            continue
        values = f"{1e3 * nominal.delay:.2f}", f"{100 * nominal.nrms:.2f}", f"{100 * nominal.peak:.2f}"
        nrms = [100.0 * one.nrms for one in others if one]
        rows.append([name, *values, f"{np.mean(nrms):.2f} ± {np.std(nrms):.2f}" if len(nrms) == PLANTS else "unstable"])
    return table(
        ("compensation", "delay (J1), ms", "NRMS (J2), %", "peak (J3), %", f"NRMS of {PLANTS} drawn plants, %"), rows
    )
