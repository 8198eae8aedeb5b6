"""The linear part of an emulated mechanical system: its matrices, its exact propagation, its response to white noise."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_lyapunov

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Masses with springs and dashpots on a moving base, and the place of the damper between two of them.

    The state (2 n,) holds the positions of the masses and then their velocities, both absolute, from static equilibrium. The
    base gives position and velocity, the damper its force; F > 0 resists extension (`docs/glossary.md`).

    Attributes
    ----------
    mass : ndarray (n,)
        kg.
    stiffness, damping : ndarray (n, n)
        N/m and N s/m, without the damper.
    base_stiffness, base_damping : ndarray (n,)
        Force on each mass per position (N/m) and per velocity (N s/m) of the base.
    upper : int
        Mass at the upper end of the damper.
    lower : int
        Mass at its lower end; -1 for the base.
    ride : int
        Mass whose acceleration counts.
    drifts : ndarray (d, n)
        Differences of position that must stay small, by the positions of the masses relative to the base.
    lever_ratio : float
        Travel of the damper over that between its two ends; the force on the masses is as much larger.
    contact_stiffness : float
        N/m, of the spring between lowest mass and base whose force holds the contact (a tyre); 0 where there is none.
    contact_load : float
        N, static force of the contact, at which it lifts off when the spring pulls as much.
    base_accelerates : bool
        Whether the disturbance is the acceleration of the base (ground motion), not its velocity (a road). Feedback of the
        state is then of velocities relative to the base.
    """

    mass: Array
    stiffness: Array
    damping: Array
    base_stiffness: Array
    base_damping: Array
    upper: int
    lower: int
    ride: int
    drifts: Array
    lever_ratio: float = 1.0
    contact_stiffness: float = 0.0
    contact_load: float = 0.0
    base_accelerates: bool = False

    @property
    def order(self) -> int:
        """Length of the state."""
        return 2 * len(self.mass)

    @cached_property
    def a(self) -> Array:
        """Matrix (2 n, 2 n) of x' = a x + b u."""
        n = len(self.mass)
        per_mass = 1.0 / self.mass[:, None]
        return np.block([[np.zeros((n, n)), np.eye(n)], [-per_mass * self.stiffness, -per_mass * self.damping]])

    @cached_property
    def b(self) -> Array:
        """Matrix (2 n, 3) of the inputs: position and velocity of the base, force of the damper."""
        n = len(self.mass)
        b = np.zeros((2 * n, 3))
        b[n:, 0] = self.base_stiffness / self.mass
        b[n:, 1] = self.base_damping / self.mass
        b[n + self.upper, 2] = -self.lever_ratio / self.mass[self.upper]
        if self.lower >= 0:
            b[n + self.lower, 2] = self.lever_ratio / self.mass[self.lower]
        return b

    @cached_property
    def outputs(self) -> Array:
        """Matrix (6, 2 n + 3) by which state and inputs give what a law sees.

        The rows are the acceleration of the upper end of the damper, the velocities of its upper and lower end, and travel,
        speed and acceleration of the damper.
        """
        n = len(self.mass)
        derivative = np.hstack([self.a, self.b])
        state = np.hstack([np.eye(2 * n), np.zeros((2 * n, 3))])
        base = np.zeros((2, 2 * n + 3))
        base[0, 2 * n], base[1, 2 * n + 1] = 1.0, 1.0
        low = (state[self.lower], state[n + self.lower], derivative[n + self.lower])
        position, velocity, acceleration = (base[0], base[1], 0 * base[0]) if self.lower < 0 else low
        return np.stack(
            [
                derivative[n + self.upper],
                state[n + self.upper],
                velocity,
                self.lever_ratio * (state[self.upper] - position),
                self.lever_ratio * (state[n + self.upper] - velocity),
                self.lever_ratio * (derivative[n + self.upper] - acceleration),
            ]
        )

    def with_linear_damper(self, viscous: float, stiffness: float = 0.0) -> Array:
        """Return the matrix (2 n, 2 n) of the system with a linear damper in N s/m and a spring in N/m in its place."""
        order = self.order
        return self.a + np.outer(self.b[:, 2], stiffness * self.outputs[3, :order] + viscous * self.outputs[4, :order])


@dataclass(frozen=True, eq=False)
class Propagation:
    """Exact step of a linear system over which its inputs are linear in time (first-order hold).

    x(t + period) = transition x + before u(t) + after u(t + period).

    Attributes
    ----------
    transition : ndarray (m, m)
    before, after : ndarray (m, inputs)
    """

    transition: Array
    before: Array
    after: Array


def propagate(a: Array, b: Array, period: float) -> Propagation:
    """Return the exact step of x' = a x + b u over ``period`` in s.

    One matrix exponential gives it: that of the system extended by its inputs and their slope (Van Loan, 1978).
    """
    m, inputs = b.shape
    extended = np.zeros((m + 2 * inputs, m + 2 * inputs))
    extended[:m, :m] = a * period
    extended[:m, m : m + inputs] = b * period
    extended[m : m + inputs, m + inputs :] = np.eye(inputs)
    exponential = expm(extended)
    held, ramp = exponential[:m, m : m + inputs], exponential[:m, m + inputs :]
    return Propagation(exponential[:m, :m], held - ramp, ramp)


def stationary_covariance(system: LinearSystem, viscous: float, velocity_psd: float) -> Array:
    """Return the covariance (2 n, 2 n) of the state with a linear damper on a base whose velocity is white noise.

    Positions are relative to the base here. The covariance solves the Lyapunov equation.

    Parameters
    ----------
    system : LinearSystem
        Without dashpots on the base: white velocity would give these infinite power.
    viscous : float
        Of the damper, N s/m.
    velocity_psd : float
        One-sided power spectral density of the velocity of the base in (m/s)²/Hz: (2 π n0)² G_d(n0) v on a road.
    """
    n = len(system.mass)
    noise = np.zeros((2 * n, 1))
    noise[:n] = -1.0
    # A one-sided density S is the intensity S / 2 of a two-sided one.
    return np.asarray(
        solve_continuous_lyapunov(system.with_linear_damper(viscous), -0.5 * velocity_psd * noise @ noise.T), np.float64
    )
