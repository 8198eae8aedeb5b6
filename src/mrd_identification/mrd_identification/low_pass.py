"""Low-pass filters that recordings are processed with, before they come here."""

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.ndimage import uniform_filter1d

from mrd_base import InputError
from mrd_runs import Run

Array = NDArray[np.float64]

Kind = Literal[
    "none",
    "first_order",
    "second_order",
    "fourth_order",
    "zero_phase",
    "zero_phase_fourth_order",
    "moving_average",
    "unknown",
]

_ORDERS: dict[str, int] = {"first_order": 1, "second_order": 2, "fourth_order": 4}
_ZERO_PHASE_ORDERS: dict[str, int] = {"zero_phase": 2, "zero_phase_fourth_order": 4}

_WINDOW = 0.4429
"""Cut-off of a moving average times its window: sinc(0.4429) = 1 / sqrt(2)."""

_SAME_DELAY = 0.1
"""Share of the window by which the delay of a moving average of past samples may differ from half the window."""

GRAMMAR = "lowpass:HZ[:ORDER][:zero-phase] with the order 1, 2 or 4 (default 2), or average:SECONDS[:past]"


@dataclass(frozen=True)
class LowPass:
    """A low-pass filter.

    Attributes
    ----------
    kind : str
        ``first_order``, ``second_order`` and ``fourth_order`` (Butterworth) filters delay the signal, as filters of
        instruments do. ``zero_phase`` and ``zero_phase_fourth_order`` filters, which are Butterworth filters of second and
        fourth order run forwards and backwards, and a ``moving_average`` do not. ``unknown`` where only the cut-off is
        known.
    cutoff : float
        Frequency in Hz at which the signal is lowered by 3 dB, by a zero-phase filter in each of its two runs.
    delay : float
        Further delay in s; half the window for a moving average of past samples.
    """

    kind: Kind
    cutoff: float
    delay: float = 0.0

    @property
    def window(self) -> float:
        """Length in s of the moving average with this cut-off."""
        return _WINDOW / self.cutoff

    @property
    def word(self) -> str:
        """The filter as `parse_low_pass` reads it; empty where not enough is known."""
        if self.kind == "moving_average":
            return f"average:{self.window:.3g}{':past' * self.is_of_the_past}"
        if not self.order:
            return ""
        order = "" if self.order == 2 else f":{self.order}"
        return f"lowpass:{self.cutoff:.3g}{order}{':zero-phase' * self.is_zero_phase}"

    @property
    def order(self) -> int:
        """Order of a Butterworth filter; 0 for any other."""
        return (_ORDERS | _ZERO_PHASE_ORDERS).get(self.kind, 0)

    @property
    def is_zero_phase(self) -> bool:
        """Whether a Butterworth filter was run forwards and backwards."""
        return self.kind in _ZERO_PHASE_ORDERS

    @property
    def is_of_the_past(self) -> bool:
        """Whether a moving average is that of past samples."""
        return self.kind == "moving_average" and abs(self.delay - self.window / 2) < _SAME_DELAY * self.window

    def response(self, frequency: Array) -> NDArray[np.complex128]:
        """Return the complex factor (n,) of oscillations with these frequencies in Hz, without the further delay."""
        if self.is_zero_phase:
            return np.asarray(1 / (1 + (frequency / self.cutoff) ** (2 * self.order)), np.complex128)
        if self.order:
            numerator, denominator = signal.butter(self.order, 1.0, analog=True)
            return np.asarray(signal.freqs(numerator, denominator, frequency / self.cutoff)[1], np.complex128)
        if self.kind == "moving_average":
            return np.asarray(np.sinc(frequency * self.window), np.complex128)
        return np.ones(len(frequency), np.complex128)

    def filtered(self, series: NDArray[Any], rate: float) -> NDArray[Any]:
        """Return a series (n, ...), real or complex, sampled at a rate in Hz, behind the filter.

        It rests at its first value before it begins. A further delay counts only for a moving average of past samples.
        """
        if self.kind == "moving_average":
            samples = max(1, round(self.window * rate))
            late = samples - 1 - samples // 2 if self.is_of_the_past else 0
            return np.asarray(uniform_filter1d(series, samples, axis=0, mode="nearest", origin=late))
        sections = signal.butter(self.order, self.cutoff, fs=rate, output="sos")
        if self.is_zero_phase:
            return np.asarray(signal.sosfiltfilt(sections, series, axis=0))
        return np.asarray(signal.sosfilt(sections, series - series[:1], axis=0) + series[:1])


def moving_average(window: float, delay: float = 0.0) -> LowPass:
    """Return the filter that averages over a window in s."""
    return LowPass("moving_average", _WINDOW / window, delay)


def parse_low_pass(word: str) -> LowPass:
    """Return the filter that a word describes, such as ``lowpass:5``, ``lowpass:5:4:zero-phase`` or ``average:0.3``.

    Raises
    ------
    InputError
        For anything else.
    """
    name, *rest = word.split(":")
    try:
        size = float(rest.pop(0))
    except (IndexError, ValueError):
        size = math.nan
    if size > 0.0 and math.isfinite(size):
        if name == "average" and rest in ([], ["past"]):
            return moving_average(size, size / 2 if rest else 0.0)
        zero_phase = rest[-1:] == ["zero-phase"]
        order = ":".join(rest[:-1] if zero_phase else rest) or "2"
        for kind, known in (_ZERO_PHASE_ORDERS if zero_phase else _ORDERS).items():
            if name == "lowpass" and order == str(known):
                return LowPass(kind, size)  # type: ignore[arg-type]
    raise InputError(f"force filter {word!r}: expected {GRAMMAR}")


def with_force_filter(run: Run, word: str) -> Run:
    """Return a run whose force is known to have passed a low-pass filter; what is fitted to it passes the same filter.

    Parameters
    ----------
    run : Run
    word : str
        See `parse_low_pass`.

    Raises
    ------
    InputError
        For a word that describes no filter, or one that the run cannot have passed.
    """
    low_pass = parse_low_pass(word)
    if low_pass.cutoff >= run.rate / 2:
        raise InputError(
            f"{run.name}: force filter {word!r}: found a cut-off of {low_pass.cutoff:.3g} Hz, expected less than half the "
            f"sampling rate, {run.rate / 2:.3g} Hz"
        )
    if low_pass.kind == "moving_average" and low_pass.window > run.duration:
        raise InputError(f"{run.name}: force filter {word!r}: expected a window shorter than the run, {run.duration:.3g} s")
    return replace(run, info={**run.info, "force_filter": word})


def with_force_filters(groups: Sequence[Sequence[Run]], options: Sequence[str], where: str) -> list[list[Run]]:
    """Return groups of runs whose force is known to have passed low-pass filters.

    Parameters
    ----------
    groups : sequence of sequences of Run
    options : sequence of str
        ``FILTER`` for all runs, or ``RUN=FILTER`` for those with this name; a later one replaces an earlier one.
    where : str
        Name of the options, for error messages.

    Raises
    ------
    InputError
        For a name that no run has, and as `with_force_filter` does.
    """
    names = [run.name for group in groups for run in group]
    words: dict[str, str] = {}
    for option in options:
        name, _, word = option.rpartition("=")
        if name and name not in names:
            raise InputError(f"{where} {option}: expected the name of a run: {', '.join(names)}")
        words |= dict.fromkeys([name] if name else names, word)
    return [[with_force_filter(run, words[run.name]) if run.name in words else run for run in group] for group in groups]


def force_filter_arguments(runs: Sequence[Run]) -> str:
    """Return the filters that the force of runs is known to have passed as options of a tool; empty where none is known."""
    words = {run.name: str(run.info["force_filter"]) for run in runs if run.info.get("force_filter")}
    of_all = set(words.values()) if len(words) == len(runs) else set()
    options = list(of_all) if len(of_all) == 1 else [f"{name}={word}" for name, word in words.items()]
    return "".join(f" --force-filter {shlex.quote(option)}" for option in options)


def known_force_filter(run: Run) -> LowPass | None:
    """Return the filter that the force of a run is known to have passed."""
    word = run.info.get("force_filter")
    return parse_low_pass(str(word)) if word else None


def filter_notes(runs: Sequence[Run]) -> list[str]:
    """Return a sentence about each known filter, and the runs whose force has passed it."""
    words = {str(run.info.get("force_filter") or ""): None for run in runs}
    return [
        f"The force of {', '.join(run.name for run in runs if run.info.get('force_filter') == word)} has passed "
        f"{describe_low_pass(parse_low_pass(word))} ({word}), and so has the force that is modelled for it"
        for word in filter(None, words)
    ]


def describe_low_pass(low_pass: LowPass) -> str:
    """Return the filter as a noun phrase."""
    if low_pass.kind == "moving_average":
        past = " of past samples" if low_pass.is_of_the_past else ""
        return f"a moving average{past} over {1e3 * low_pass.window:.3g} ms"
    name = {1: "a first-order low-pass filter", 4: "a fourth-order low-pass filter"}.get(low_pass.order, "a low-pass filter")
    return f"{name} without delay (forwards and backwards)" if low_pass.is_zero_phase else name
