"""Linear-quadratic optimal control of an emulated system: what the clipped-optimal laws share."""

from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are, solve_discrete_are

from mrd_control.linear import LinearSystem, propagate
from mrd_sim.parameter import Parameter
from mrd_trajectory.limits import LARGEST_CURRENT

Array = NDArray[np.float64]

DRIFT_WEIGHT = Parameter(
    "drift_weight", "1/s^4", 500.0, 1.0, 1e12, "of travel or drifts against acceleration, squared", log=True
)
CONTACT_WEIGHT = Parameter("contact_weight", "1/s^4", 5e3, 1.0, 1e12, "of the deflection of the tyre, squared", log=True)
FORCE_WEIGHT = Parameter("force_weight", "1/kg^2", 1e-7, 1e-14, 1.0, "of the force, squared", log=True, free=False)
HIGH_CURRENT = Parameter("high_current", "A", 0.3, 0.0, LARGEST_CURRENT, "current while the force is to rise")
WEIGHTS = (DRIFT_WEIGHT, CONTACT_WEIGHT, FORCE_WEIGHT)


def optimal_gains(values: Mapping[str, float], system: LinearSystem) -> Array:
    """Return the gains (2 n,) of the force, F = gains @ state, which minimise the mean of a quadratic cost.

    The cost is acceleration² + drift_weight Σ drifts² + contact_weight (lowest position)² + force_weight F², over states
    relative to the base. It solves the algebraic Riccati equation with a cross term, because the force is part of the
    acceleration.
    """
    n, order = len(system.mass), system.order
    acceleration = system.a[n + system.ride], system.b[n + system.ride, 2]
    rows, weights = [acceleration[0]], [1.0]
    for drift in system.drifts:
        rows.append(np.concatenate([drift, np.zeros(n)]))
        weights.append(values["drift_weight"])
    if system.contact_stiffness:
        rows.append(np.eye(order)[system.lower])
        weights.append(values["contact_weight"])
    c, q = np.stack(rows), np.diag(weights)
    d = np.zeros((len(rows), 1))
    d[0] = acceleration[1]
    r = d.T @ q @ d + values["force_weight"]
    cross = c.T @ q @ d
    b = system.b[:, 2:]
    riccati = solve_continuous_are(system.a, b, c.T @ q @ c, r, s=cross)
    return np.asarray(-np.linalg.solve(r, b.T @ riccati + cross.T)[0], np.float64)


def kalman_filter(system: LinearSystem, period: float, disturbance: float, travel_noise: float, noise: float) -> Array:
    """Return a stationary Kalman filter of the state relative to the base, from travel and acceleration of the damper's end.

    Parameters
    ----------
    system : LinearSystem
    period : float
        s between samples.
    disturbance : float
        One-sided density of what moves the base: velocity in (m/s)²/Hz, or acceleration in (m/s²)²/Hz.
    travel_noise, noise : float
        Of a sample: m and m/s² rms.

    Returns
    -------
    ndarray (2 n, 2 n + 5)
        By columns: transition, input of the force, gains of the two measurements; and in the first 2 n rows of the last two
        columns, how the state gives these. The direct part of the force in the acceleration is the same as in ``system``.
    """
    n, order = len(system.mass), system.order
    step = propagate(system.a, system.b[:, 2:], period)
    entry = np.zeros((order, 1))
    entry[n:] = -1.0
    if not system.base_accelerates:
        entry[:n], entry[n:] = -1.0, 0.0
    process = 0.5 * disturbance * period * entry @ entry.T
    measured = np.stack([system.outputs[3, :order], system.outputs[0, :order]])
    errors = np.diag([travel_noise**2, noise**2])
    covariance = solve_discrete_are(step.transition.T, measured.T, process + 1e-18 * np.eye(order), errors)
    gains = step.transition @ covariance @ measured.T @ np.linalg.inv(measured @ covariance @ measured.T + errors)
    return np.hstack([step.transition, step.before + step.after, gains, measured.T])


@njit(cache=True, nogil=True)
def clipped_current(high_current: float, demanded: float, force: float) -> float:
    """Return the current that brings the measured force nearer to the demanded one: Dyke et al. (1996), Eq. 13.

    High where the demanded force is the larger one of two in the same direction, else zero.
    """
    return high_current if (demanded - force) * force > 0.0 else 0.0
