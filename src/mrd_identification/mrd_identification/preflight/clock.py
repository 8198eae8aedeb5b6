"""Checks of the clock: missing samples, uneven intervals, sample rates."""

from collections.abc import Iterator, Sequence

import numpy as np

from mrd_identification.preflight.channels import LOW_RATE, RATE_TOLERANCE, CheckedRun, counted, milli
from mrd_identification.preflight.finding import Finding

GAP_INTERVALS = 1.5
"""Interval, in median intervals, from which at least one sample is missing."""
BUNCHED_INTERVALS = 0.1
"""Interval, in median intervals, below which two samples are hardly two readings."""
USELESS_LOSS = 0.1
"""Share of missing or held samples from which a run is useless: the hysteretic state moves on in the gaps."""
NOTABLE_JITTER = 0.02
"""Rms deviation of the intervals, in median intervals, from which a remark is made."""
UNSTEERED_JITTER = 0.2
"""Rms deviation of the intervals, in median intervals, from which no hardware clock can have steered the sampling."""


def check_clock(checked: CheckedRun) -> Iterator[Finding]:
    """Find samples that are missing, doubled, or at uneven intervals."""
    intervals = np.diff(checked.run.time) / checked.sampling_interval
    long = intervals[intervals >= GAP_INTERVALS]
    missing = int(np.sum(np.round(long) - 1))
    if missing:
        share = missing / (missing + len(checked.run))
        useless = share > USELESS_LOSS
        text = (
            f"{counted(missing, 'sample')} ({100 * share:.2g} %) missing in {counted(len(long), 'gap')}: the longest gap is "
            f"{long.max():.1f} sampling intervals, expected 1. What the damper did in the gaps is lost. Check the data "
            f"acquisition{' and record the run again' if useless else ''}."
        )
        yield checked.finding("gap", "fault" if useless else "limitation", "time", text)
    bunched = int(np.sum(intervals <= BUNCHED_INTERVALS))
    if bunched:
        text = (
            f"{counted(bunched, 'sample')} less than {BUNCHED_INTERVALS:g} sampling intervals after the one before: "
            f"expected equal intervals of {milli(checked.sampling_interval)} ms. Check whether samples were written twice."
        )
        yield checked.finding("clock", "limitation", "time", text)
    usual = (intervals < GAP_INTERVALS) & (intervals > BUNCHED_INTERVALS)
    jitter = float(np.std(intervals[usual])) if usual.any() else 0.0
    if jitter > NOTABLE_JITTER:
        text = (
            f"the sampling intervals vary by {100 * jitter:.2g} % rms: expected less than {100 * NOTABLE_JITTER:g} %. If "
            "these are times of writing and not of sampling, the force near reversals has this error in time. Sample with "
            "a hardware clock."
        )
        yield checked.finding("clock", "limitation" if jitter > UNSTEERED_JITTER else "remark", "time", text)


def check_sample_rates(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    """Find runs with different sample rates, and rates that are too low for a damper."""
    rates = np.array([1 / checked.sampling_interval for checked in runs])
    if rates.max() > (1 + RATE_TOLERANCE) * rates.min():
        text = (
            f"the runs have different sample rates: {rates.min():.4g} to {rates.max():.4g} Hz, expected one rate. Fast "
            "effects show only in the runs with the higher rates."
        )
        yield Finding("clock", "remark", text)
    slow = [checked for checked in runs if checked.is_slowly_sampled]
    if slow:
        longest = max(checked.sampling_interval for checked in slow)
        travel = max(checked.top_speed * checked.sampling_interval for checked in slow)
        names = "all runs" if len(slow) == len(runs) else ", ".join(checked.run.name for checked in slow)
        text = (
            f"the sample rate is low in {names}: there is one sample every {milli(longest)} ms, in which the rod moves up "
            f"to {milli(travel)} mm. Shorter time constants, smaller lost motion and signals above {0.5 / longest:.3g} Hz "
            f"cannot be seen. Sample at {LOW_RATE:g} Hz or more, better at 1 kHz."
        )
        yield Finding("aliasing", "limitation", text, slow[0].run.name if len(slow) == 1 else "")
