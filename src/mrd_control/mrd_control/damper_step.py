"""One damper, sample by sample, inside compiled code.

`mrd_sim.models.DamperModel.forces` runs a whole path through the kernels; a closed loop needs one vertex at a time. Here the
same kernels are called with arrays of length one. They come as first-class functions, so that one compiled loop serves every
model and every effect.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim.current import evaluate_coefficients
from mrd_sim.damper import Damper
from mrd_sim.lag import follow
from mrd_sim.path import Path

Array = NDArray[np.float64]

MOST_EFFECTS = 6
"""Effects of a damper in a loop."""
MOST_PARAMETERS = 8
"""Parameters of one of them."""

ROW, ROWS, COUNTS = types.float64[::1], types.float64[:, ::1], types.intp[::1]
KERNEL = types.FunctionType(types.none(ROWS, ROW, ROW, ROW, ROW, ROW, ROW))
EFFECT = types.FunctionType(types.none(*[ROW] * 8))


@njit(cache=True, nogil=True)
def _no_effect(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    pass


class Vertex(NamedTuple):
    """Arrays (1,) of one vertex in SI units: step, motion of the rod, current, force on the rod, measured force."""

    step: Any
    x: Any
    v: Any
    a: Any
    current: Any
    force: Any
    measured: Any


class CompiledDamper(NamedTuple):
    """A damper as compiled code sees it.

    Attributes
    ----------
    kernel : compiled function
        Of the model.
    effects : tuple of compiled function
        `MOST_EFFECTS` kernels in the order of the stages, the last of which may do nothing.
    theta : ndarray (p,)
        Parameters of the model; the lag of the coil is the last.
    codes, columns, floors : ndarray (c,), (c, 3), (c,)
        Current laws of the coefficients, see `mrd_sim.current.evaluate_coefficients`.
    counts : ndarray (5,)
        Numbers of effects: of the drive; these and of the magnetics; all but sensing; all. And states of the model.
    parameters : ndarray (MOST_EFFECTS, MOST_PARAMETERS)
        Of the effects.
    starts : ndarray (MOST_EFFECTS + 1,)
        Where the state of each effect begins.
    state : ndarray (s,)
        Effective and measured current, states of the model, states of the effects; carried on.
    row : ndarray (1, c)
        Coefficients.
    """

    kernel: Any
    effects: Any
    theta: Any
    codes: Any
    columns: Any
    floors: Any
    counts: Any
    parameters: Any
    starts: Any
    state: Any
    row: Any


DAMPER_TYPES = (KERNEL, *[EFFECT] * MOST_EFFECTS, *(ROW, COUNTS, types.intp[:, ::1], ROW, COUNTS, ROWS, COUNTS, ROW, ROWS))
"""Compiled types of what `damper_step` returns."""


def damper_step(damper: Damper) -> tuple[Any, ...]:
    """Return the entries of a `CompiledDamper` at rest, the effects one by one.

    Raises
    ------
    InputError
        For effects that need more than one vertex at a time, or more effects than the loop has room for.
    """
    model = damper.model
    if model.series_elements:
        series = ", ".join(effect.id for effect in model.effects if effect.elongation is not None)
        raise InputError(
            f"damper {damper.description}: {series} in series with the damper cannot act in a loop; leave it out"
        )
    if model.needs_temperature:
        raise InputError(f"damper {damper.description}: a loop has no temperature on which it could depend; leave it out")
    effects = [effect for effect in model.effects if effect.kernel is not None]
    if len(effects) > MOST_EFFECTS:
        raise InputError(f"damper {damper.description}: {len(effects)} effects, expected at most {MOST_EFFECTS} in a loop")
    order = ("drive", "magnetics", "fluid", "structure", "sensing")
    effects.sort(key=lambda effect: order.index(effect.stage))
    zero = np.zeros(1)
    rest = Path(zero, zero, zero, zero, zero, np.arange(1))
    state = model.initial_state(rest)
    parameters = np.zeros((MOST_EFFECTS, MOST_PARAMETERS))
    starts, theta = np.zeros(MOST_EFFECTS + 1, np.intp), damper.theta
    first, part = 2 + model.states, {}
    for effect in model.effects:
        part[effect.id] = (first, first + effect.states)
        first += effect.states
    ordered = np.concatenate([state[: 2 + model.states], *(state[slice(*part[effect.id])] for effect in effects)])
    starts[0] = 2 + model.states
    for i, effect in enumerate(effects):
        names = [model.names.index(f"{effect.id}.{parameter.name}") for parameter in effect.parameters]
        parameters[i, : len(names)] = theta[names]
        starts[i + 1] = starts[i] + effect.states
    stages = [effect.stage for effect in effects]
    drive, magnetics, sensing = (stages.count(stage) for stage in ("drive", "magnetics", "sensing"))
    counts = np.array([drive, drive + magnetics, len(effects) - sensing, len(effects), model.states], np.intp)
    functions = [effect.kernel for effect in effects] + [_no_effect] * (MOST_EFFECTS - len(effects))
    # The coil lag is the last of the model's own parameters; the loop finds it at the end of theirs.
    own = len(model.parameters) - sum(len(effect.parameters) for effect in model.effects)
    return (
        model.kernel,
        *functions,
        np.ascontiguousarray(theta[:own], np.float64),
        np.ascontiguousarray(model.law_codes, np.intp),
        np.ascontiguousarray(model.law_columns, np.intp),
        np.ascontiguousarray(model.floors, np.float64),
        counts,
        parameters,
        starts,
        np.ascontiguousarray(ordered, np.float64),
        np.zeros((1, len(model.coefficients))),
    )


@njit(cache=True, nogil=True)
def magnetise(damper: Any, lag_left: float, vertex: Any) -> None:
    """Advance the effective current to the next vertex and fill in the coefficients there.

    Parameters
    ----------
    damper : CompiledDamper
    lag_left : float
        Share of the lag of the coil that is left after the step.
    vertex : Vertex
        Its current, linear over the step, becomes the effective one.
    """
    u, state, starts = vertex.current, damper.state, damper.starts
    for i in range(damper.counts[0], damper.counts[1]):
        part = state[starts[i] : starts[i + 1]]
        damper.effects[i](damper.parameters[i], part, vertex.step, vertex.x, vertex.v, vertex.a, u, vertex.force)
    now = u[0]
    u[0] = follow(state[0], state[1], now, damper.theta[-1] / vertex.step[0], lag_left)
    state[0], state[1] = u[0], now
    evaluate_coefficients(damper.theta, damper.codes, damper.columns, damper.floors, u, damper.row)


@njit(cache=True, nogil=True)
def damper_force(damper: Any, inner: Array, vertex: Any) -> None:
    """Advance the damper to a vertex, with the coefficients that `magnetise` has filled in.

    Parameters
    ----------
    damper : CompiledDamper
    inner : ndarray
        The model's part of its state.
    vertex : Vertex
        Filled with the force on the rod and the measured force. Effects of the drive change its motion.
    """
    dt, x, v, a, u, force, measured = vertex
    counts, parameters, state, starts = damper.counts, damper.parameters, damper.state, damper.starts
    for i in range(counts[0]):
        damper.effects[i](parameters[i], state[starts[i] : starts[i + 1]], dt, x, v, a, u, force)
    damper.kernel(damper.row, inner, dt, x, v, a, force)
    for i in range(counts[1], counts[2]):
        damper.effects[i](parameters[i], state[starts[i] : starts[i + 1]], dt, x, v, a, u, force)
    measured[0] = force[0]
    for i in range(counts[2], counts[3]):
        damper.effects[i](parameters[i], state[starts[i] : starts[i + 1]], dt, x, v, a, u, measured)
