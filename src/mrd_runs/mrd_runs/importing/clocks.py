"""The times of one series: which of them are wrong, where its clock was set back, and how often it repeats a time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter1d, median_filter

from mrd_runs.run import FEWEST_SAMPLES

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_WINDOW = 7
"""Times whose median tells where each belongs: up to three wrong ones in a row stand out."""
_FAR, _FAR_FROM_RECEIPT = 10.0, 1.0
"""Distance from where a time belongs, in sampling intervals and in s, from which it is wrong rather than out of order."""
_FAR_END = 100.0
"""Distance of the first or last times from all others, relative to how long these last, from which they are wrong."""
_JITTER = 20.0
"""Jump back in terms of the median deviation of a time from where it belongs, from which the clock was set back."""
_GAP = 5.0
"""Gap between two blocks of a file in usual steps, from which they are two passes."""
_LATE = 20
"""Samples in a row that may have been written late, and are no pass of their own."""
_ROUNDED = (0.02, 0.5)
"""Last digit of the times, relative to the sampling interval, of which the rounding is removed: a larger step may be that of
a missing sample."""
_OFF_SINGLE = 0.3
"""Distance of times from numbers of single precision, relative to the distance of these, up to which they were such numbers.
Any other times are up to half of it away, as are those that were written with as few digits as tell them apart."""
_FEW_TIMES = 200
"""Times of which it is looked at whether they were written so."""
_MOST_STEPS = 8
"""Different steps between times of few digits."""
MOST_REPEATS = 0.05
"""Share of times that repeat another one, above which a clock is too coarse to tell the times of the samples."""


@dataclass(frozen=True)
class Passes:
    """What the times of a series tell.

    Attributes
    ----------
    pieces : list of ndarray of int
        Indices of the samples of each pass in the order of their times. A clock that was set back begins another pass.
    jumps : list of float
        How far the clock went back before each pass but the first, in s; negative where it went on.
    told : list of str
        Clauses about samples that are in no pass, or out of order.
    repeats : float
        Share of the samples that have the time of another one.
    """

    pieces: list[Indices]
    jumps: list[float]
    told: list[str]
    repeats: float

    def unrepeated(self, time: Array) -> "Passes":
        """Return the passes without the later ones of samples of equal time."""
        pieces = [piece[np.diff(time[piece], prepend=-np.inf) > 0] for piece in self.pieces]
        dropped = sum(map(len, self.pieces)) - sum(map(len, pieces))
        told = [f"{dropped} with the time of another one {'was' if dropped == 1 else 'were'} dropped"] if dropped else []
        return Passes(pieces, self.jumps, self.told + told, self.repeats)


def find_passes(
    time: Array, receipt: Array | None = None, *, any_order: bool = False, unset: float = 0.0, blocks: Sequence[int] = ()
) -> Passes:
    """Find the passes of a clock in the times of a series.

    Parameters
    ----------
    time : ndarray (n,)
        Times in s, in the order in which the samples were written.
    receipt : ndarray (n,), optional
        Times in s of another clock, which is known to run steadily: it shows a wrong time at once.
    any_order : bool
        Whether whole parts may have been written in any order, so that a jump back is no pass of its own as long as no two
        parts cover the same time, and only what is far from nearly all others is wrong.
    unset : float
        Value of a time that nobody has set.
    blocks : sequence of int
        Indices at which a block of the file begins: a gap there parts two passes.
    """
    finite = np.flatnonzero(np.isfinite(time))
    if len(finite) < len(time):
        found = find_passes(
            time[finite],
            None if receipt is None else receipt[finite],
            any_order=any_order,
            unset=unset,
            blocks=np.searchsorted(finite, blocks).tolist(),
        )
        told = [f"{len(time) - len(finite)} of {len(time)} without a time dropped", *found.told]
        return replace(found, pieces=[finite[piece] for piece in found.pieces], told=told)
    wrong = _find_far(time) if any_order else _find_wrong(time, receipt, unset)
    kept = np.flatnonzero(~wrong)
    ordered = time[kept]
    begins = np.searchsorted(kept, blocks)
    gaps = np.diff(ordered, prepend=ordered[:1])
    cuts = sorted(
        {
            *_find_resets(ordered, any_order),
            *(int(k) for k in begins if 0 < k < len(ordered) and gaps[k] > _GAP * usual_step(ordered)),
        }
    )
    jumps = [float(ordered[cut - 1] - ordered[cut]) for cut in cuts]
    pieces = [kept[begin:end] for begin, end in pairwise([0, *cuts, len(kept)])]
    told = []
    if wrong.any():
        count, value = int(wrong.sum()), float(time[wrong][0])
        shown = "it was never set" if value == unset else f"{abs(value - float(np.median(time))):.4g} s away"
        has = "has a time" if count == 1 else "have times"
        told.append(
            f"{count} of {len(time)} {has} far from all others ({shown}) and {'was' if count == 1 else 'were'} dropped"
        )
    if len(pieces) > 1 and any(len(piece) >= FEWEST_SAMPLES for piece in pieces):
        short = [len(piece) for piece in pieces if len(piece) < FEWEST_SAMPLES]
        if short:
            told.append(f"{len(short)} passes of fewer than {FEWEST_SAMPLES} samples were dropped")
        jumps = [jump for jump, piece in zip(jumps, pieces[1:], strict=True) if len(piece) >= FEWEST_SAMPLES]
        pieces = [piece for piece in pieces if len(piece) >= FEWEST_SAMPLES]
        jumps = jumps[-(len(pieces) - 1) :] if len(pieces) > 1 else []
    late = sum(int(np.count_nonzero(np.diff(time[piece]) < 0)) for piece in pieces)
    if late:
        told.append(f"{late} came out of order and {'was' if late == 1 else 'were'} sorted")
    pieces = [piece[np.argsort(time[piece], kind="stable")] for piece in pieces]
    equal = sum(int(np.count_nonzero(np.diff(time[piece]) == 0)) for piece in pieces)
    return Passes(pieces, jumps, told, equal / max(1, len(kept)))


def without_rounding(time: Array, order: Passes) -> tuple[Array, str]:
    """Return times without the rounding of clocks of few digits, where the samples are evenly spaced within it.

    Parameters
    ----------
    time : ndarray (n,)
        In s, as they are written, such as 0.003, 0.007, 0.010 for 300 Hz in whole milliseconds.
    order : Passes
        Of these times.

    Returns
    -------
    time : ndarray (n,)
    told : str
        What was done; "" where nothing was.
    """
    even, told = time.copy(), ""
    for piece in order.pieces:
        if len(piece) < FEWEST_SAMPLES:
            return time, ""
        (digit, off), largest = _single_precision(time[piece]), 1.0
        if not digit:
            digit, off, largest = _last_digit(np.diff(time[piece])), 0.0, _ROUNDED[1]
        number = np.arange(len(piece))
        slope, start = np.polyfit(number, time[piece], 1)
        line = start + slope * number
        if not _ROUNDED[0] <= digit / slope <= largest or np.ptp(time[piece] - line) > 1.1 * digit + 2.0 * off:
            return time, ""
        even[piece] = line
        told = f"rounded to {digit:.3g} s; within that, the samples are evenly spaced at {1 / slope:.6g} Hz, and put there"
    return even, told


def _last_digit(steps: Array) -> float:
    """Return the last digit of times in s, by the few sizes that their steps have; 0 where they have one or many."""
    usual = np.median(steps)
    sizes = np.unique(np.round(steps / max(usual, 1e-300), 4)) * usual
    return float(np.diff(sizes).min()) if 2 <= len(sizes) <= _MOST_STEPS else 0.0


def _single_precision(time: Array) -> tuple[float, float]:
    """Return the distance in s of neighbouring numbers of single precision, where times are such numbers, and how far times
    are off them; 0 elsewhere.

    Those of a clock that has run for hours are further apart than samples are, and text may round them once more.
    """
    single = float(np.spacing(np.float32(np.abs(time).max())))
    off = float(np.abs(time - time.astype(np.float32)).max())
    few = time[:: max(1, len(time) // _FEW_TIMES)]
    is_single = off <= _OFF_SINGLE * single or all(float(str(np.float32(number))) == number for number in few)
    return (single, off) if is_single and np.ptp(np.diff(time)) > 0.5 * single else (0.0, 0.0)


def are_copies(time: Array, columns: Sequence[Array]) -> bool:
    """Return whether each row that repeats a time is a copy of the row before."""
    again = np.flatnonzero(np.diff(time) == 0) + 1
    return all(np.array_equal(values[again], values[again - 1]) for values in columns)


def usual_step(time: Array) -> float:
    """Return the usual interval between times, in s; infinite where they do not advance."""
    steps = np.diff(time)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf


def _find_far(time: Array) -> NDArray[np.bool_]:
    """Return which times lie far from nearly all others, whatever their order."""
    low, middle, high = np.percentile(time, (5, 50, 95))
    return np.asarray(np.abs(time - middle) > max(_FAR_END * (high - low), _FAR_FROM_RECEIPT))


def _find_wrong(time: Array, receipt: Array | None, unset: float) -> NDArray[np.bool_]:
    """Return which times lie far from where their neighbours are."""
    if len(time) < _WINDOW:
        return np.zeros(len(time), bool)
    step = usual_step(time)
    distance = np.abs(time - median_filter(time, _WINDOW, mode="mirror"))
    goes_back = np.zeros(len(time), bool)
    goes_back[1:] = np.diff(time) < 0
    near = binary_dilation(goes_back, np.ones(_WINDOW, bool))
    wrong = near & (distance > _FAR * step)
    if receipt is not None:
        offset = time - receipt
        late = np.abs(offset - median_filter(offset, _WINDOW, mode="mirror"))
        least = max(_FAR * step, _FAR_FROM_RECEIPT)
        away = np.abs(offset - np.median(offset))
        # Many that lie far away are another pass, few are not.
        far = away > max(least, float(np.ptp(receipt)))
        far &= np.count_nonzero(far) <= MOST_REPEATS * len(time)
        return np.asarray(wrong | far | ((time == unset) & (away > least)) | (late > least))
    side = _WINDOW // 2
    inner = float(np.ptp(time[side:-side]))
    at_end = np.ones(len(time), bool)
    at_end[side:-side] = False
    kept = np.flatnonzero(~wrong)
    gaps = np.abs(np.diff(time[kept]))
    alone = np.zeros(len(time), bool)
    alone[kept] = np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf)) > _FAR * step
    return np.asarray(wrong | (at_end & ((distance > _FAR_END * inner) | (alone & (time == unset)))))


def _find_resets(time: Array, any_order: bool) -> list[int]:
    """Return the indices from which the clock runs through times again that it had already, or stays before them."""
    backward = np.flatnonzero(np.diff(time) < 0) + 1
    if not len(backward):
        return []
    step = usual_step(time)
    # What jitters goes back often, but not far.
    jitter = float(np.median(np.abs(time - median_filter(time, _WINDOW, mode="nearest"))))
    latest = maximum_filter1d(time, _WINDOW, origin=_WINDOW // 2)[backward - 1]
    begins = np.concatenate([[0], backward])
    lowest, highest = np.minimum.reduceat(time, begins), np.maximum.reduceat(time, begins)
    # Where two passes cover the same time, it has twice as many samples.
    every, lower = np.sort(time), np.maximum(time[backward], lowest[:-1])
    covered = np.searchsorted(every, latest, "right") - np.searchsorted(every, lower, "left")
    least = max(_JITTER * jitter, _FAR * step if any_order else 0.0)
    again = (covered > 1.5 * ((latest - lower) / step + 1) + 1) & (latest - time[backward] > least)
    if not any_order:  # a part that was written late goes on after what is there already
        again |= (highest[1:] < latest) & (np.diff(begins, append=len(time))[1:] > _LATE)
    resets = []
    low = float(lowest[0])
    for cut, is_again, least, most in zip(backward, again, lowest[1:], highest[1:], strict=True):
        if is_again or (not any_order and most < low):
            resets.append(int(cut))
            low = float(least)
        else:
            low = min(low, float(least))
    return resets
