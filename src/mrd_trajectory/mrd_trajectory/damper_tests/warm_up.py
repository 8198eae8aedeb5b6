"""Warm-up: cycles until a damper has reached a temperature, or until its force has settled."""

import math
from dataclasses import dataclass

from mrd_base import InputError, quantity
from mrd_trajectory.damper_tests.damper_test import (
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
from mrd_trajectory.until import FEWEST_PASSES, Until

_CYCLES = 20


@dataclass(frozen=True, kw_only=True)
class WarmUp(DamperTest):
    """Move a sine at one current; each cycle is a pass, so that `until` ends it after any of them."""

    cycles: int | None = quantity(
        None, doc=f"number of cycles, at most with until (default: {_CYCLES})", lower=1, upper=100_000
    )
    time: float | None = quantity(None, "s", "in place of cycles: duration, at most with until", lower=0.1, upper=86400)
    until: Until | None = quantity(None, doc="condition on which it ends early")
    speed: float | None = speed_field("peak of the sine")
    amplitude: float | None = amplitude_field()
    current: float | None = current_field("of the coil")

    def __post_init__(self) -> None:
        if self.cycles is not None and self.time is not None:
            raise InputError("cycles and time_s are both given; give one of them")

    def experiments(self, bench: GeneratorSettings) -> tuple[Experiment, ...]:
        amplitude = chosen_amplitude(self.amplitude, 0.6, bench)
        speed = chosen_speed(self.speed, 0.6, amplitude, self.rate, bench)
        current = chosen_current(self.current, 0.5, speed, bench)
        cycles = self.cycles or _CYCLES
        if self.time is not None:
            cycles = math.ceil(self.time * speed / (2 * math.pi * amplitude))
        if self.until is not None and cycles < FEWEST_PASSES:
            given = "time_s" if self.time is not None else "cycles"
            raise InputError(f"{given}: found {cycles} cycles, expected at least {FEWEST_PASSES} beside until")
        return (
            cycles_of(
                self,
                "",
                motion="sine",
                speed=speed,
                amplitude=amplitude,
                currents=(current,),
                cycles=1,
                repeats=cycles,
                until=self.until,
            ),
        )
