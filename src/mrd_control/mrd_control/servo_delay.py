"""Dead time and lag of the servo are fitted to the setpoints and the rod of a recorded run: they say how late the rod is.

Between a setpoint and the rod lies a dead time, over which the servo carries the setpoint on in a straight line. So at a
constant speed the dead time costs nothing; it shows where the speed changes. The rod lags behind what the servo follows.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares
from scipy.signal import lfilter

from mrd_base import InputError
from mrd_runs.bag import read_bag
from mrd_runs.blocks import decode_blocks
from mrd_runs.formats.bag_file import samples_topic

Array = NDArray[np.float64]

GUESS = (0.015, 0.003)
"""s, of dead time and lag, from which the fit starts."""
MOST = 0.1
"""s, up to which either is looked for."""
FEWEST = 200
"""Setpoints."""
CLEAR = 1e-3
"""s; a fit that is less certain of the dead time or the lag is refused."""


@dataclass(frozen=True)
class ServoDelay:
    """Dead time and lag of a servo.

    Attributes
    ----------
    delay, lag : float
        s; what `mrd_control.experiment.ControlExperiment` calls so.
    delay_error, lag_error : float
        Their standard errors in s, if all that is left of the rod's position is noise as it looks.
    error, left : float
        m rms: of the rod about the setpoints of the same time, and about the fit.
    """

    delay: float
    lag: float
    delay_error: float
    lag_error: float
    error: float
    left: float

    def yaml(self) -> str:
        """Return the lines for the file of a control experiment."""
        return f"delay_ms: {1e3 * self.delay:.1f}\nlag_ms: {1e3 * self.lag:.1f}\n"


def fit_servo_delay(setpoints: Array, time: Array, rod: Array) -> ServoDelay:
    """Fit dead time and first-order lag between setpoints and rod.

    Parameters
    ----------
    setpoints : ndarray (m, 4)
        Time in s, position in m, velocity in m/s and acceleration in m/s².
    time, rod : ndarray (n,)
        Equally spaced times in s, and the measured position in m. Offset and scale of the sensor are fitted as well.

    Raises
    ------
    InputError
        For too few setpoints, samples that are missing, or a motion that does not show dead time and lag.
    """
    stamps, position, velocity, acceleration = setpoints.T
    if len(stamps) < FEWEST:
        raise InputError(f"found {len(stamps)} setpoints, expected at least {FEWEST}; record a longer run")
    begin, end = stamps[0] + 2 * MOST, stamps[-1]
    kept = (time > begin) & (time < end)
    times, measured = time[kept], rod[kept]
    period = float(np.median(np.diff(times)))
    if np.diff(times).max() > 1.5 * period:
        raise InputError("samples are missing in the run; repeat it")
    motion = CubicHermiteSpline(stamps, position, velocity)
    speed = CubicHermiteSpline(stamps, velocity, acceleration)
    # The lag has forgotten where it began after some of its time constants.
    counted = slice(round(5 * MOST / period), None)

    def followed(delay: float, lag: float) -> Array:
        ago = times - delay
        target = motion(ago) + delay * speed(ago)
        left = np.exp(-period / lag) if lag > 1e-6 else 0.0
        share = lag / period * (1.0 - left)
        # Exact for a target that is linear between samples.
        start = [(share - left) * target[0] + left * target[0]]
        return np.asarray(lfilter([1.0 - share, share - left], [1.0, -left], target, zi=start)[0])

    def fitted(values: Array) -> Array:
        basis = np.stack([followed(*values), np.ones_like(times)], axis=1)[counted]
        return np.asarray(basis @ np.linalg.lstsq(basis, measured[counted], rcond=None)[0])

    found = least_squares(lambda values: fitted(values) - measured[counted], GUESS, bounds=(0.0, MOST), x_scale=1e-3)
    left = float(np.sqrt(np.mean(found.fun**2)))
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * left**2
    # Residuals are correlated; the number of independent ones follows from how often they change their sign.
    changes = int(np.count_nonzero(np.diff(np.signbit(found.fun - found.fun.mean()))))
    errors = np.sqrt(np.diag(covariance) * max(1.0, 0.5 * len(found.fun) / (changes + 1)))
    if not (errors < CLEAR).all():
        known = " and ".join(f"{1e3 * error:.2g}" for error in errors)
        raise InputError(
            f"the motion does not show dead time and lag: they are known to {known} ms, expected {1e3 * CLEAR:g} ms; record "
            "one whose speed changes more, such as characterise/01_multisine.yaml"
        )
    error = float(np.std(measured[counted] - motion(times[counted])))
    return ServoDelay(float(found.x[0]), float(found.x[1]), float(errors[0]), float(errors[1]), error, left)


def read_servo_delay(path: str | Path) -> ServoDelay:
    """Fit dead time and lag of the servo to a recorded run of the generator.

    Raises
    ------
    InputError
        For a bag that cannot be read or has no setpoints, and as `fit_servo_delay`.
    """
    bag = read_bag(path, ("samples", "setpoint"))
    topics = [name for name, topic in bag.topics.items() if name.rsplit("/", 1)[-1] == "setpoint" and topic.messages]
    if not topics:
        raise InputError(f"{path}: no topic setpoint with messages, expected the bag of a run of this bench")
    blocks = decode_blocks(bag.topics[samples_topic(bag, str(path))].messages, bag.types)
    zero = int(blocks.stamp[0])
    within = np.concatenate([np.arange(count) for count in blocks.count])
    time = 1e-9 * np.repeat(blocks.stamp - zero, blocks.count) + np.repeat(blocks.period, blocks.count) * within
    rows = [
        (1e-9 * (m.header.stamp.sec * 10**9 + m.header.stamp.nanosec - zero), m.position, m.velocity, m.acceleration)
        for m in bag.decode(topics[0])
    ]
    stamps = np.array(rows, np.float64).reshape(-1, 4)
    _, first = np.unique(stamps[:, 0], return_index=True)
    try:
        return fit_servo_delay(stamps[first], time, blocks.series["position"])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
