"""Endurance: cycles in blocks, with a characterisation before the first and after each."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_trajectory.damper_tests.damper_test import (
    Array,
    DamperTest,
    amplitude_field,
    chosen_amplitude,
    chosen_current,
    chosen_speed,
    current_field,
    cycles_of,
    speed_field,
)
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.settings import GeneratorSettings

# Percentile of the force's magnitude that counts as its peak: a single disturbed sample is no peak.
_PEAK = 99.5
_MOST_BLOCKS = 999
_CHARACTERISATION = "characterisation"


@dataclass(frozen=True)
class StopWhen:
    """Limit on which an endurance test ends."""

    peak_force: float = quantity(
        unit="percent", doc="change of the peak force since the first characterisation", lower=1e-6, upper=10
    )


@dataclass(frozen=True, kw_only=True)
class Endurance(DamperTest):
    """Wear the damper by sines at one current, in blocks; characterise it before the first block and after each.

    A characterisation is a short recording of the same sine without current and at that current. The names of the recordings
    are numbered in their order: ``NAME_000_characterisation``, ``NAME_001_cycles``, ``NAME_001_characterisation`` and so on.
    """

    cycles: int = quantity(doc="number of cycles in all", lower=1, upper=100_000_000)
    every: int = quantity(doc="number of cycles of a block", lower=1, upper=100_000)
    stop_when: StopWhen | None = quantity(None, doc="limit on which the set ends after a characterisation")
    speed: float | None = speed_field("peak of the sine")
    amplitude: float | None = amplitude_field()
    current: float | None = current_field("of the coil")
    characterisation_cycles: int = quantity(5, doc="cycles of a characterisation at each current", lower=2, upper=1000)

    def __post_init__(self) -> None:
        if self.every > self.cycles:
            raise InputError(f"every: found {self.every}, expected at most the {self.cycles} of cycles")
        if self._blocks > _MOST_BLOCKS:
            raise InputError(
                f"every: found {self.every}, which makes {self._blocks} blocks, expected at most {_MOST_BLOCKS}"
            )

    @property
    def _blocks(self) -> int:
        return -(-self.cycles // self.every)

    def experiments(self, bench: GeneratorSettings) -> tuple[Experiment, ...]:
        amplitude = chosen_amplitude(self.amplitude, 0.6, bench)
        speed = chosen_speed(self.speed, 0.6, amplitude, self.rate, bench)
        current = chosen_current(self.current, 0.5, speed, bench)

        def characterisation(number: int) -> Experiment:
            return cycles_of(
                self,
                f"{number:03d}_{_CHARACTERISATION}",
                motion="sine",
                speed=speed,
                amplitude=amplitude,
                currents=(0.0, current) if current else (0.0,),
                cycles=self.characterisation_cycles,
            )

        found = [characterisation(0)]
        for number in range(1, self._blocks + 1):
            block = min(self.every, self.cycles - (number - 1) * self.every)
            found.append(
                cycles_of(
                    self,
                    f"{number:03d}_cycles",
                    motion="sine",
                    speed=speed,
                    amplitude=amplitude,
                    currents=(current,),
                    cycles=1,
                    repeats=block,
                )
            )
            found.append(characterisation(number))
        return tuple(found)

    @property
    def decides(self) -> bool:
        return self.stop_when is not None

    def reason_to_stop(self, name: str, recorded: Callable[[str], Array]) -> str:
        first = f"{self.name}_000_{_CHARACTERISATION}"
        if self.stop_when is None or name == first or not name.endswith(_CHARACTERISATION):
            return ""
        change = peak_force_change(recorded(first), recorded(name))
        if abs(change) <= self.stop_when.peak_force:
            return ""
        return (
            f"{name}: the peak force has changed by {100 * change:+.3g} % since {first}, "
            f"more than the {100 * self.stop_when.peak_force:.3g} % of stop_when"
        )


def peak_force_change(first: Array, latest: Array) -> float:
    """Return the change of the peak force between two recordings of equal motion, as a share of the first.

    Parameters
    ----------
    first, latest : ndarray (n,), (m,)
        Force in N.
    """
    before, after = (float(np.percentile(np.abs(force), _PEAK)) for force in (first, latest))
    return after / before - 1 if before else 0.0
