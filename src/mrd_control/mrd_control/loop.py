"""The closed loop of an emulated system, a control law and a damper, at a fixed rate.

Two loops share the controller. In the simulated one, emulated system and damper touch: the force at the end of each step is
the root of an equation, so that the exchange costs no energy. In the hybrid one, as on the bench, the measured force drives
the emulated system, whose motion an actuator with a delay brings to the damper. All samples run in compiled code; kernels of
model, effects, law and predictor come as first-class functions.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from mrd_control.controller import (
    CONTROLLER_TYPES,
    ROW,
    ROWS,
    Actuator,
    CompiledController,
    compiled,
    control_cycle,
    controller_entries,
    free_step,
    law_current,
    output,
)
from mrd_control.damper_step import DAMPER_TYPES, CompiledDamper, Vertex, damper_force, damper_step, magnetise
from mrd_control.laws import Law
from mrd_control.laws.law import STATE
from mrd_control.linear import LinearSystem
from mrd_sim.damper import Damper
from mrd_sim.root import next_iterate

Array = NDArray[np.float64]

FORCE_TOLERANCE = 1e-3
"""N, of the force at the end of a step."""
MOST_ATTEMPTS = 60
"""Calls of the damper in one step. A model that jumps with the sign of the acceleration may have no root."""
DIVERGED = 1.0
"""m of travel, at which a loop ends as unstable."""

TRAVEL, SPEED, FORCE, COMMANDED, CURRENT, ROD, COMMAND = range(7)
"""Columns of the results of `_run`."""


@dataclass(frozen=True, eq=False)
class LoopResult:
    """What happened in a loop, at n samples; fewer than asked for where it diverged.

    Attributes
    ----------
    time : ndarray (n,)
        s.
    state : ndarray (n, 2 N)
        Positions and velocities of the emulated system, absolute.
    base : ndarray (n, 2)
        Position and velocity of the base.
    acceleration : ndarray (n,)
        Of the mass whose ride counts, m/s².
    travel, speed : ndarray (n,)
        Of the emulated system at the damper, m and m/s.
    force : ndarray (n,)
        That drives the emulated system, N.
    commanded, current : ndarray (n,)
        Current that the law asks for, within the range of the supply, and that in the coil; A.
    rod, command : ndarray (n,)
        Position of the rod and position commanded to the actuator, m; both are the travel where there is no actuator.
    diverged : bool
        Whether the loop was unstable, and ended when the travel passed `DIVERGED`.
    """

    time: Array
    state: Array
    base: Array
    acceleration: Array
    travel: Array
    speed: Array
    force: Array
    commanded: Array
    current: Array
    rod: Array
    command: Array
    diverged: bool

    def part(self, kept: slice) -> "LoopResult":
        """Return what happened at some of the samples."""
        series: dict[str, Any] = {name: value[kept] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **series)


@njit(cache=True, nogil=True)
def _touching_force(
    damper: Any,
    inner: Array,
    before: Array,
    vertex: Any,
    free: Array,
    gain: Array,
    last_speed: float,
    guess: float,
    slope: float,
) -> tuple[float, float]:
    """Return the force at the end of a step, the root of damper(motion(F)) = F, and the slope of damper(motion(F)) - F.

    The left side falls with F, so there is one root. The state of the damper is advanced.

    Parameters
    ----------
    damper : CompiledDamper
    inner, before : ndarray
        Parts of its state: that of the model, and room for a copy of the whole.
    vertex : Vertex
        Filled with motion and measured force at the root.
    free, gain : ndarray (2,)
        Travel in m and speed in m/s at the end of the step without a force there, and their change per newton.
    last_speed : float
        m/s before the step.
    guess : float
        Of the force.
    slope : float
        That of the last step, which is a good guess.
    """
    state, period = damper.state, vertex.step[0]
    for i in range(len(state)):
        before[i] = state[i]
    low = high = last = guess_before = error_before = 0.0
    for attempt in range(MOST_ATTEMPTS):
        if attempt > 0:
            for i in range(len(state)):
                state[i] = before[i]
        speed = free[1] + gain[1] * guess
        vertex.x[0], vertex.v[0], vertex.a[0] = free[0] + gain[0] * guess, speed, (speed - last_speed) / period
        damper_force(damper, inner, vertex)
        error = vertex.force[0] - guess
        if not abs(error) > FORCE_TOLERANCE:  # "not" also ends the search where it is no number
            break
        if attempt == 0:
            low, high = min(guess, vertex.force[0]), max(guess, vertex.force[0])
            last = 4.0 * (high - low)
        else:
            if error > 0.0:
                low = guess
            else:
                high = guess
            if high - low <= FORCE_TOLERANCE:
                break
            slope = min((error - error_before) / (guess - guess_before), -1.0)
        guess_before, error_before = guess, error
        guess, last = next_iterate(guess, -error / slope, low, high, last)
    return guess, slope


@njit(cache=True, nogil=True)
def _delayed_rod(results: Array, k: int, delay: float, left: float, lag: float, period: float, target_before: float) -> Any:
    """Return position and speed of the rod at sample ``k`` in SI units, and the target that it follows.

    The target is the command of a dead time of ``delay`` periods ago, on the straight line between two commands. The rod
    follows it with a first-order ``lag`` in s, of which the share ``left`` is left after a period.
    """
    whole = int(delay)
    part = delay - whole
    target = (1.0 - part) * results[max(k - whole, 0), COMMAND] + part * results[max(k - whole - 1, 0), COMMAND]
    rod_before = results[k - 1, ROD]
    if left > 0.0:
        # Exact for a target that is linear over the step.
        share = lag / period * (1.0 - left)
        rod = target - (target - target_before) * share + (rod_before - target_before) * left
        return rod, (target - rod) / lag, target
    if k == 1:
        return target, (target - rod_before) / period, target
    return target, (3.0 * target - 4.0 * rod_before + results[k - 2, ROD]) / (2.0 * period), target


@compiled(types.boolean, *DAMPER_TYPES, *CONTROLLER_TYPES, ROW, ROW, ROWS, ROWS, ROWS)
def _run(
    kernel: Any,
    first: Any,
    second: Any,
    third: Any,
    fourth: Any,
    fifth: Any,
    sixth: Any,
    theta: Array,
    codes: Any,
    columns: Any,
    floors: Array,
    counts: Any,
    parameters: Array,
    starts: Any,
    damper_state: Array,
    row: Array,
    law: Any,
    predictor: Any,
    law_parameters: Array,
    law_memory: Array,
    table: Array,
    predictor_parameters: Array,
    predictor_memory: Array,
    step: Array,
    outputs: Array,
    period: float,
    most_current: float,
    base_share: float,
    lever_ratio: float,
    settings: Array,
    state: Array,
    base: Array,
    states: Array,
    results: Array,
) -> bool:
    """Run a loop over all samples; return whether it stayed stable.

    The arguments are the entries of a `CompiledDamper` and of a `CompiledController`; then ``settings`` (5,): what is left
    of the lag of the supply after a step, whether there is an actuator, its delay in periods, what is left of its lag (0
    without lag) and its lag in s; then state of the system, motion of the base, and what is filled.
    """
    effects = (first, second, third, fourth, fifth, sixth)
    damper = CompiledDamper(kernel, effects, theta, codes, columns, floors, counts, parameters, starts, damper_state, row)
    controller = CompiledController(
        law,
        predictor,
        law_parameters,
        law_memory,
        table,
        predictor_parameters,
        predictor_memory,
        step,
        outputs,
        period,
        most_current,
        base_share,
        lever_ratio,
    )
    supply_left, hybrid, delay, left, lag = settings[0], settings[1] > 0.0, settings[2], settings[3], settings[4]
    work, order, n = np.zeros((7, 1)), len(state), len(base)
    vertex = Vertex(work[0], work[1], work[2], work[3], work[4], work[5], work[6])
    vertex.step[0] = period
    inner, before = damper_state[2 : 2 + counts[4]], damper_state.copy()
    lag_left = math.exp(-period / theta[-1]) if theta[-1] > 0.0 else 0.0
    signals, answer, following = np.zeros(STATE + order), np.zeros(5 + order), np.zeros(order)
    free, gain = np.zeros(2), np.zeros(2)
    for i in range(2):
        for j in range(order):
            gain[i] += outputs[3 + i, j] * step[j, order + 5]
    force = force_before = measured = current = last_speed = target = 0.0
    slope = -1.0
    for k in range(n):
        if k > 0:
            current = answer[0] + (current - answer[0]) * supply_left
            vertex.current[0] = current
            magnetise(damper, lag_left, vertex)
            if hybrid:
                rod, speed, target = _delayed_rod(results, k, delay, left, lag, period, target)
                results[k, ROD] = rod
                vertex.x[0], vertex.v[0], vertex.a[0] = rod, speed, (speed - last_speed) / period
                damper_force(damper, inner, vertex)
                last_speed, force, measured = speed, vertex.measured[0], vertex.measured[0]
            else:
                free_step(step, state, base[k - 1], base[k], force, following)
                for i in range(2):
                    free[i] = output(outputs, 3 + i, following, base[k], 0.0)
                guess = 2.0 * force - force_before
                guess, slope = _touching_force(damper, inner, before, vertex, free, gain, last_speed, guess, slope)
                for i in range(order):
                    state[i] = following[i] + step[i, order + 5] * guess
                last_speed = free[1] + gain[1] * guess
                force_before, force, measured = force, guess, vertex.measured[0]
                results[k, ROD] = results[k, COMMAND] = free[0] + gain[0] * guess
        for i in range(order):
            states[k, i] = state[i]
        if hybrid:
            after = base[min(k + 1, n - 1)]
            control_cycle(controller, state, base[k], after, force, results[k, ROD], signals, answer)
            if k + 1 < n:
                results[k + 1, COMMAND] = answer[1]
        else:
            answer[0] = law_current(controller, state, base[k], force, measured, signals)
        results[k, TRAVEL], results[k, SPEED], results[k, FORCE] = signals[4], signals[5], force
        results[k, COMMANDED], results[k, CURRENT] = answer[0], current
        if not abs(signals[4]) < DIVERGED:
            return False
    return True


def run_loop(
    system: LinearSystem,
    damper: Damper,
    law: Law,
    base: Array,
    rate: float,
    *,
    gains: Mapping[str, float] | None = None,
    most_current: float = 1.0,
    supply_lag: float = 0.003,
    actuator: Actuator | None = None,
) -> LoopResult:
    """Run the closed loop along a motion of the base, from rest.

    Parameters
    ----------
    system : LinearSystem
    damper : Damper
        A fresh one takes part; this one is not changed.
    law : Law
    base : ndarray (n, 2)
        Position in m and velocity in m/s of the base at the samples.
    rate : float
        Hz, of samples and controller.
    gains : mapping, optional
        Parameters of the law; those not given keep their default.
    most_current : float
        Largest current of the supply in A.
    supply_lag : float
        s, first-order lag from the commanded current to that in the coil.
    actuator : Actuator, optional
        Actuator of a hybrid test; without it the emulated system and the damper touch.

    Raises
    ------
    InputError
        For unknown or unusable gains, a damper that cannot act in a loop, or one without an inverse where the law needs it.
    """
    period = 1.0 / rate
    hybrid = actuator or Actuator(0.0)
    settings = np.array(
        [
            math.exp(-period / supply_lag) if supply_lag > 0.0 else 0.0,
            float(actuator is not None),
            hybrid.delay / period,
            math.exp(-period / hybrid.lag) if hybrid.lag > 0.0 else 0.0,
            hybrid.lag,
        ]
    )
    base = np.ascontiguousarray(base, np.float64)
    states, results = np.zeros((len(base), system.order)), np.zeros((len(base), 1 + COMMAND))
    stable = _run(
        *damper_step(damper),
        *controller_entries(system, damper, law, rate, actuator, gains, most_current),
        settings,
        np.zeros(system.order),
        base,
        states,
        results,
    )
    n = len(base) if stable else int(np.argmax(~(np.abs(results[:, TRAVEL]) < DIVERGED))) + 1
    states, results, base = states[:n], results[:n], base[:n]
    ride = len(system.mass) + system.ride
    acceleration = states @ system.a[ride] + base @ system.b[ride, :2] + results[:, FORCE] * system.b[ride, 2]
    return LoopResult(
        time=period * np.arange(n, dtype=np.float64),
        state=states,
        base=base,
        acceleration=acceleration,
        travel=results[:, TRAVEL],
        speed=results[:, SPEED],
        force=results[:, FORCE],
        commanded=results[:, COMMANDED],
        current=results[:, CURRENT],
        rod=results[:, ROD],
        command=results[:, COMMAND],
        diverged=not stable,
    )
