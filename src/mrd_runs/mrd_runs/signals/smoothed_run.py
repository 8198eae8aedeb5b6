"""A run with its smoothed signals, which every analysis uses: the motion, and the current without sensor noise."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mrd_runs.run import Run
from mrd_runs.signals.current import draw_current_noise, steady_current
from mrd_runs.signals.motion import Motion, remeasured_motion, smooth_motion

Array = NDArray[np.float64]

CURRENT_DRAWS = 12
"""Draws of the error of a current without sensor noise. With a few draws only, the variance at many a sample would come out
far too small."""


@dataclass(frozen=True, eq=False)
class Excess:
    """Force of a simulator of the user's own beyond the damper model that stands for it, near certain sizes of effects.

    Attributes
    ----------
    force : ndarray (n,)
        N.
    slopes : mapping
        For each parameter of effects on which it depends, by name: the value at which ``force`` was found, and the
        derivative (n,) there. Empty where no effect changes the simulator's motion or current.
    """

    force: Array
    slopes: Mapping[str, tuple[float, Array]] = field(default_factory=dict)

    def mapped(self, function: Callable[[Array], Array]) -> "Excess":
        """Return the excess with a linear function applied to its series."""
        return Excess(function(self.force), {name: (at, function(slope)) for name, (at, slope) in self.slopes.items()})


@dataclass(frozen=True, eq=False)
class SmoothedRun:
    """A run and its smoothed signals.

    Attributes
    ----------
    run : Run
        The measured signals.
    motion : Motion
        Smoothed position, velocity and acceleration.
    current : ndarray (n,)
        Measured current in A, without the noise of its sensor.
    excess : Excess or None
        Force at the samples of a simulator of the user's own beyond the damper model that stands for it; None without one.
    """

    run: Run
    motion: Motion
    current: Array
    excess: Excess | None = None

    @cached_property
    def current_errors(self) -> Array:
        """Draws (draws, n) of the error in A of ``current`` that the noise of the sensor leaves.

        They are the same whenever they are asked for, and kept, because removing the noise takes longer than a model.
        """
        errors = draw_current_noise(self.run.current, np.random.default_rng(0), CURRENT_DRAWS)
        if not errors.any():
            return errors
        return np.array([steady_current(self.current + error) - self.current for error in errors])


def smooth_run(run: Run) -> SmoothedRun:
    """Smooth the motion and the current of a run."""
    motion = smooth_motion(run.time, run.position, run.acceleration)
    return SmoothedRun(run, motion, steady_current(run.current))


def remeasure(smoothed: SmoothedRun, rng: np.random.Generator) -> SmoothedRun:
    """Return the run as if it were measured again: its smoothed motion and current with new sensor noise.

    The motion model of ``smoothed`` smooths the new readings. The force does not change.
    """
    run = smoothed.run
    position, acceleration, motion = remeasured_motion(run.time, smoothed.motion, run.acceleration, rng)
    measured = replace(
        run,
        position=position,
        velocity=motion.velocity,
        acceleration=acceleration,
        current=smoothed.current + draw_current_noise(run.current, rng, 1)[0],
    )
    return replace(smoothed, run=measured, motion=motion, current=steady_current(measured.current))


def exact_run(run: Run, acceleration: Array) -> SmoothedRun:
    """Return a run whose series are exact, as those of a simulated run are."""
    return SmoothedRun(run, Motion(run.position, run.velocity, acceleration, 0.0, 3, math.inf), run.current)
