"""The offline twin of a hybrid test, and what has to hold before the test may run."""

import copy
import math

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_control.experiment import ControlExperiment
from mrd_control.loop import DIVERGED, LoopResult, run_loop
from mrd_control.online import OnlineLoop, Prediction
from mrd_control.prediction import MODEL
from mrd_control.stability import Margin, check_stability
from mrd_trajectory.limits import Limits

Array = NDArray[np.float64]

CURRENTS = 9
"""Coil currents at which the stability margin is computed."""


def run_twin(experiment: ControlExperiment, error: Array | None = None) -> LoopResult:
    """Run the offline twin of an experiment: the same controller, with the modelled damper and the modelled actuator.

    Parameters
    ----------
    experiment : ControlExperiment
    error : ndarray (samples, 3), optional
        What the rod has more than the emulated motion in m, m/s and m/s², where the predictor is `MODEL`, with which the rod
        is in time otherwise.

    Raises
    ------
    InputError
        As `mrd_control.loop.run_loop`, and for an excitation that is too short.
    """
    if experiment.predictor == MODEL:
        return _run_in_blocks(experiment, np.zeros((experiment.samples, 3)) if error is None else error)
    return run_loop(
        experiment.system.linear(),
        experiment.damper,
        experiment.control_law,
        experiment.base,
        experiment.rate,
        gains=experiment.gains,
        most_current=experiment.most_current,
        supply_lag=experiment.supply_lag,
        actuator=experiment.actuator,
    )


def _run_in_blocks(experiment: ControlExperiment, error: Array) -> LoopResult:
    """Run the twin whose rod is in time but for the error, in blocks as on the bench: the current waits for their end."""
    system, period = experiment.system.linear(), 1.0 / experiment.rate
    damper = copy.copy(experiment.damper)  # at rest, as that one stays
    loop = OnlineLoop(experiment)
    length = round(experiment.block * experiment.rate)
    n = experiment.samples
    left = math.exp(-period / experiment.supply_lag) if experiment.supply_lag > 0.0 else 0.0
    ahead = [Prediction(experiment, experiment.base, (i + 1) * period) for i in range(length)]
    states = np.zeros((n, system.order))
    travel, speed, force, commanded, current, command = np.zeros((6, n))
    motion, held, coil, command_now = np.zeros((length, 3)), 0.0, 0.0, 0.0
    for begin in range(0, n, length):
        part = slice(begin, min(begin + length, n))
        count = part.stop - part.start
        coils = np.empty(count)
        for i in range(count):
            coil = coils[i] = held + (coil - held) * left
        rod, rate, acceleration = np.ascontiguousarray((motion[:count] + error[part]).T)
        force[part] = damper.advance(period, rod, rate, acceleration, coils)
        cycle = loop.add_block(begin * period, period, force[part], rod)
        states[part], travel[part], commanded[part], current[part] = cycle.states, cycle.travel, cycle.commanded, coils
        speed[part] = rate - error[part, 1]
        command[part] = np.concatenate([[command_now], cycle.command])[:count]
        command_now, held = float(cycle.command[-1]), cycle.current
        if not abs(travel[part]).max() < DIVERGED:
            n = part.stop
            break
        state, now, sample = loop.state, float(force[part][-1]), loop.samples
        # The state is that of the next sample already, the first of the next block.
        motion[0] = system.outputs[3:6] @ np.concatenate(
            [state, experiment.base[min(sample, len(experiment.base) - 1)], [now]]
        )
        for i in range(1, length):
            motion[i] = ahead[i - 1].motion(state, now, sample)
    states, base = states[:n], experiment.base[:n]
    derivative = states @ system.a.T + base @ system.b[:, :2].T + force[:n, None] * system.b[:, 2]
    return LoopResult(
        time=period * np.arange(n, dtype=np.float64),
        state=states,
        base=base,
        acceleration=derivative[:, len(system.mass) + system.ride],
        travel=travel[:n],
        speed=speed[:n],
        force=force[:n],
        commanded=commanded[:n],
        current=current[:n],
        rod=travel[:n] + error[:n, 0],
        command=command[:n],
        diverged=n < experiment.samples,
    )


def check_experiment(experiment: ControlExperiment, limits: Limits) -> tuple[Margin, LoopResult]:
    """Return stability margin and offline twin of an experiment that the bench can run.

    Raises
    ------
    InputError
        For a hybrid loop that is unstable at `mrd_control.stability.AMPLITUDE`, so that the rod would tremble by as
        much at least, and for a twin that leaves the limits of the bench; the message names number, limit and remedy.
    """
    if experiment.most_current > limits.current_max:
        raise InputError(
            f"most_current_A is {experiment.most_current:g}, expected at most {limits.current_max:g}, the limit here"
        )
    currents = [float(current) for current in np.linspace(0.0, experiment.most_current, CURRENTS)]
    margin = check_stability(
        experiment.system.linear(), experiment.damper, experiment.loop_actuator, experiment.rate, currents
    )
    twin = run_twin(experiment)
    if twin.diverged:
        raise InputError(
            f"the offline twin diverges at {twin.time[-1]:.2f} s; reduce the excitation or compensate the delay"
        )
    for what, series, limit, scale, unit in (
        ("travel", twin.travel, limits.reach, 1e3, "mm"),
        ("speed", twin.speed, limits.speed, 1e3, "mm/s"),
        ("force", twin.force, limits.force, 1.0, "N"),
    ):
        most = int(np.argmax(np.abs(series)))
        if not abs(series[most]) <= limit:
            raise InputError(
                f"the offline twin has a {what} of {scale * series[most]:.4g} {unit} at {twin.time[most]:.2f} s, limit "
                f"±{scale * limit:.4g} {unit}; reduce the excitation, or the lever ratio of the system"
            )
    return margin, twin
