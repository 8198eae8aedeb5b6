"""The controller: the emulated system driven by a force, the law that sets the current, the motion to command.

The simulated loop, the offline twin of a hybrid test and the bench run the same compiled functions.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from mrd_control.force_map import inverse_map
from mrd_control.laws.law import LAW, STATE, Law
from mrd_control.linear import LinearSystem, propagate
from mrd_control.prediction import PREDICTOR, find_predictor
from mrd_sim.damper import Damper

Array = NDArray[np.float64]

ROW, ROWS = types.float64[::1], types.float64[:, ::1]


@dataclass(frozen=True)
class Actuator:
    """What brings the emulated motion to the damper.

    Attributes
    ----------
    delay : float
        Dead time in s from the command to the rod.
    lag : float
        Time constant in s of a first-order lag after it; together they delay slow motion by their sum.
    predictor : str
        Id of the compensation (`mrd_control.prediction.PREDICTORS`).
    ahead : float or None
        s by which it predicts; None for delay and lag.
    """

    delay: float
    lag: float = 0.0
    predictor: str = "none"
    ahead: float | None = None

    @property
    def total_delay(self) -> float:
        """Delay in s of slow motion."""
        return self.delay + self.lag

    @property
    def predicted(self) -> float:
        """Time in s by which the predictor predicts."""
        return self.total_delay if self.ahead is None else self.ahead


class CompiledController(NamedTuple):
    """A controller as compiled code sees it.

    Attributes
    ----------
    law, predictor : compiled functions
    law_parameters, law_memory, table : ndarray
        As `mrd_control.laws.Law.kernel` is given them.
    predictor_parameters, predictor_memory : ndarray
        As a predictor is given them.
    step, outputs : ndarray
        From `step_matrix` and `LinearSystem.outputs`.
    period : float
        s.
    most_current : float
        A.
    base_share : float
        Share of the velocity of the base that the velocities are relative to, in the state that a law sees.
    lever_ratio : float
    """

    law: Any
    predictor: Any
    law_parameters: Any
    law_memory: Any
    table: Any
    predictor_parameters: Any
    predictor_memory: Any
    step: Any
    outputs: Any
    period: Any
    most_current: Any
    base_share: Any
    lever_ratio: Any


CONTROLLER_TYPES = (LAW, PREDICTOR, ROW, ROW, ROWS, ROW, ROW, ROWS, ROWS, *[types.float64] * 4)
"""Compiled types of the entries of a `CompiledController`."""


def compiled(result: Any, *arguments: Any) -> Callable[[Any], Any]:
    """Return a decorator that compiles for first-class functions; numba warns where such are put into a tuple."""

    def decorate(function: Any) -> Any:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "First-class function type feature is experimental")
            return njit(result(*arguments), cache=True, nogil=True)(function)

    return decorate


@njit(cache=True, nogil=True)
def law_current(controller: Any, state: Array, base: Array, force: float, measured: float, signals: Array) -> float:
    """Return the current that the law commands, within the range of the supply, and fill in the signals that it sees.

    ``force`` in N drives the emulated system, ``measured`` is what the load cell says of it.
    """
    outputs, order = controller.outputs, len(state)
    signals[0] = controller.period
    for i in range(5):
        signals[1 + i] = output(outputs, i, state, base, force)
    signals[6], signals[7] = measured, controller.lever_ratio
    half = order // 2
    for j in range(half):
        signals[STATE + j] = state[j] - base[0]
        signals[STATE + half + j] = state[half + j] - controller.base_share * base[1]
    current = controller.law(controller.law_parameters, controller.law_memory, signals, controller.table)
    return float(min(max(current, 0.0), controller.most_current))


@njit(cache=True, nogil=True)
def output(rows: Array, i: int, state: Array, base: Array, force: float) -> float:
    """Return what row ``i`` of a matrix, such as `LinearSystem.outputs`, makes of state and inputs."""
    order = len(state)
    total = rows[i, order] * base[0] + rows[i, order + 1] * base[1] + rows[i, order + 2] * force
    for j in range(order):
        total += rows[i, j] * state[j]
    return float(total)


@njit(cache=True, nogil=True)
def free_step(step: Array, state: Array, base: Array, base_after: Array, force: float, following: Array) -> None:
    """Fill in the state after a step, but for what the force at its end adds. ``step`` is from `step_matrix`."""
    order = len(state)
    for i in range(order):
        following[i] = output(step, i, state, base, force)
        following[i] += step[i, order + 3] * base_after[0] + step[i, order + 4] * base_after[1]


@njit(cache=True, nogil=True)
def control_cycle(
    controller: Any, state: Array, base: Array, base_after: Array, force: float, rod: float, signals: Array, answer: Array
) -> None:
    """One cycle on the bench: from the measured force to the current, and to the motion at the next sample.

    The force is held over the step, since the one at its end is not measured yet.

    Parameters
    ----------
    controller : CompiledController
    state : ndarray (2 n,)
        Of the emulated system; advanced.
    base, base_after : ndarray (2,)
        Position in m and velocity in m/s of the base now and at the next sample.
    force, rod : float
        Measured force in N and measured position of the rod in m, now.
    signals : ndarray (8 + 2 n,)
        Filled with what the law saw.
    answer : ndarray (5 + 2 n,)
        Filled with the current to command from now on in A, the position to command for the next sample, and position,
        velocity and acceleration wanted there; SI. The rest is used.
    """
    order, outputs, following = len(state), controller.outputs, answer[5:]
    answer[0] = law_current(controller, state, base, force, force, signals)
    free_step(controller.step, state, base, base_after, force, following)
    for i in range(order):
        state[i] = following[i] + controller.step[i, order + 5] * force
    for i in range(3):
        answer[2 + i] = output(outputs, 3 + i, state, base_after, force)
    parameters, memory = controller.predictor_parameters, controller.predictor_memory
    answer[1] = controller.predictor(parameters, memory, answer[2], answer[3], answer[4], rod)


def step_matrix(system: LinearSystem, period: float) -> Array:
    """Return the matrix (2 n, 2 n + 6) of an exact step: of the state, of the inputs before and of those after it."""
    exact = propagate(system.a, system.b, period)
    return np.ascontiguousarray(np.hstack([exact.transition, exact.before, exact.after]))


def controller_entries(
    system: LinearSystem,
    damper: Damper,
    law: Law,
    rate: float,
    actuator: Actuator | None = None,
    gains: Mapping[str, float] | None = None,
    most_current: float = 1.0,
) -> tuple[Any, ...]:
    """Return the entries of a `CompiledController` at rest.

    Parameters
    ----------
    system : LinearSystem
    damper : Damper
        Model whose inverse the law may need.
    law : Law
    rate : float
        Hz.
    actuator : Actuator, optional
        Whose delay is compensated.
    gains : mapping, optional
        Parameters of the law; those not given keep their default.
    most_current : float
        Largest current of the supply in A.

    Raises
    ------
    InputError
        For unknown or unusable gains, an unknown predictor, or a damper without an inverse where the law needs it.
    """
    period = 1.0 / rate
    actuator = actuator or Actuator(0.0)
    predictor = find_predictor(actuator.predictor)
    return (
        law.kernel,
        predictor.kernel,
        law.vector(gains or {}, system, period),
        np.zeros(law.memory(system)),
        inverse_map(damper, most_current) if law.demands_force else np.zeros((1, 1)),
        *predictor.prepare(period, actuator.predicted),
        step_matrix(system, period),
        np.ascontiguousarray(system.outputs),
        period,
        most_current,
        float(system.base_accelerates),
        system.lever_ratio,
    )


@compiled(types.none, *CONTROLLER_TYPES, ROW, ROWS, ROW, ROW, ROWS, ROWS, ROWS)
def _cycles(
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
    state: Array,
    base: Array,
    force: Array,
    rod: Array,
    states: Array,
    signals: Array,
    answers: Array,
) -> None:
    """`control_cycle` for each sample of a block, to be called from Python; a call takes longer than a cycle."""
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
    for i in range(len(force)):
        states[i] = state
        control_cycle(controller, state, base[i], base[i + 1], force[i], rod[i], signals[i], answers[i])


class Controller:
    """The controller of a hybrid test, block by block; the same compiled code as in `mrd_control.loop.run_loop`.

    Parameters
    ----------
    system, damper, law, rate, actuator, gains, most_current
        As of `controller_entries`, with the same errors.

    Attributes
    ----------
    state : ndarray (2 N,)
        Of the emulated system.
    """

    def __init__(
        self,
        system: LinearSystem,
        damper: Damper,
        law: Law,
        rate: float,
        actuator: Actuator,
        gains: Mapping[str, float] | None = None,
        most_current: float = 1.0,
    ) -> None:
        self.state = np.zeros(system.order)
        self._entries = controller_entries(system, damper, law, rate, actuator, gains, most_current)

    def add_block(self, base: Array, force: Array, rod: Array) -> tuple[Array, Array, Array]:
        """Take a block of n samples and return what the controller made of each.

        Parameters
        ----------
        base : ndarray (n + 1, 2)
            Position in m and velocity in m/s of the base at the samples and at the one after them.
        force, rod : ndarray (n,)
            Measured force in N and position of the rod in m.

        Returns
        -------
        states : ndarray (n, 2 N)
            State of the emulated system at the samples.
        signals : ndarray (n, 8 + 2 N)
            What the law saw (`mrd_control.laws.law.Signals`).
        answers : ndarray (n, 5)
            Current, command and motion: the first entries of `control_cycle`'s answer.
        """
        base, force, rod = (np.ascontiguousarray(series, np.float64) for series in (base, force, rod))
        n, order = len(force), len(self.state)
        states, signals, answers = np.empty((n, order)), np.empty((n, STATE + order)), np.empty((n, 5 + order))
        _cycles(*self._entries, self.state, base, force, rod, states, signals, answers)
        return states, signals, answers[:, :5]
