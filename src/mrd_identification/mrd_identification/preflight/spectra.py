"""Spectra of single channels: notches of a moving average, the end of the noise, lines of the mains."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from mrd_runs.signals.mains import MAINS_LINES, folded_frequency
from mrd_runs.signals.quantisation import resolution

Array = NDArray[np.float64]

MAINS_DEVIATION = 0.3
"""Largest deviation in Hz of the mains and of the sample clock."""
LINE_NEIGHBOURHOOD = 8.0
"""Hz on either side of a line in which the force must have nothing of that size: the harmonics of a motion, which may
coincide with the mains, change little from one to the next."""
LINE_RATIO = 10.0
"""Power of a line over that of the largest one in its neighbourhood."""

SHORTEST_WINDOW = 8
"""Samples of the shortest moving average that is looked for."""
PERIODS_IN_SEGMENT = 16
"""Windows of the moving average in a segment of the spectrum, so that its notches are resolved."""
COMPARED_NOTCHES = 30
"""Notches that are compared, at most."""
NOTCH_BAND = (0.2, 0.95)
"""Shares of the Nyquist frequency between which notches are compared. Below, switched currents and periodic motions have
notches of their own; in this band, the noise of the sensor fills those."""
PLACES_BESIDE = (-0.375, -0.25, 0.25, 0.375)
"""Places beside a notch, in distances of notches, whose power is compared with that in the notch."""
NOTCH_DEPTH = 1.0
"""Natural logarithm of the power beside a notch over that in it, which three quarters of the notches must reach."""
SAME_NOTCHES = 0.6
"""Share of the deepest comb from which a longer window is preferred; half of a window has every second notch only."""
NOISY_TURNING = 0.4
"""Share of third differences that change sign, from which they are noise; white noise has 0.75."""

BANDS_PER_OCTAVE = 6
SHELF_DECLINE = 4.0
"""dB per octave up to which a spectrum counts as a shelf of noise."""
SHELF_END = 40.0
"""dB by which the spectrum falls from the shelf to the Nyquist frequency; behind an instrument, the converter adds noise."""
ROUNDED_SHELF_END = 30.0
"""The same where what remains is the rounding of the file."""
ROUNDING = 0.4
"""White noise over the resolution, up to which it is rounding (0.29)."""
HIGHEST_END = 0.6
"""Share of the Nyquist frequency up to which the end of a shelf is no anti-alias filter."""
LARGEST_NOISE = 0.02
"""Rms of the shelf over the standard deviation of the force. What exceeds it may be a response to the current."""
LARGEST_NOISE_OF_POSITION = 2e-3
"""The same for the position. What exceeds it may be motion."""


@dataclass(frozen=True)
class Hum:
    """Mains hum in a channel.

    Attributes
    ----------
    frequency : float
        Hz, of the mains or its double.
    folded : float
        Hz, frequency at which the hum appears after sampling.
    amplitude : float
        In the unit of the channel. At half the sampling rate, where it depends on the phase, the least that it may be.
    share : float
        Rms of the hum over the standard deviation of the channel.
    """

    frequency: float
    folded: float
    amplitude: float
    share: float


def mains_hum(values: Array, rate: float) -> Hum | None:
    """Return the largest hum in a channel, or None.

    Parameters
    ----------
    values : ndarray (n,)
    rate : float
        Sampling rate in Hz.
    """
    window = signal.windows.hann(len(values), sym=False)
    frequency = fft.rfftfreq(len(values), 1 / rate)
    power = np.abs(fft.rfft(signal.detrend(values) * window)) ** 2
    bin_width = frequency[1]
    reach = MAINS_DEVIATION + 3 * bin_width
    found = []
    for line in MAINS_LINES:
        folded = folded_frequency(line, rate)
        inside = np.abs(frequency - folded) <= reach
        beside = (np.abs(frequency - folded) <= LINE_NEIGHBOURHOOD) & ~inside & (frequency >= 3 * bin_width)
        # At zero it is the offset.
        if folded < 2 * reach or not beside.any() or power[inside].max() <= LINE_RATIO * power[beside].max():
            continue
        # Power stands in the spectrum twice: below half the sampling rate, and mirrored above. A line at half the sampling
        # rate alternates from sample to sample.
        mirrored = np.where(frequency[inside] < 0.5 * (rate - bin_width), 2, 1)
        mean_square = float(mirrored @ power[inside]) / (len(values) * np.sum(window**2))
        alternates = folded > 0.5 * rate - 2 * bin_width
        amplitude = np.sqrt(mean_square if alternates else 2 * mean_square)
        found.append(Hum(line, folded, float(amplitude), float(np.sqrt(mean_square) / np.std(values))))
    return max(found, key=lambda hum: hum.amplitude, default=None)


def averaged_samples(values: Array) -> int:
    """Return the number of samples over which a moving average was taken; 0 where there was none.

    An average over a window has no power at the multiples of the inverse window. White noise averaged over n samples has
    differences (e[k] - e[k - n]) / n, so that the comb of notches reaches up to the Nyquist frequency.
    """
    noise = np.diff(values, 3)
    if np.mean(noise[1:] * noise[:-1] < 0) < NOISY_TURNING:
        return 0
    # A current that switches after equal times has a comb as well, but only at the switches.
    limit = 3 * np.median(np.abs(noise))
    noise = np.clip(noise, -limit, limit)
    longest = min(len(values) // (2 * PERIODS_IN_SEGMENT), 1024)
    combs: list[tuple[float, int]] = []
    shortest = SHORTEST_WINDOW
    while shortest < longest:
        windows = np.arange(shortest, min(4 * shortest, longest))
        _, density = signal.welch(noise, 1.0, nperseg=min(len(noise), 4 * shortest * PERIODS_IN_SEGMENT))
        combs += zip(_depth_of_notches(np.log(density + 1e-300), windows), windows, strict=True)
        shortest *= 4
    deepest = max(combs, default=(0.0, 0))[0]
    if deepest < NOTCH_DEPTH:
        return 0
    found = max(window for depth, window in combs if depth > max(SAME_NOTCHES * deepest, NOTCH_DEPTH))
    # A window that is too long to be looked for shows by every second or third of its notches.
    multiples = found * np.arange(1, max(2, min(len(values) // (PERIODS_IN_SEGMENT // 2 * found), 9)))
    for window in multiples[1:]:
        _, density = signal.welch(noise, 1.0, nperseg=min(len(noise), window * PERIODS_IN_SEGMENT))
        if _depth_of_notches(np.log(density + 1e-300), np.array([window]))[0] > NOTCH_DEPTH:
            found = window
    return int(found)


def has_notches(values: Array, window: int) -> bool:
    """Whether a channel has no power at the multiples of the inverse of a window in samples, whatever the cause."""
    segment = min(len(values), window * PERIODS_IN_SEGMENT)
    _, density = signal.welch(np.diff(values, 3), 1.0, nperseg=segment)
    return bool(_depth_of_notches(np.log(density + 1e-300), np.array([window]))[0] > 0.3 * NOTCH_DEPTH)


def _depth_of_notches(level: Array, windows: NDArray[np.intp]) -> list[float]:
    """Return the depth that three quarters of the notches of each window reach in a logarithmic spectrum."""
    last = len(level) - 1
    # Bins from one notch to the next.
    spacing = 2 * last / windows[:, None]
    first_number, last_number = (np.floor(share * last / spacing) for share in NOTCH_BAND)
    # The golden ratio spreads the numbers evenly, without favouring even ones or other multiples.
    spread = np.arange(COMPARED_NOTCHES) * (np.sqrt(5) - 1) / 2 % 1
    number = first_number + 1 + np.floor(spread * (last_number - first_number))
    notch = level[np.round(number * spacing).astype(int)]
    # Between the lines of a periodic motion, some of the places beside would be as low as a notch.
    beside = [
        level[np.round((number + place) * spacing).astype(int)] - 2 * np.log(np.abs(np.sin(np.pi * place)))
        for place in PLACES_BESIDE
    ]
    # At twice the window, half of the places are none. So most notches must be deep, not only their mean.
    return [float(depth) for depth in np.quantile(np.min(beside, axis=0) - notch, 0.25, axis=1)]


def noise_end(values: Array, rate: float, largest_noise: float = LARGEST_NOISE) -> float:
    """Return the frequency in Hz above which the noise of a channel is missing; 0 where it is not.

    Parameters
    ----------
    values : ndarray (n,)
    rate : float
        Sampling rate in Hz.
    largest_noise : float
        Rms of the noise over the standard deviation of the channel; a larger shelf of the spectrum is taken for a signal.
    """
    segment = min(1024, len(values) // 4)
    if segment < 128:
        return 0.0
    frequency, density = signal.welch(values, rate, nperseg=segment, detrend="linear", average="median")
    octaves = np.log2(frequency[1:] / frequency[8])
    band = np.floor(BANDS_PER_OCTAVE * octaves).astype(int)
    # The last bins are left out: the filter of a resampler may end there.
    bands = np.arange(0, band[-1])
    level = np.array([10 * np.log10(np.median(density[1:][band == k]) + 1e-300) for k in bands])
    centre = frequency[8] * 2 ** ((bands + 0.5) / BANDS_PER_OCTAVE)
    top = 10 * np.log10(np.median(density[-len(density) // 10 :]) + 1e-300)
    step = resolution(values)
    rounded = np.sqrt(10 ** (top / 10) * rate / 2) < ROUNDING * step
    end = 0.0
    for k in range(BANDS_PER_OCTAVE, len(bands) - 2):
        shelf = level[k - BANDS_PER_OCTAVE : k + 1]
        is_flat = np.ptp(shelf) <= 2 * SHELF_DECLINE and shelf[0] - shelf[-1] <= SHELF_DECLINE
        is_noise = np.sqrt(10 ** (shelf.mean() / 10) * centre[k]) <= largest_noise * np.std(values)
        falls = shelf[-1] - top >= (ROUNDED_SHELF_END if rounded else SHELF_END) and level[k + 1 :].max() <= shelf[-1]
        if is_flat and is_noise and falls and centre[k] <= HIGHEST_END * rate / 2:
            low = k + 1 + int(np.argmax(level[k + 1 :] < np.median(shelf) - 3.0))
            octave = np.interp(3.0, np.median(shelf) - level[low - 1 : low + 1], [-1 / BANDS_PER_OCTAVE, 0.0])
            end = float(centre[low] * 2**octave)
    return end
