"""Where the gap lies: excess squared error, beyond what noise explains, over every axis of the recordings."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import ndtr

from mrd_diagnosis.diagnosis import Axis, Interval, Region, RunNoise
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.recording import Recording, current_levels
from mrd_sim.path import Path

Array = NDArray[np.float64]
Codes = NDArray[np.intp]
Words = tuple[str, str, str]

BLOCK = 1.0
"""s; the residuals of a damper model forget within much less, so blocks of this length count as independent."""

FEWEST_RUNS = 4
"""With fewer, intervals come from blocks."""

FEWEST_SAMPLES = 20
"""in a bin, below which nothing is said of it."""

REVERSAL_EDGES = (0.2e-3, 0.5e-3, 1e-3, 2e-3, 5e-3)
"""m of travel since a reversal: around the usual yield travels."""


@dataclass(frozen=True)
class _Bins:
    """Bins of one axis: ends in ``unit`` and what they are called."""

    axis: Axis
    unit: str
    bounds: Sequence[tuple[float, float]]
    labels: Sequence[str]


@dataclass(frozen=True)
class _Table:
    """Sums over units (blocks of about `BLOCK`, each within one run) and bins, all (units, bins)."""

    bins: _Bins
    run: Codes  # (units,), of each unit
    excess: Array  # N²
    floor: Array  # N², what noise gives
    samples: Array


def localise(
    recordings: Sequence[Recording],
    noises: Sequence[RunNoise],
    residuals: Sequence[Array],
    rng: np.random.Generator,
    *,
    resamples: int = 400,
) -> tuple[Region, ...]:
    """Bins of every axis with their share of the excess squared error.

    The excess of a bin is the sum over its samples of r² - sigma². An axis that does not vary in these recordings is left
    out. Time since reversal is measured as travel, in m: hysteresis, play and compliance act over a length, whatever the
    speed, while what acts over a time (lag, delay) already shows over current, frequency and acceleration.

    Parameters
    ----------
    recordings : sequence of Recording
        In the order in which they were recorded: time counts through all of them.
    noises : sequence of RunNoise
    residuals : sequence of ndarray (counted samples,)
        Measured minus modelled force in N, the run's own offset and gain taken out.
    rng : numpy.random.Generator
        For the bootstrap.
    resamples : int
        Of the bootstrap.

    Returns
    -------
    tuple of Region
        The significant ones first, then by share x log(lift): what the bin contributes to the G statistic of excess against
        samples, large where much of the excess sits in a small part of the samples. Empty if there is no excess.

    Notes
    -----
    Significance is that of the sum over blocks of a bin's excess above its part of a uniform one, over the root of its sum
    of squares. Of independent blocks with symmetric errors that ratio has tails below a Gaussian's, however unequal they
    are (Efron 1969). False discoveries among all bins are controlled after Benjamini & Hochberg (1995). Excess within
    `Thresholds.noise_variance_error` of the noise's variance is not counted.

    Intervals resample runs; blocks where there are fewer than `FEWEST_RUNS`, and for the axes run and time, where each run
    has bins of its own.
    """
    tables = _tables(recordings, noises, residuals)
    regions: list[Region] = []
    p_values: list[float] = []
    for table in tables:
        excess, samples = table.excess.sum(axis=0), table.samples.sum(axis=0)
        total, uniform = excess.sum(), samples / samples.sum()
        if total <= 0.0:
            continue
        by_block = len(recordings) < FEWEST_RUNS or table.bins.axis in ("run", "time")
        units = table.excess if by_block else _by_run(table.excess, table.run)
        drawn = rng.multinomial(len(units), np.full(len(units), 1 / len(units)), size=resamples) @ units
        lower, upper = np.quantile(_shares(drawn), (0.025, 0.975), axis=0)
        shares, p = _shares(excess), _significance(table, uniform)
        for index in map(int, np.flatnonzero(samples >= FEWEST_SAMPLES)):
            share = Interval(*(float(s[index]) for s in (shares, lower, upper)))
            (first, last), label = table.bins.bounds[index], table.bins.labels[index]
            lift = share.value / float(uniform[index])
            regions.append(Region(table.bins.axis, first, last, table.bins.unit, share, lift, 1.0, label))
            p_values.append(p[index])
    q_values = _false_discovery(np.array(p_values))
    found = [replace(region, q_value=float(q)) for region, q in zip(regions, q_values, strict=True)]
    return tuple(sorted(found, key=lambda r: (r.q_value >= THRESHOLDS.q_value, -_concentration(r), r.q_value)))


def travel_since_reversal(path: Path) -> Array:
    """Travel in m since the rod last reversed (or the recording began), at each sample."""
    step = np.diff(path.position)
    moves = np.flatnonzero(step)
    turns = moves[1:][step[moves[1:]] * step[moves[:-1]] < 0]
    travel = np.append(0.0, np.cumsum(np.abs(step)))
    since = np.zeros_like(travel)
    since[turns] = travel[turns]
    return np.asarray((travel - np.maximum.accumulate(since))[path.samples])


# ---------------------------------------------------------------------------------------------------------------- tables


def _tables(recordings: Sequence[Recording], noises: Sequence[RunNoise], residuals: Sequence[Array]) -> list[_Table]:
    """Excess of every axis that varies."""
    runs = [r.run for r in recordings]
    counts = [len(r) for r in residuals]
    moved = [r.motion for r in recordings]

    def joined(series: Callable[[int], Array]) -> Array:
        return np.concatenate([series(k)[recordings[k].counted] for k in range(len(runs))])

    velocity = joined(lambda k: moved[k].velocity)
    starts = np.cumsum([0.0, *(run.duration for run in runs)])
    axes = [
        _run_bins(recordings, counts),
        _binned(
            "time",
            joined(lambda k: runs[k].time + starts[k]),
            "s",
            1.0,
            _even_edges,
            ("the first {} s of the recordings", "{} to {} s into the recordings", "from {} s of the recordings on"),
        ),
        _binned("position", joined(lambda k: moved[k].position), "m", 1e3, _even_edges, _words("positions", "mm")),
        _binned("velocity", np.abs(velocity), "m/s", 1e3, _log_edges, _words("speeds", "mm/s")),
        _binned(
            "acceleration",
            np.abs(joined(lambda k: moved[k].acceleration)),
            "m/s²",
            1.0,
            _log_edges,
            _words("accelerations", "m/s²"),
        ),
        _current_bins(joined(lambda k: runs[k].current), current_levels(runs)[0]),
        _binned(
            "reversal",
            joined(lambda k: travel_since_reversal(recordings[k].path)),
            "m",
            1e3,
            lambda _: np.array(REVERSAL_EDGES),
            ("within {} mm after a reversal", "{} to {} mm after a reversal", "more than {} mm after a reversal"),
        ),
        _sign_bins(velocity),
    ]
    squares = np.concatenate([r**2 for r in residuals])
    variance = np.concatenate([n.sigma**2 for n in noises])
    block, run_of_block = _blocks(recordings, counts)
    tables = []
    for bins, codes in axes:
        size = len(bins.labels)
        if size < 2:
            continue
        cell = block * (size + 1) + np.where(codes < 0, size, codes)

        def summed(weights: Array | None, cell: Codes = cell, size: int = size) -> Array:
            sums = np.bincount(cell, weights, minlength=len(run_of_block) * (size + 1))
            return sums.reshape(-1, size + 1)[:, :size].astype(float)

        tables.append(_Table(bins, run_of_block, summed(squares - variance), summed(variance), summed(None)))
    return [*tables, *_frequency(recordings, noises, residuals)]


def _blocks(recordings: Sequence[Recording], counts: Sequence[int]) -> tuple[Codes, Codes]:
    """Block of every sample, and run of every block."""
    blocks, runs, first = [], [], 0
    for place, (recording, count) in enumerate(zip(recordings, counts, strict=True)):
        many = max(1, round(count / recording.run.rate / BLOCK))
        blocks.append(first + np.arange(count) * many // count)
        runs += [place] * many
        first += many
    return np.concatenate(blocks), np.array(runs)


def _frequency(recordings: Sequence[Recording], noises: Sequence[RunNoise], residuals: Sequence[Array]) -> list[_Table]:
    """Excess over frequency, from half-overlapping frames whose squared sine windows sum to one: no energy is lost.

    The force sensor's noise is white. The error of the measured motion and current has the spectrum of what the smoother
    lets pass: flat up to its time constant. Bands are equally wide on a logarithmic scale, and each counts as many samples
    as another: excess in proportion to their width in Hz would be found nowhere but at the lowest frequencies.
    """
    fastest = max(r.run.rate for r in recordings) / 2
    inner = _log_edges(np.array([fastest]), 3.0, (1, 3))
    inner = inner[inner >= 1.0 / BLOCK]
    bins = _named("frequency", "Hz", np.array([0.0, *inner, fastest]), 1.0, _words("frequencies", "Hz"))
    parts = []
    for place, (recording, noise, residual) in enumerate(zip(recordings, noises, residuals, strict=True)):
        rate = recording.run.rate
        hop = max(8, min(round(BLOCK * rate), len(residual) // 4))
        window = np.sin(np.pi * (np.arange(2 * hop) + 0.5) / (2 * hop))
        padded = np.pad(np.stack([residual, noise.sigma]), ((0, 0), (hop, hop + -len(residual) % hop)))
        framed, sigma = sliding_window_view(padded, 2 * hop, axis=1)[:, ::hop] * window
        spectrum = np.abs(np.fft.rfft(framed)) ** 2 / (2 * hop)
        spectrum[:, 1:-1] *= 2.0  # the negative frequencies
        frequency = np.fft.rfftfreq(2 * hop, 1 / rate)
        degrees = np.full(len(frequency), 2.0)
        degrees[[0, -1]] = 1.0
        time_constant = recording.motion.time_constant
        low_pass = degrees / (1.0 + (2 * np.pi * frequency * time_constant) ** 2) if np.isfinite(time_constant) else degrees
        variance = (sigma**2).sum(axis=1)
        force = np.minimum(((sigma > 0) * (window * noise.force) ** 2).sum(axis=1), variance)
        floor = np.outer(force, degrees / degrees.sum()) + np.outer(variance - force, low_pass / low_pass.sum())
        starts = np.searchsorted(frequency, [0.0, *inner])
        present = starts < len(frequency)
        sums = np.zeros((3, len(framed), len(starts)))
        for target, values in zip(sums[:2], (spectrum - floor, floor), strict=True):
            target[:, present] = np.add.reduceat(values, starts[present], axis=1)
        sums[2, :, present] = (sigma > 0).sum(axis=1)
        parts.append((np.full(len(framed), place), *sums))
    return [_Table(bins, *(np.concatenate(column) for column in zip(*parts, strict=True)))]


# ------------------------------------------------------------------------------------------------------------------ bins


def _run_bins(recordings: Sequence[Recording], counts: Sequence[int]) -> tuple[_Bins, Codes]:
    places = [(float(k), float(k)) for k in range(1, len(recordings) + 1)]
    bins = _Bins("run", "", places, [f"run {r.run.name}" for r in recordings])
    return bins, np.repeat(np.arange(len(recordings)), counts)


def _sign_bins(velocity: Array) -> tuple[_Bins, Codes]:
    codes = np.where(velocity < 0, 0, np.where(velocity > 0, 1, -1))
    return _Bins("sign", "", [(-1.0, -1.0), (1.0, 1.0)], ["while compressing", "while extending"]), codes


def _current_bins(current: Array, levels: int) -> tuple[_Bins, Codes]:
    """The levels that the current dwells at, if there are few; else even bins."""
    if levels < 2:
        return _Bins("current", "A", [], []), np.zeros(len(current), dtype=np.intp)
    counts, edges = np.histogram(current, 64)
    occupied = np.flatnonzero(counts > 0.002 * len(current))
    gaps = np.flatnonzero(np.diff(occupied) > 1)
    inner = 0.5 * (edges[occupied[gaps] + 1] + edges[occupied[gaps + 1]])
    if not 1 <= len(inner) <= 8:
        return _binned("current", current, "A", 1.0, _even_edges, ("up to {} A", "at {} to {} A", "above {} A"))
    codes = np.searchsorted(inner, current)
    ends = [float(current.min()), *map(float, inner), float(current.max())]
    labels = []
    for level in range(len(inner) + 1):
        low, middle, high = np.quantile(current[codes == level], (0.05, 0.5, 0.95))
        # Levels that noise makes overlap are one bin.
        wide = high - low > 0.1 * np.ptp(current)
        labels.append(f"at {_short(low)} to {_short(high)} A" if wide else f"at {_short(middle)} A")
    return _Bins("current", "A", list(itertools.pairwise(ends)), labels), codes


def _binned(
    axis: Axis, values: Array, unit: str, shown: float, edges: Callable[[Array], Array], words: Words
) -> tuple[_Bins, Codes]:
    """Bins between ``edges`` of the values; labels in units of 1 / ``shown``."""
    inner = edges(values)
    low, high = float(values.min()), float(values.max())
    inner = inner[(inner > low) & (inner < high)]
    return _named(axis, unit, np.array([low, *inner, high]), shown, words), np.searchsorted(inner, values, "right")


def _named(axis: Axis, unit: str, edges: Array, shown: float, words: Words) -> _Bins:
    """Bins between edges, the ends of the axis included; none if these are all."""
    bounds = list(itertools.pairwise(map(float, edges)))
    if len(bounds) < 2:
        return _Bins(axis, unit, [], [])
    first, between, last = words
    inner = [_short(edge * shown) for edge in edges[1:-1]]
    labels = [first.format(inner[0]), *(between.format(*pair) for pair in itertools.pairwise(inner)), last.format(inner[-1])]
    return _Bins(axis, unit, bounds, labels)


def _words(things: str, unit: str) -> Words:
    return f"{things} below {{}} {unit}", f"{things} of {{}} to {{}} {unit}", f"{things} above {{}} {unit}"


def _short(value: float) -> str:
    return f"{round(value, 2) + 0.0:.4g}".replace("-", "\u2212")


def _even_edges(values: Array) -> Array:
    """Inner edges at multiples of 1, 2 or 5 times a power of ten: at most eight bins."""
    low, high = np.quantile(values, (0.002, 0.998))
    if high <= low:
        return np.empty(0)
    exponent = np.floor(np.log10((high - low) / 7))
    step = next(s for s in 10.0**exponent * np.array([1, 2, 5, 10]) if (high - low) / s <= 7)
    return np.asarray(np.arange(np.floor(low / step) + 1, np.ceil(high / step)) * step)


def _log_edges(values: Array, decades: float = 2.0, series: Sequence[int] = (1, 2, 5)) -> Array:
    """Inner edges at a preferred series of numbers within the uppermost ``decades`` of the values."""
    high = float(np.quantile(values, 0.998))
    if high <= 0.0:
        return np.empty(0)
    top = int(np.floor(np.log10(high)))
    candidates = np.outer(10.0 ** np.arange(top - np.ceil(decades), top + 1), series).ravel()
    return np.asarray(candidates[(candidates > high / 10**decades) & (candidates < high)])


# ------------------------------------------------------------------------------------------------------------ statistics


def _by_run(units: Array, run: Codes) -> Array:
    return np.stack([units[run == k].sum(axis=0) for k in range(int(run.max()) + 1)])


def _shares(excess: Array) -> Array:
    """Share of each bin, the last axis, between 0 and 1."""
    total = excess.sum(axis=-1, keepdims=True)
    return np.asarray(np.clip(excess / np.maximum(total, 1e-12 * np.abs(excess).sum(axis=-1, keepdims=True) + 1e-300), 0, 1))


def _significance(table: _Table, uniform: Array) -> Array:
    """One-sided p-value of each bin: more excess than uniform."""
    above = table.excess - THRESHOLDS.noise_variance_error * table.floor - np.outer(table.excess.sum(axis=1), uniform)
    return np.asarray(ndtr(-above.sum(axis=0) / np.sqrt((above**2).sum(axis=0) + 1e-300)))


def _false_discovery(p_values: Array) -> Array:
    """q-values (Benjamini & Hochberg 1995)."""
    order = np.argsort(p_values)[::-1]
    ranks = np.arange(len(p_values), 0, -1)
    found = np.empty_like(p_values)
    found[order] = np.minimum.accumulate(np.minimum(p_values[order] * len(p_values) / ranks, 1.0))
    return found


def _concentration(region: Region) -> float:
    return region.share.value * float(np.log(max(region.lift, 1e-12)))
