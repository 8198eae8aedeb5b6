"""Form remainder: a flexible function for what the form of the damper model lacks, beside which effects are judged.

No base model has the form of a measured damper: its curve of force over speed bends otherwise, the force develops over
another travel after a reversal, and both change otherwise with the current. Effects that describe neither would be named for
such errors, or be lost behind them. The remainder is linear in its coefficients, which have a normal prior (Kennedy &
O'Hagan, 2001, with a basis in place of the kernel), and depends on nothing but speed, the recent travel and the measured
current. It is odd in the direction of motion. It can therefore not take the place of what depends on position, time, heat,
acceleration, the history of the current or of the force, nor of what differs between extension and compression.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.fitting.base_fit import LinearisedRefit, with_effect
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.fitting.residual_regression import fading_memory
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_diagnosis.search.effect_search import start_values
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.parallel import in_threads
from mrd_identification.problem import make_problem
from mrd_identification.recording import Recording
from mrd_runs.scales import scales_of
from mrd_sim.effects import find_effects

Array = NDArray[np.float64]

TRAVELS = (0.005, 0.02, 0.08)
"""Travels, over half the span of the position, over which the memory of the rod's direction fades: the yield travels of
dampers lie between."""

SPEEDS = (0.01, 0.03, 0.1, 0.3)
"""Shares of the largest speed at which a step of the force over speed is smoothed."""

POWERS_OF_CURRENT = (0, 1, 2)
"""Powers of the current by which the functions of motion are multiplied."""

SCALES = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Standard deviations of the coefficients that are tried, as shares of the rms force."""

ROUNDS = 3
"""Rounds in which the remainder and the weighting of the residuals are adapted to each other."""


def form_columns(recordings: Sequence[Recording]) -> Array:
    """Return the functions of motion and current (counted samples, columns), of rms one and orthogonal to each other."""
    top = max(float(np.quantile(np.abs(recording.path.recorded.velocity), 0.995)) for recording in recordings)
    largest = max(float(np.quantile(np.abs(recording.path.recorded.current), 0.995)) for recording in recordings)
    stroke = scales_of([recording.run for recording in recordings]).stroke
    parts = [_functions(recording, top, largest, stroke) for recording in recordings]
    return orthogonal(np.concatenate(parts))


def orthogonal(columns: Array) -> Array:
    """Return columns orthogonal to each other from functions (samples, columns) that count alike whatever their size.

    Functions that the runs cannot tell apart count once.
    """
    columns = columns / (np.sqrt(np.mean(columns**2, axis=0)) + 1e-300)
    values, vectors = np.linalg.eigh(columns.T @ columns / len(columns))
    kept = values > 1e-6 * values[-1]
    return np.asarray(columns @ vectors[:, kept])


def _functions(recording: Recording, top_speed: float, largest_current: float, stroke: float) -> Array:
    path = recording.path
    position, velocity, current = (series[path.samples] for series in (path.position, path.velocity, path.current))
    speed = velocity / top_speed
    travel = np.diff(position, prepend=position[0]) / stroke
    memories = [fading_memory(np.exp(-np.abs(travel) / scale), np.sign(travel)) for scale in TRAVELS]
    motion = [
        speed,
        speed * np.abs(speed),
        speed**3,
        *(np.tanh(speed / scale) for scale in SPEEDS),
        *memories,
        *(memory * np.abs(speed) for memory in memories),
        *(memory / np.cosh(np.clip(speed / scale, -20.0, 20.0)) ** 2 for memory in memories for scale in SPEEDS),
    ]
    relative = current / largest_current if largest_current > 0.0 else np.zeros_like(current)
    functions = [function * relative**power for power in POWERS_OF_CURRENT for function in motion]
    return np.stack(functions, axis=1)[recording.counted]


def with_form_remainder(weighting: Weighting, base: Refit) -> tuple[Weighting, Refit]:
    """Return the weighting with the form remainder that predicts held-out folds best beside a model, and the model's
    refit.
    """
    return with_remainder(weighting, base, form_columns(weighting.recordings))


def with_remainder(weighting: Weighting, base: Refit, functions: Array) -> tuple[Weighting, Refit]:
    """Return the weighting with a remainder of functions (samples, columns) of rms one, and the refit of a model beside it.

    The functions have the scale with which held-out folds are predicted best. The better they do, the smaller is the
    discrepancy in the weighting, and the more they can tell in turn.
    """
    columns, refitted = _columns(weighting, base, functions), base
    for _ in range(ROUNDS):
        fits = []
        for scale in SCALES:
            extended = _extended(weighting, columns, scale)
            fits.append((extended, refit_on(extended, refitted)))
        weighting, refitted = min(fits, key=lambda fit: fit[1].held_out_cost)
        weighting = weighting.updated(refitted.problem.model, refitted.theta, refitted.coefficients)
    return weighting, refit_on(weighting, refitted)


def _columns(weighting: Weighting, base: Refit, functions: Array) -> tuple[Array, Array]:
    """Return functions, and what the damper's own parameters change to first order, in N."""
    rms = float(np.sqrt(np.mean(base.problem.force**2)))
    plain, _ = make_problem(base.problem.model, weighting.recordings, fixed=weighting.fixed)
    own = plain.jacobian(plain.unit(base.theta))
    size = np.sqrt(np.mean(own**2, axis=0))
    return rms * functions, rms * own[:, size > 0.0] / size[size > 0.0]


def _extended(weighting: Weighting, columns: tuple[Array, Array], scale: float) -> Weighting:
    """Return the weighting with a remainder in which the functions have this scale."""
    functions, own = columns
    joined = np.concatenate([scale * functions, own], axis=1)
    return replace(weighting, remainder=columns_by_run(weighting.recordings, joined))


def columns_by_run(recordings: Sequence[Recording], columns: Array) -> tuple[Array, ...]:
    """Divide columns (samples, columns) into those of each run."""
    edges = np.cumsum([0, *(len(recording.force) for recording in recordings)])
    return tuple(columns[a:b] for a, b in itertools.pairwise(edges))


def form_effects(weighting: Weighting, base: Refit, effects: Sequence[str]) -> list[str]:
    """Return the effects that a remainder can take the place of: they change the form of the damper.

    Parameters
    ----------
    weighting : Weighting
    base : Refit
        The model without effects.
    effects : sequence of str
        Ids of the candidates.
    """
    alone = replace(weighting, remainder=())
    freest = _extended(alone, _columns(weighting, base, form_columns(weighting.recordings)), SCALES[-1])
    spaces = [(space, LinearisedRefit.around(space, base)) for space in (alone, freest)]

    def unabsorbed(effect: str) -> list[float]:
        """Return the energy of the effect's change of the force that the model leaves, without and with the remainder."""
        model, neutral = with_effect(base.problem.model, base.theta, effect)
        theta = neutral.copy()
        for name, value in start_values(find_effects([effect], base.problem.model.scales)[0], base.problem.force)[0].items():
            theta[model.names.index(f"{effect}.{name}")] = value
        energies = []
        for space, linearised in spaces:
            change = space.problem(model, neutral).residuals(theta) - linearised.residual
            rest = linearised.unabsorbed(change)
            energies.append(float(rest @ rest))
        return energies

    energies = in_threads(unabsorbed, effects)
    return [
        effect
        for effect, (without, beside) in zip(effects, energies, strict=True)
        if beside < THRESHOLDS.form_effect_energy * without
    ]
