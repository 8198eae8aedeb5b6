"""Random models, parameters and motions that several tests draw from a seed."""

import numpy as np
import pytest


class Examples:
    """Examples from all over the bounds. A failing test names its seed and no arrays."""

    @staticmethod
    def values(rng, parameters, margin=0.0):
        """Parameter vector from anywhere in the bounds, ``margin`` away from them; many values lie on the margin."""
        shares = rng.random(len(parameters))
        shares = np.where(rng.random(len(shares)) < 0.3, np.round(shares), shares)
        return np.array([between(p, margin + (1 - 2 * margin) * share) for share, p in zip(shares, parameters, strict=True)])

    @staticmethod
    def motion(rng, cycles=2, samples=(12, 100, 500)):
        """Arguments of `two_tones`: 25 Hz to 8 kHz, up to 0.4 m/s, 0 to 2 A."""
        shape = {"cycles": cycles, "samples": int(rng.choice(samples)), "rate": rng.choice([25.0, 200.0, 1000.0, 8000.0])}
        names = ("speed", "share", "phase", "centre", "current", "later_current")
        drawn = rng.uniform((0.01, 0, 0, -0.005, 0, 0), (0.4, 0.9, 6.28, 0.005, 2, 2))
        return shape | dict(zip(names, drawn, strict=True))

    @staticmethod
    def two_tones(cycles, samples, rate, speed, share, phase, centre, current, later_current):
        """A sine with a third harmonic: minor loops, a stroke off mid-stroke, and a step of the current."""
        time = np.arange(cycles * samples + 1) / rate
        w = 2 * np.pi * rate / samples
        amplitude = min(speed / w, 0.02) / (1 + share)
        first, third = w * time, 3 * w * time + phase
        x = centre + amplitude * (np.sin(first) + share / 3 * np.sin(third))
        v = amplitude * w * (np.cos(first) + share * np.cos(third))
        a = -amplitude * w**2 * (np.sin(first) + 3 * share * np.sin(third))
        return time, x, v, a, np.where(time < 0.6 * time[-1], current, later_current)


def between(parameter, share):
    """Value at a share of the way from the lower to the upper bound."""
    if parameter.log:
        return parameter.lower * (parameter.upper / parameter.lower) ** share
    return parameter.lower + share * (parameter.upper - parameter.lower)


@pytest.fixture(scope="session")
def examples():
    """Random examples, see `Examples`."""
    return Examples
