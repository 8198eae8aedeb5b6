"""The true map of the gap: where in the recordings lies what the effects change and the model cannot take up."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from mrd_runs import Run
from mrd_runs.scales import scales_of
from mrd_runs.signals.current_steps import time_since_step
from mrd_trials.bench_session import BenchSession, Effects
from mrd_trials.records import GapBin
from mrd_trials.reference_fit import ReferenceFit
from mrd_trials.size import REFERENCE, Size

Array = NDArray[np.float64]

SPAN = (0.002, 0.998)
"""Quantiles of the position at the ends of the stroke."""

FRAME = 2.0
"""Length in s of the frames of a spectrum: bands of the frequency axis are half a hertz wide or wider."""


def true_map(
    session: BenchSession, effects: Effects, model_id: str, bins: Sequence[GapBin], size: Size = REFERENCE
) -> tuple[GapBin, ...]:
    """Return the true shares of the gap on given bins; none where the effects change nothing.

    The plant is recorded with and without its effects, under the same commands and with the same noise. What differs between
    the errors of the model that is fitted to the plant without effects, less what the model could imitate, is the true gap.
    The share of a bin is the share of its squared force.

    Parameters
    ----------
    session : BenchSession
    effects : mapping
        The effects of the plant.
    model_id : str
    bins : sequence of GapBin
        Axes and ends at the size of the plant; their shares are ignored.
    size : Size
        Size of the plant.
    """
    reference = ReferenceFit.from_runs(model_id, session.given_runs({}), np.random.default_rng(session.fit_seed))
    change = reference.unexplained_change(session.given_runs(effects))
    if not change.any():
        return ()
    runs = [size.scaled(run) for run in session.noise_free_runs(effects)[: len(reference.counted)]]
    energy = change**2
    series = axis_series(runs, reference.counted)
    shares = []
    for axis in dict.fromkeys(entry.axis for entry in bins):
        ends = [(entry.lower, entry.upper) for entry in bins if entry.axis == axis]
        values, weights = (series[axis], energy) if axis in series else _spectrum(runs, reference.counted, change)
        shares += [
            GapBin(axis, *pair, share) for pair, share in zip(ends, shares_of_bins(values, weights, ends), strict=True)
        ]
    return tuple(shares)


def axis_series(runs: Sequence[Run], counted: Sequence[slice]) -> dict[str, Array]:
    """Return the value of every axis but frequency at each counted sample, from runs without noise."""
    starts = np.cumsum([0.0, *(run.duration for run in runs)])
    low, high = np.quantile(np.concatenate([run.position for run in runs]), SPAN)
    scale = scales_of(runs).current
    columns: dict[str, list[Array]] = {}
    for place, (run, part) in enumerate(zip(runs, counted, strict=True)):
        velocity = np.gradient(run.position, run.time)
        acceleration = np.gradient(velocity, run.time) if run.acceleration is None else run.acceleration
        of_run = {
            "run": np.full(len(run), place + 1.0),
            "time": run.time + starts[place],
            "position": run.position,
            "velocity": np.abs(velocity),
            "acceleration": np.abs(acceleration),
            "current": run.current,
            "reversal": travel_since_reversal(run.position),
            "end": np.maximum(np.minimum(run.position - low, high - run.position), 0.0),
            "step": time_since_step(run.time, run.current, scale),
            "sign": np.sign(velocity),
        }
        for axis, values in of_run.items():
            columns.setdefault(axis, []).append(values[part])
    return {axis: np.concatenate(parts) for axis, parts in columns.items()}


def travel_since_reversal(position: Array) -> Array:
    """Return the travel in m since the direction of motion last changed, or since the start, at each sample."""
    steps = np.diff(position)
    moving = np.flatnonzero(steps)
    turns = moving[1:][steps[moving[1:]] * steps[moving[:-1]] < 0]  # the sample between two opposite steps
    travel = np.append(0.0, np.cumsum(np.abs(steps)))
    at_turn = np.zeros_like(travel)
    at_turn[turns] = travel[turns]
    return np.asarray(travel - np.maximum.accumulate(at_turn))


def shares_of_bins(values: Array, weights: Array, ends: Sequence[tuple[float, float]]) -> list[float]:
    """Return the share of the weights (n,) whose values (n,) lie in each bin.

    A bin holds its lower end; one whose ends are equal holds that value. What lies beyond the outermost bins counts to
    these, because their ends come from noisy readings.
    """
    lowest, highest = min(lower for lower, _ in ends), max(upper for _, upper in ends)
    inside = np.clip(values, lowest, highest)
    total = float(weights.sum())
    shares = []
    for lower, upper in ends:
        is_in_bin = inside == lower if lower == upper else (inside >= lower) & ((inside < upper) | (upper == highest))
        shares.append(float(weights[is_in_bin].sum()) / total)
    return shares


def _spectrum(runs: Sequence[Run], counted: Sequence[slice], change: Array) -> tuple[Array, Array]:
    """Return the frequencies in Hz and the energies in N² of the spectral lines of all runs."""
    lengths = [len(run.time[part]) for run, part in zip(runs, counted, strict=True)]
    frequencies, energies = [], []
    for run, series in zip(runs, np.split(change, np.cumsum(lengths)[:-1]), strict=True):
        frame = min(len(series), max(8, round(FRAME * run.rate)))
        frequency, density = welch(series, run.rate, "cosine", frame, detrend=False)
        frequencies.append(frequency)
        energies.append(density * len(series) * frequency[1])
    return np.concatenate(frequencies), np.concatenate(energies)
