"""Random-phase multisine on odd harmonics."""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Array, Smooth, Waveform, level_field

# Number of random phase sets, of which the one with the smallest crest factor is taken.
PHASE_SETS = 200


@dataclass(frozen=True)
class Multisine(Waveform):
    """Sum of the odd harmonics of ``1/period`` from ``lowest`` to ``highest`` with random phases.

    Energy in the response at even harmonics then shows an even nonlinearity (Pintelon & Schoukens, *System
    Identification*, 2012, ch. 4). Of 200 phase sets drawn from the seed, the one with the smallest crest factor is taken,
    where the larger crest factor of the level and its rate counts.
    """

    amplitude: float = level_field("peak", lower=0)
    lowest: float = quantity(unit="Hz", doc="lowest frequency", lower=1e-3, upper=100)
    highest: float = quantity(unit="Hz", doc="highest frequency", lower=1e-3, upper=100)
    period: float = quantity(unit="s", doc="of the signal; its inverse is the spacing of the lines", lower=0.01, upper=3600)
    rolloff: float = quantity(1.0, "", "amplitude ∝ frequency^−rolloff; 0: equal levels, 1: equal rates", lower=-2, upper=4)
    seed: int = quantity(0, "", "of the phases", lower=0)
    offset: float = level_field("mean", 0.0)

    def __post_init__(self) -> None:
        if self.highest * self.period > 4000:
            raise InputError(
                f"highest_hz {self.highest:g} is more than 4000 times 1/period_s = {1 / self.period:g} Hz; reduce period_s"
            )
        if not len(self._harmonics()):
            raise InputError(
                f"no odd multiple of 1/period_s = {1 / self.period:g} Hz lies between lowest_hz {self.lowest:g} and "
                f"highest_hz {self.highest:g}; raise period_s or widen the band"
            )

    def _harmonics(self) -> Array:
        first, last = np.ceil(self.lowest * self.period - 1e-9), np.floor(self.highest * self.period + 1e-9)
        return np.arange(first + (first + 1) % 2, last + 1, 2.0)

    def _spectrum(self) -> tuple[Array, Array]:
        """Return amplitudes and phases (m,) of the harmonics, scaled to peak 1."""
        harmonics = self._harmonics()
        weights = harmonics**-self.rolloff
        index = harmonics.astype(int)
        points = 32 * int(index[-1])
        spectrum = np.zeros((2, points // 2 + 1), dtype=complex)
        generator = np.random.default_rng(self.seed)
        best, peak, phases = np.inf, 1.0, np.zeros(len(index))
        for _ in range(PHASE_SETS):
            candidate = generator.uniform(0, 2 * np.pi, len(index))
            spectrum[0, index] = weights * np.exp(1j * candidate) * points / 2
            spectrum[1, index] = 1j * harmonics * spectrum[0, index]
            series = np.fft.irfft(spectrum, points)
            largest = np.abs(series).max(axis=1)
            crest = float((largest / series.std(axis=1)).max())
            if crest < best:
                best, peak, phases = crest, float(largest[0]), candidate
        return weights / peak, phases

    def shape(self, duration: float) -> Smooth:
        rates = 2 * np.pi * self._harmonics() / self.period
        weights, phases = self._spectrum()

        def motion(time: Array) -> tuple[Array, Array, Array]:
            level, slope, curvature = np.full(len(time), self.offset), np.zeros(len(time)), np.zeros(len(time))
            for rate, weight, phase in zip(rates, self.amplitude * weights, phases, strict=True):
                cosine, sine = weight * np.cos(rate * time + phase), weight * np.sin(rate * time + phase)
                level += cosine
                slope -= rate * sine
                curvature -= rate**2 * cosine
            return level, slope, curvature

        return Smooth(motion, float(rates[-1]) / (2 * np.pi))
