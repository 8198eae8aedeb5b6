"""What a run of an emulated system costs: comfort, travel, contact, drift, energy, switching."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_control.linear import LinearSystem
from mrd_control.loop import LoopResult

Array = NDArray[np.float64]

METRICS = {
    "acceleration": ("acceleration, m/s²", 1.0),
    "weighted": ("weighted acceleration (ISO 2631-1), m/s²", 1.0),
    "travel": ("travel, mm", 1e3),
    "peak_travel": ("peak travel, mm", 1e3),
    "peak_share": ("peak travel, % of half a stroke", 100.0),
    "contact": ("tyre load, N", 1.0),
    "contact_share": ("tyre load, % of static", 100.0),
    "lift_off": ("lift-off, % of the time", 100.0),
    "drift": ("drift, mm", 1e3),
    "energy": ("power, W", 1.0),
    "switching": ("switching, 1/s", 1.0),
}
"""Title and factor of the metrics of a `Ride` that people read."""


@dataclass(frozen=True)
class DataSheet:
    """Data of a damper that the metrics need; by default of the RD-8040-1 at ambient temperature (LORD technical data).

    Attributes
    ----------
    stroke : float
        m, from end to end.
    coil_resistance : float
        Ohm.
    """

    stroke: float = 0.055
    coil_resistance: float = 5.0


@dataclass(frozen=True)
class Ride:
    """Metrics of a run, without its beginning.

    Attributes
    ----------
    acceleration : float
        rms acceleration of the mass whose ride counts, m/s².
    weighted : float
        The same with the weighting W_k, m/s².
    travel, peak_travel : float
        rms about the mean, and largest distance from mid-stroke, of the damper in m.
    peak_share : float
        The latter over half of the stroke: above 1 the damper would be at its end.
    contact : float
        rms dynamic contact force in N, of the tyre; nan without one.
    contact_share : float
        The same over the static force; nan without a contact.
    lift_off : float
        Share of the time in which the contact would have to pull, which a tyre cannot: the linear system is wrong there.
    drift, peak_drift : float
        Largest of the rms drifts, and largest drift, in m: storeys of a building, suspension of a car.
    energy : float
        Electrical energy of the coil in J per second, that is W.
    switching : float
        Rises of the commanded current through the middle of its range in the run, per second.
    """

    acceleration: float
    weighted: float
    travel: float
    peak_travel: float
    peak_share: float
    contact: float
    contact_share: float
    lift_off: float
    drift: float
    peak_drift: float
    energy: float
    switching: float


def ride_metrics(system: LinearSystem, result: LoopResult, damper: DataSheet, beginning: float = 2.0) -> Ride:
    """Return the metrics of a loop with a damper, without the first ``beginning`` s."""
    rate = 1.0 / float(result.time[1] - result.time[0])
    kept = slice(min(round(beginning * rate), len(result.time) - 2), None)
    n = len(system.mass)
    relative = result.state[kept, :n] - result.base[kept, :1]
    drifts = relative @ system.drifts.T
    contact = system.contact_stiffness * relative[:, system.lower]
    commanded = result.commanded[kept]
    high = commanded > 0.5 * (commanded.min() + commanded.max())
    seconds = len(commanded) / rate
    dynamic = float(np.std(contact)) if system.contact_stiffness else math.nan
    peak = float(np.abs(result.travel[kept]).max())
    return Ride(
        acceleration=float(np.std(result.acceleration[kept])),
        weighted=weighted_rms(result.acceleration[kept], rate),
        travel=float(np.std(result.travel[kept])),
        peak_travel=peak,
        peak_share=peak / (0.5 * damper.stroke),
        contact=dynamic,
        contact_share=dynamic / system.contact_load if system.contact_stiffness else math.nan,
        lift_off=float(np.mean(contact > system.contact_load)) if system.contact_stiffness else math.nan,
        drift=float(np.std(drifts, axis=0).max()),
        peak_drift=float(np.abs(drifts).max()),
        energy=float(damper.coil_resistance * np.mean(result.current[kept] ** 2)),
        switching=float(np.count_nonzero(high[1:] & ~high[:-1]) / seconds),
    )


def weighting_k(frequency: Array) -> Array:
    """Return the weighting W_k of ISO 2631-1 (1997) for vertical vibration, complex, at frequencies in Hz.

    Band limits 0.4 and 100 Hz (Butterworth), transition from acceleration to velocity at 12.5 Hz, upward step from 2.37 to
    3.35 Hz; annex A, table A.1.
    """
    s = 2j * math.pi * np.asarray(frequency, np.float64)
    low, high, transition, step_low, step_high = (2.0 * math.pi * f for f in (0.4, 100.0, 12.5, 2.37, 3.35))
    butterworth = math.sqrt(2.0)
    band = s**2 / (s**2 + butterworth * low * s + low**2) / (1.0 + butterworth * s / high + (s / high) ** 2)
    to_velocity = (1.0 + s / transition) / (1.0 + s / (0.63 * transition) + (s / transition) ** 2)
    upward = (1.0 + s / (0.91 * step_low) + (s / step_low) ** 2) / (1.0 + s / (0.91 * step_high) + (s / step_high) ** 2)
    return np.asarray(band * to_velocity * upward * (step_low / step_high) ** 2)


def weighted_rms(acceleration: Array, rate: float) -> float:
    """Return the rms of an acceleration (n,) at ``rate`` in Hz after the weighting W_k, in its unit.

    The weighting multiplies the spectrum; zeros as long as the run itself keep its end away from its beginning.
    """
    n = len(acceleration)
    spectrum = np.fft.rfft(acceleration - np.mean(acceleration), 2 * n)
    weighted = np.fft.irfft(spectrum * weighting_k(np.asarray(np.fft.rfftfreq(2 * n, 1.0 / rate), np.float64)), 2 * n)[:n]
    return float(np.sqrt(np.mean(weighted**2)))
