"""Effects of real rigs that the catalogue does not have."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, shape, size

Array = NDArray[np.float64]

RATED = 0.025
"""Position in m at which the taper of the gap is given."""

EFFECTS = tuple(
    TrueEffect(name, title, parameters, in_catalogue=False, in_series=name == "air_bubble")
    for name, title, parameters in (
        (
            "frame_resonance",
            "Frame of the load cell rings with the force",
            (size("share", 0.3, 1.0), shape("frequency", 60.0, 120.0), shape("damping", 0.02, 0.06)),
        ),
        ("orifice_loss", "Turbulent loss in the gap, with the square of speed", (size("loss", 2500.0, 15e3),)),
        ("tapered_gap", "Yield force varies along the stroke", (size("taper", 0.2, 0.8, signed=True),)),
        ("field_stiffness", "Current makes the fluid elastic", (size("stiffness", 4000.0, 24e3),)),
        (
            "air_bubble",
            "Bubble that only compression meets, ever stiffer",
            (size("volume", 2e-4, 1.2e-3), shape("pressure", 100.0, 300.0, logarithmic=True)),
        ),
        (
            "supply_ripple",
            "Current ripples faster than its sensor shows",
            (size("share", 0.03, 0.2), shape("frequency", 12.0, 38.0)),
        ),
        (
            "thixotropy",
            "Fluid weakens as it is sheared and recovers at rest",
            (
                size("weakening", 0.2, 0.6),
                shape("recovery", 0.5, 3.0, logarithmic=True),
                shape("travel", 0.02, 0.1, logarithmic=True),
            ),
        ),
        ("sensor_stiction", "Core of the position transducer sticks to its housing", (size("slack", 5e-5, 4e-4),)),
        (
            "guide_waviness",
            "Rod rides over a wavy guide",
            (size("amplitude", 12.0, 60.0), shape("length", 2.5e-3, 8e-3), shape("phase", -3.1, 3.1)),
        ),
        ("cell_overload", "Load cell bends against its overload stop", (size("overload", 0.0015, 0.006),)),
    )
)
"""The volume of a bubble is divided by the piston's area (m) and its pressure is a force (N); the overload of a load cell is
one over its largest reading (1/N)."""


@njit(cache=True, nogil=True)
def taper_factor(p: PlantValues, x: float) -> float:
    """Return the yield force over that at mid-stroke; it is never negative."""
    return max(1.0 + p.tapered_gap_taper * x / RATED, 0.05)


@njit(cache=True, nogil=True)
def bubble_compression(p: PlantValues, force: float) -> float:
    """Return the travel (m, at most 0) by which a bubble of isothermal gas gives way to a compressing force."""
    if p.air_bubble_volume == 0.0 or force >= 0.0:
        return 0.0
    return p.air_bubble_volume * force / (p.air_bubble_pressure - force)


@njit(cache=True, nogil=True)
def rebuilt_structure(p: PlantValues, structure: float, dx: float, step: float) -> float:
    """Return the structure (0 to 1) of the fluid after a step: time builds it up, travel breaks it down."""
    building, breaking = step / p.thixotropy_recovery, abs(dx) / p.thixotropy_travel
    return (structure + building) / (1.0 + building + breaking)


@njit(cache=True, nogil=True)
def sticking_reading(position: Array, slack: float) -> Array:
    """Return the reading of a transducer whose core moves only once its slack is taken up."""
    reading = np.empty_like(position)
    core = position[0]
    for i in range(len(position)):
        core = min(max(core, position[i] - 0.5 * slack), position[i] + 0.5 * slack)
        reading[i] = core
    return reading


def ringing_force(share: float, frequency: float, damping: float, force: Array, step: float) -> Array:
    """Return the force when a ringing frame carries a share of it; a steady force passes unchanged."""
    if share == 0.0:
        return force
    w = 2 * np.pi * frequency
    b, a, _ = cont2discrete(([w * w], [1.0, 2 * damping * w, w * w]), step, method="foh")
    numerator = np.ravel(b)
    carried, _ = lfilter(numerator, a, force, zi=lfilter_zi(numerator, a) * force[0])
    return np.asarray(force + share * (carried - force))


def overloaded_reading(overload: float, force: Array) -> Array:
    """Return the reading of a load cell that stiffens with its load and shows hardly more than 1/overload (N)."""
    return np.asarray(force / np.sqrt(np.sqrt(1.0 + (overload * force) ** 4)))
