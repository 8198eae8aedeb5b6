"""Speed sweep: cycles at several speeds and currents, for force over speed."""

import math
from dataclasses import dataclass

from mrd_base import InputError, quantity
from mrd_trajectory.damper_tests.damper_test import (
    DamperTest,
    amplitude_field,
    checked_currents,
    checked_speeds,
    chosen_amplitude,
    chosen_current,
    chosen_speed,
    current_field,
    cycles_of,
    least_amplitude,
    speed_field,
)
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.settings import GeneratorSettings

_MOTIONS = ("sine", "triangle")
# Default speeds and currents, as shares of the largest ones.
_SPEEDS, _CURRENTS = (0.05, 0.1, 0.25, 0.5, 1.0), (0.0, 0.5, 1.0)


@dataclass(frozen=True, kw_only=True)
class SpeedSweep(DamperTest):
    """Move several cycles at each speed and current: a recording for each speed, with the currents one after the other.

    A sine gives the peak force over the peak speed (PVP), a triangle the force at a constant speed (CVP).
    """

    speeds: tuple[float, ...] | None = speed_field("of the rod, in the order of the recordings")
    currents: tuple[float, ...] | None = current_field("of the coil")
    motion: str = quantity("sine", doc=f"of the rod: {' or '.join(_MOTIONS)}")
    amplitude: float | None = amplitude_field("largest half of peak to peak")
    cycle: float = quantity(
        2.0,
        "s",
        "longest time of a cycle: a slow speed travels less, as far as the bench turns so sharply",
        lower=0.05,
        upper=1000,
    )
    cycles: int = quantity(3, doc="number of cycles at each speed and steady current", lower=2, upper=1000)

    def __post_init__(self) -> None:
        if self.motion not in _MOTIONS:
            raise InputError(f"motion: found {self.motion!r}, expected {' or '.join(_MOTIONS)}")

    def experiments(self, bench: GeneratorSettings) -> tuple[Experiment, ...]:
        amplitude = chosen_amplitude(self.amplitude, 0.75, bench)
        if self.speeds is None:
            top = chosen_speed(None, 1.0, amplitude, self.rate, bench)
            speeds: tuple[float, ...] = tuple(share * top for share in _SPEEDS)
        else:
            speeds = checked_speeds(self.speeds, "speeds_mm_per_s", bench)
        if self.currents is None:
            largest = chosen_current(None, 1.0, max(speeds), bench)
            currents = tuple(share * largest for share in _CURRENTS) if largest else (0.0,)
        else:
            currents = checked_currents(self.currents, "currents_mA", bench)
        way = 2 * math.pi if self.motion == "sine" else 4.0  # of a cycle, in amplitudes

        def amplitude_at(speed: float) -> float:
            return min(amplitude, max(speed * self.cycle / way, least_amplitude(speed, bench)))

        return tuple(
            cycles_of(
                self,
                str(number),
                motion=self.motion,
                speed=speed,
                amplitude=amplitude_at(speed),
                currents=currents,
                cycles=self.cycles + 1,  # the one in which the current steps shows no force at steady current
            )
            for number, speed in enumerate(speeds, 1)
        )
