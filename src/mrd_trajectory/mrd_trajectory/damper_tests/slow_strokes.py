"""Slow strokes without current: the base of the tests of gas force and seal drag."""

from dataclasses import dataclass
from typing import ClassVar

from mrd_base import InputError, quantity
from mrd_trajectory.damper_tests.damper_test import (
    DamperTest,
    amplitude_field,
    checked_speeds,
    chosen_amplitude,
    chosen_speed,
    cycles_of,
    rounded_down,
    speed_field,
)
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.settings import GeneratorSettings

# Default number of cycles at each speed. Between its reversals are five whole strokes, so that each direction repeats.
_CYCLES = 3


@dataclass(frozen=True, kw_only=True)
class SlowStrokes(DamperTest):
    """Move triangles at two slow speeds without current, each in a recording of its own.

    From two speeds follows by how much the force still depends on the speed, and so the force at standstill.

    Attributes
    ----------
    REACH, CYCLE : float
        Defaults of a test: amplitude as a share of the usable reach, and time in s of a cycle at the faster speed, which the
        patience of people limits rather than the damper.
    """

    REACH: ClassVar[float]
    CYCLE: ClassVar[float]

    speeds: tuple[float, ...] | None = speed_field("two slow speeds or more")
    amplitude: float | None = amplitude_field()
    cycles: int = quantity(_CYCLES, doc="number of cycles at each speed", lower=2, upper=1000)

    def experiments(self, bench: GeneratorSettings) -> tuple[Experiment, ...]:
        amplitude = chosen_amplitude(self.amplitude, self.REACH, bench)
        if self.speeds is None:
            fast = chosen_speed(None, 0.25, amplitude, self.rate, bench)
            fast = min(fast, rounded_down(4 * amplitude / self.CYCLE))
            speeds: tuple[float, ...] = (fast, fast / 2)
        else:
            speeds = checked_speeds(self.speeds, "speeds_mm_per_s", bench)
        if len(set(speeds)) < 2:
            raise InputError(
                "speeds_mm_per_s: found one speed, expected two or more: the slope over the speed is unknown else"
            )
        return tuple(
            cycles_of(
                self, str(number), motion="triangle", speed=speed, amplitude=amplitude, currents=(0.0,), cycles=self.cycles
            )
            for number, speed in enumerate(speeds, 1)
        )
