"""A simulator of the user's own, as the bench sees it: a force in answer to a motion and a current."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType, TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.signals.smoothed_run import SmoothedRun

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Signals:
    """What a simulator answers to: equally long series (n,) in SI units.

    Attributes
    ----------
    time, position, velocity, acceleration, current : ndarray (n,)
        s, m, m/s, m/s², A. The motion is that of the rod; position > 0 extends the damper.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    current: Array

    def __len__(self) -> int:
        return len(self.time)

    def rows(self) -> Array:
        """Return the series as one array (5, n), in the order of the attributes."""
        return np.ascontiguousarray([self.time, self.position, self.velocity, self.acceleration, self.current], np.float64)


@dataclass(frozen=True)
class SimulatorParameter:
    """A number of a simulator that may be changed; its unit as the simulator states it, its bounds where it has any."""

    name: str
    value: float
    lower: float = -np.inf
    upper: float = np.inf
    unit: str = ""


class Simulator(ABC):
    """A simulator.

    Attributes
    ----------
    name : str
        Short name for reports.
    source : str
        What opens it, as on the command line (`mrd_sim.simulators.opening.open_simulator`).
    parameters : mapping
        What may be changed, by name.
    values : mapping
        What was changed, by name.
    answers_anew : bool
        Whether it answers to any motion; recordings answer to their own only.
    notes : tuple of str
        What is to be known of how it is asked, such as which variables are which signals.
    limitations : tuple of str
        What it does not take into account, such as the current; each ends with what to do.
    """

    name: str
    source: str
    parameters: Mapping[str, SimulatorParameter]
    values: Mapping[str, float] = MappingProxyType({})
    answers_anew: bool = True
    notes: tuple[str, ...] = ()
    limitations: tuple[str, ...] = ()

    @abstractmethod
    def force(self, signals: Signals, values: Mapping[str, float] | None = None) -> Array:
        """Return the force (n,) in N from rest; > 0 resists extension.

        Parameters
        ----------
        signals : Signals
        values : mapping, optional
            Parameters by name; the others keep their value.

        Raises
        ------
        InputError
            When the simulator fails, takes too long, or answers with something else than a finite force for each sample.
        """

    def close(self) -> None:  # noqa: B027, most have nothing to end
        """End whatever runs for the simulator."""

    def reopen(self) -> None:  # noqa: B027
        """Start what runs for the simulator once more, where it has ended."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def signals_of(smoothed: SmoothedRun) -> Signals:
    """Return the smoothed motion and the current of a run."""
    motion = smoothed.motion
    return Signals(smoothed.run.time, motion.position, motion.velocity, motion.acceleration, smoothed.current)


def checked_force(force: Array, samples: int, name: str) -> Array:
    """Return a simulator's answer, if it is a finite force for each sample.

    Raises
    ------
    InputError
        When it is not; names the simulator and the first sample.
    """
    if force.shape != (samples,):
        shape = " x ".join(map(str, force.shape)) or "1"
        raise InputError(f"simulator {name}: found {shape} forces for {samples} samples, expected one for each")
    wrong = np.flatnonzero(~np.isfinite(force))
    if len(wrong):
        raise InputError(
            f"simulator {name}: the force at sample {wrong[0]} of {samples} is {force[wrong[0]]}, expected a finite number; "
            "it diverges there, or divides by zero"
        )
    return force
