"""Localisation of the gap: excess squared error, beyond what noise explains, over every axis of the recordings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import false_discovery_control

from mrd_diagnosis.diagnosis import Interval, Region, RunNoise
from mrd_diagnosis.localisation.axis_bins import NEAR_LABELS, PLACES
from mrd_diagnosis.localisation.excess_tables import ExcessTable, excess_tables
from mrd_diagnosis.localisation.oscillation import highest_frequency_of_motion
from mrd_diagnosis.localisation.units import BETWEEN_UNITS
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.recording import Recording
from mrd_identification.resampling import half_width

Array = NDArray[np.float64]

PREFERENCE = 1.5
"""Factor of the concentration of a place that counts from an event: it says what to look at; a run or a level does not."""

LEAST_SAMPLES_OF_BIN = 20
"""Samples below which nothing is said about a bin."""


def localise(recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]) -> tuple[Region, ...]:
    """Return the bins of every axis with their share of the excess squared error.

    The excess of a bin is the sum of r² - sigma² over its samples. An axis that does not vary in these recordings is left
    out. Travel since the last reversal takes the place of time since then, because hysteresis, play and compliance act over
    a length at any speed.

    Parameters
    ----------
    recordings : sequence of Recording
        In the order in which they were recorded: time counts through all of them.
    noise : sequence of RunNoise
    residuals : sequence of ndarray (counted samples,)
        Measured minus modelled force in N, without the run's offset and gain error.

    Returns
    -------
    tuple of Region
        The significant ones first, of these the `PLACES`, then by share x log(lift). This is the contribution of the bin to
        the G statistic of excess against samples, large where a small part of the samples has much of the excess. Places
        that count from an event are preferred. The frequencies of the motion itself come last. Empty without excess.

    Notes
    -----
    The units are strokes (`mrd_diagnosis.localisation.units`). Of each unit, the excess in the bin is compared with what the
    bin would have if the excess of the unit were spread evenly over its samples. So an error that is large in some strokes
    or runs is not mistaken for one that is large in what these strokes have more of. Bins of time, run and current hold
    whole units; there, the excess of all recordings is spread evenly.

    The test statistic is the sum of these differences over the units, divided by the root of their sum of squares. Where
    bins are compared within units, a unit of much excess counts less than in proportion, so that one stroke does not decide
    alone: what is expected of a bin within its unit is the same for any excess of the unit. For
    independent units with symmetric errors, its tails are below those of a normal variable, however unequal the units are
    (Efron 1969). The false-discovery rate over all bins is controlled after Benjamini & Hochberg (1995). Excess within
    `Thresholds.noise_variance_error` of the noise variance is not counted. With 3 to 30 units, simulated without a
    place, the test alarms no more often than its p-value says. Intervals are those of a ratio of sums over independent
    units, by Student's t.
    """
    regions: list[Region] = []
    p_values: list[float] = []
    for table in excess_tables(recordings, noise, residuals):
        regions_of_axis, p_values_of_axis = _regions(table)
        regions += regions_of_axis
        p_values += p_values_of_axis
    if not regions:
        return ()
    q_values = false_discovery_control(p_values)
    motion = highest_frequency_of_motion(recordings)
    regions = [replace(region, q_value=float(q)) for region, q in zip(regions, q_values, strict=True)]
    return tuple(sorted(regions, key=lambda region: _rank(region, motion)))


def _rank(region: Region, highest_frequency_of_motion: float) -> tuple[bool, bool, bool, float]:
    """Return what regions are sorted by."""
    is_of_motion = region.axis == "frequency" and region.lower <= highest_frequency_of_motion
    concentration = region.share.value * float(np.log(max(region.lift, 1e-12)))
    if region.axis in NEAR_LABELS:
        concentration *= PREFERENCE
    return is_of_motion, not region.significant, region.axis not in PLACES, -concentration


def _regions(table: ExcessTable) -> tuple[list[Region], list[float]]:
    """Return the regions of one axis and their p-values; none without excess."""
    excess, samples = table.excess.sum(axis=0), table.samples.sum(axis=0)
    total = excess.sum()
    if total <= 0.0:
        return [], []
    uniform = samples / samples.sum()
    shares = np.clip(excess / total, 0.0, 1.0)
    deviations = np.sqrt(np.sum((table.excess - np.outer(table.excess.sum(axis=1), shares)) ** 2, axis=0)) / total
    lifts = shares / np.maximum(uniform, np.finfo(float).tiny)
    p_values = np.where(lifts > 1.0, _p_values(table, uniform), 1.0)
    half_widths = half_width(int((table.samples.sum(axis=1) > 0).sum())) * deviations
    counted = list(map(int, np.flatnonzero(samples >= LEAST_SAMPLES_OF_BIN)))
    regions = []
    for index in counted:
        share, half = float(shares[index]), float(half_widths[index])
        interval = Interval(share, *map(float, np.clip((share - half, share + half), 0.0, 1.0)))
        (first, last), label = table.bins.bounds[index], table.bins.labels[index]
        regions.append(Region(table.bins.axis, first, last, table.bins.unit, interval, float(lifts[index]), 1.0, label))
    return regions, [float(p_values[index]) for index in counted]


def _p_values(table: ExcessTable, uniform: Array) -> Array:
    """Return the one-sided p-value of each bin for more excess than a uniform distribution gives."""
    of_unit, samples = table.excess.sum(axis=1, keepdims=True), table.samples.sum(axis=1, keepdims=True)
    parts, weights = uniform, np.ones_like(of_unit)
    if table.bins.axis not in BETWEEN_UNITS:
        parts = table.samples / np.maximum(samples, 1.0)
        weights = 1.0 / (np.abs(of_unit) + np.abs(of_unit).mean())
    above = weights * (table.excess - THRESHOLDS.noise_variance_error * table.noise - of_unit * parts)
    return np.asarray(ndtr(-above.sum(axis=0) / np.sqrt((above**2).sum(axis=0) + 1e-300)))
