"""Response time: steps of the current at constant speed of the rod."""

import dataclasses
from dataclasses import dataclass

from mrd_base import InputError, quantity
from mrd_trajectory.damper_tests.damper_test import (
    DamperTest,
    amplitude_field,
    checked_currents,
    chosen_amplitude,
    chosen_current,
    chosen_speed,
    current_field,
    cycles_of,
    rounded_down,
    speed_field,
)
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.waveforms.staircase import Staircase

# Time in s of a default cycle: eight times the response of a slow damper, some 0.2 s.
_CYCLE = 2.0


@dataclass(frozen=True, kw_only=True)
class ResponseTime(DamperTest):
    """Switch the current on and off once in each stroke of a triangle, a recording for each current.

    The current is on in the middle half of each stroke. So both steps are an eighth of a cycle away from the turns, and the
    rod moves at constant speed (method of Koo, Goncalves & Ahmadian 2003).
    """

    currents: tuple[float, ...] | None = current_field("of the coil while it is on")
    speed: float | None = speed_field("of the rod")
    amplitude: float | None = amplitude_field()
    cycles: int = quantity(3, doc="number of cycles, with two steps on and two off in each", lower=2, upper=1000)

    def experiments(self, bench: GeneratorSettings) -> tuple[Experiment, ...]:
        amplitude = chosen_amplitude(self.amplitude, 0.75, bench)
        speed = chosen_speed(self.speed, 0.5, amplitude, self.rate, bench)
        if self.speed is None:
            speed = min(speed, rounded_down(4 * amplitude / _CYCLE))
        if self.currents is None:
            largest = chosen_current(None, 1.0, speed, bench)
            currents: tuple[float, ...] = (largest / 2, largest)
        else:
            currents = checked_currents(self.currents, "currents_mA", bench)
        if 0.0 in currents:
            raise InputError("currents_mA: found 0, expected currents that differ from 0, within what limits.force_N leaves")
        found = []
        for number, current in enumerate(currents, 1):
            experiment = cycles_of(
                self,
                str(number),
                motion="triangle",
                speed=speed,
                amplitude=amplitude,
                currents=(current,),
                cycles=self.cycles,
            )
            eighth = experiment.duration / self.cycles / 8
            coil = Staircase((current, 0.0, 0.0, current), eighth)
            found.append(dataclasses.replace(experiment, coil=coil, description=f"{experiment.description}, on and off"))
        return tuple(found)
