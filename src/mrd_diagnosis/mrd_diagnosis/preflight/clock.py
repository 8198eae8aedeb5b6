"""Clock and sample rates."""

from collections.abc import Iterator, Sequence

import numpy as np

from mrd_diagnosis.diagnosis import Finding
from mrd_diagnosis.preflight.channels import LOW_RATE, RATES, View, milli

GAP = 1.5
"""Median intervals; a longer one lacks at least one sample."""
LOST = 0.1
"""Share of missing or held samples from which a run is useless: hysteresis goes on in the gaps."""
BUNCHED = 0.1
"""Median intervals; two samples closer than this are hardly two readings."""
JITTER = (0.02, 0.2)
"""Median intervals rms: worth a remark; so much that sampling was not steered by hardware."""


def clock(view: View) -> Iterator[Finding]:
    """Samples that are missing, doubled, or at uneven intervals."""
    intervals = np.diff(view.run.time) / view.interval
    usual = (intervals < GAP) & (intervals > BUNCHED)
    late = intervals[intervals >= GAP]
    missing = int(np.sum(np.round(late) - 1))
    if missing:
        share = missing / (missing + len(view.run))
        yield view.finding(
            "gap",
            "fault" if share > LOST else "limitation",
            "time",
            f"{missing} samples ({100 * share:.2g} %) are missing in {len(late)} gaps, the longest {late.max():.1f} "
            f"intervals, expected none; what the damper did there is lost: look at the DAQ"
            f"{' and record it again' if share > LOST else ''}",
        )
    bunched = int(np.sum(intervals <= BUNCHED))
    if bunched:
        yield view.finding(
            "clock",
            "limitation",
            "time",
            f"{bunched} samples follow the one before within {BUNCHED:g} intervals, expected equal intervals of "
            f"{milli(view.interval)} ms; look for samples written twice",
        )
    jitter = float(np.std(intervals[usual])) if usual.any() else 0.0
    if jitter > JITTER[0]:
        yield view.finding(
            "clock",
            "limitation" if jitter > JITTER[1] else "remark",
            "time",
            f"intervals scatter by {100 * jitter:.2g} % rms, expected less than {100 * JITTER[0]:g} %; if these are not the "
            "times of sampling but of writing, forces near reversals carry that error: sample by a hardware clock",
        )


def rates(views: Sequence[View]) -> Iterator[Finding]:
    """Runs sampled at different rates, or too slowly for a damper."""
    rates = np.array([1 / view.interval for view in views])
    if rates.max() > (1 + RATES) * rates.min():
        yield Finding(
            "clock",
            "remark",
            f"runs are sampled at {rates.min():.4g} to {rates.max():.4g} Hz; what is fast shows in the faster ones only",
        )
    slow = [view for view in views if view.slow]
    if slow:
        longest = max(view.interval for view in slow)
        travel = max(view.speed * view.interval for view in slow)
        which = "all runs" if len(slow) == len(views) else ", ".join(view.run.name for view in slow)
        yield Finding(
            "aliasing",
            "limitation",
            f"{which}: one sample every {milli(longest)} ms, in which the rod moves up to {milli(travel)} mm; time "
            "constants and lost travel below about that, and anything above "
            f"{0.5 / longest:.3g} Hz, cannot be seen: sample at {LOW_RATE:g} Hz at least, better 1 kHz",
            slow[0].run.name if len(slow) == 1 else "",
        )
