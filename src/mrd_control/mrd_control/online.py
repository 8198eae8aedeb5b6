"""The loop of a hybrid test on the bench: from blocks of samples to setpoints, with the controller of the offline twin."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_control.controller import Controller
from mrd_control.experiment import ControlExperiment
from mrd_control.laws.law import Signals

Array = NDArray[np.float64]

MEMORY = 0.5
"""s, over which the work of the damper is summed up: a leak with this time constant."""
_TRAVEL = Signals._fields.index("travel")


@dataclass(frozen=True, eq=False)
class Cycle:
    """What the controller made of a block of n samples.

    Attributes
    ----------
    time : float
        Bench time in s at which the setpoint holds: one sampling period after the last sample.
    position, velocity, acceleration : float
        Motion to command then, in m, m/s and m/s².
    current : float
        Coil current to command from now on, A.
    states : ndarray (n, 2 N)
        State of the emulated system at the samples.
    travel, command, commanded : ndarray (n,)
        Travel wanted at the samples and position commanded for one period later, in m; current commanded, in A.
    work : float
        Work in J that the emulated system has lately done on the damper (`MEMORY`). A damper only takes; where this falls
        below zero by more than the damper can store, the late rod feeds the loop: it is becoming unstable (the passivity
        observer of Hannaford & Ryu, IEEE Trans. Robot. Autom. 18 (2002) 1).
    power : float
        Mean power in W that the rod puts into the damper over the block.
    done : bool
        Whether this is the end of the run.
    """

    time: float
    position: float
    velocity: float
    acceleration: float
    current: float
    states: Array
    travel: Array
    command: Array
    commanded: Array
    work: float
    power: float
    done: bool


class OnlineLoop:
    """Advances the emulated system by measured forces, sample by sample.

    Parameters
    ----------
    experiment : ControlExperiment

    Attributes
    ----------
    samples : int
        Cycles of the law so far.
    """

    def __init__(self, experiment: ControlExperiment) -> None:
        self.samples = 0
        self._experiment = experiment
        self._base = np.vstack([experiment.base, experiment.base[-1:]])
        self._controller = Controller(
            experiment.system.linear(),
            experiment.damper,
            experiment.control_law,
            experiment.rate,
            experiment.actuator,
            experiment.gains,
            experiment.most_current,
        )
        self._command = 0.0  # m, the latest
        self._rod = math.nan
        self._work, self._left = 0.0, math.exp(-1.0 / (experiment.rate * MEMORY))

    def add_block(self, time: float, period: float, force: Array, rod: Array) -> Cycle:
        """Take a block of samples and return what to command.

        Parameters
        ----------
        time : float
            Bench time in s of the first sample.
        period : float
            s between samples.
        force, rod : ndarray (n,)
            Measured force in N and position of the rod in m.

        Raises
        ------
        InputError
            For samples at another rate, a block that is longer than a cycle, or a value that is no number.
        """
        experiment = self._experiment
        if abs(period * experiment.rate - 1.0) > 1e-6:
            raise InputError(f"samples come at {1 / period:g} Hz, expected {experiment.rate:g} Hz; set the rate of the daq")
        if len(force) * period > experiment.cycle * (1.0 + 1e-6):
            raise InputError(
                f"samples come in blocks of {1e3 * len(force) * period:g} ms, expected at most the cycle of "
                f"{1e3 * experiment.cycle:g} ms; start the daq with a smaller block_ms"
            )
        if not (np.isfinite(force).all() and np.isfinite(rod).all()):
            raise InputError("a measured force or position is no number; check the daq")
        n = min(len(force), experiment.samples - self.samples)
        states = np.empty((n, len(self._controller.state)))
        travel, command, commanded = np.empty((3, n))
        before, energy = self._command, 0.0
        answer = np.zeros(5)
        for i in range(n):
            k = self.samples + i
            states[i] = self._controller.state
            answer = self._controller.step(self._base[k], self._base[k + 1], float(force[i]), float(rod[i]))
            travel[i] = self._controller.signals[_TRAVEL]
            commanded[i], command[i] = answer[0], answer[1]
            self._work = self._left * self._work + force[i] * answer[3] * period
        if not math.isnan(self._rod):
            path = np.concatenate([[self._rod], rod])
            energy = float(np.sum(force * np.diff(path)))
        self._rod = float(rod[-1])
        self.samples += n
        self._command = float(command[-1])
        # The slope of the commands is what the predictor makes of the velocity; it holds half a block earlier.
        slope = (self._command - before) / (n * period)
        return Cycle(
            time=time + len(force) * period,
            position=self._command,
            velocity=float(slope + 0.5 * n * period * answer[4]),
            acceleration=float(answer[4]),
            current=float(answer[0]),
            states=states,
            travel=travel,
            command=command,
            commanded=commanded,
            work=self._work,
            power=energy / (len(force) * period),
            done=self.samples >= experiment.samples,
        )
