"""The loop of a hybrid test on the bench: from blocks of samples to setpoints, with the controller of the offline twin."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_control.controller import Controller
from mrd_control.experiment import ControlExperiment
from mrd_control.laws.law import Signals
from mrd_control.linear import propagate
from mrd_control.prediction import MODEL

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
        Bench time in s at which the setpoint holds: one sampling period after the last sample, or later where the emulated
        system predicts its own motion.
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


class Prediction:
    """Motion of the damper in an emulated system some time ahead, if the force stays as it is.

    Parameters
    ----------
    experiment : ControlExperiment
    base : ndarray (k, 2)
        Motion of the base at the samples.
    ahead : float
        s.
    """

    def __init__(self, experiment: ControlExperiment, base: Array, ahead: float) -> None:
        system, order = experiment.system.linear(), experiment.system.linear().order
        steps = max(1, math.ceil(ahead * experiment.rate))
        step = propagate(system.a, system.b, ahead / steps)
        self._transition, force = np.eye(order), np.zeros(order)
        # What the base adds is known beforehand; where the run ends, it stays where it is.
        samples = np.arange(len(base))
        self._added = np.zeros((len(base), order))

        def base_at(i: int) -> Array:
            places = np.minimum(samples + i * ahead / steps * experiment.rate, samples[-1])
            return np.stack([np.interp(places, samples, column) for column in base.T], axis=1)

        for i in range(steps):
            self._transition = step.transition @ self._transition
            force = step.transition @ force + step.before[:, 2] + step.after[:, 2]
            self._added = self._added @ step.transition.T
            self._added += base_at(i) @ step.before[:, :2].T + base_at(i + 1) @ step.after[:, :2].T
        self._force, self._base, self._outputs = force, base_at(steps), system.outputs[3:6]

    def motion(self, state: Array, force: float, sample: int) -> Array:
        """Return travel in m, speed in m/s and acceleration in m/s² (3,) ahead of a sample, from state and force there."""
        sample = min(sample, len(self._base) - 1)
        later = self._transition @ state + self._force * force + self._added[sample]
        return np.asarray(self._outputs @ np.concatenate([later, self._base[sample], [force]]), np.float64)


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
            experiment.modelled_actuator,
            experiment.gains,
            experiment.most_current,
        )
        self._ahead = experiment.actuator.total_delay if experiment.predictor == MODEL else 0.0
        self._prediction = Prediction(experiment, self._base, self._ahead) if self._ahead else None
        self._command = 0.0  # m, the latest
        self._rod = math.nan
        self._work, self._left = 0.0, math.exp(-1.0 / (experiment.rate * MEMORY))

    @property
    def state(self) -> Array:
        """State of the emulated system (2 N,) at the next sample."""
        return self._controller.state

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
            raise InputError("a measured force or position is not a number; check the daq")
        n = min(len(force), experiment.samples - self.samples)
        before, energy = self._command, 0.0
        base = self._base[self.samples : self.samples + n + 1]
        states, signals, answers = self._controller.add_block(base, force[:n], rod[:n])
        answer = answers[-1]
        for of_sample, speed in zip(force, answers[:, 3], strict=False):
            self._work = self._left * self._work + of_sample * speed * period
        if not math.isnan(self._rod):
            path = np.concatenate([[self._rod], rod])
            energy = float(np.sum(force * np.diff(path)))
        self._rod = float(rod[-1])
        self.samples += n
        self._command = float(answer[1])
        end = time + len(force) * period
        if self._prediction is None:
            # The slope of the commands is what the predictor makes of the velocity; it holds half a block earlier.
            velocity = (self._command - before) / (n * period) + 0.5 * n * period * answer[4]
            motion = np.array([self._command, velocity, answer[4]])
        else:
            end += experiment.delay
            motion = self._prediction.motion(self._controller.state, float(force[n - 1]), self.samples)
        return Cycle(
            time=end,
            position=float(motion[0]),
            velocity=float(motion[1]),
            acceleration=float(motion[2]),
            current=float(answer[0]),
            states=states,
            travel=signals[:, _TRAVEL],
            command=answers[:, 1],
            commanded=answers[:, 0],
            work=self._work,
            power=energy / (len(force) * period),
            done=self.samples >= experiment.samples,
        )
