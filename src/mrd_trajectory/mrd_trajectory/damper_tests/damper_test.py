"""Base of the damper tests, and the levels that a bench bears where a test gives none."""

import abc
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError, quantity
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.limits import LARGEST_CURRENT
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.until import Until
from mrd_trajectory.waveforms import Constant, Waveform
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trajectory.waveforms.triangle import Triangle

Array = NDArray[np.float64]

USABLE = 0.97
"""Share of the reach that a test uses: the rod may swing a little beyond its setpoint, and the stroke's limit trips."""

# Shares of the limits that chosen levels use: of the speed; of the force that is left above that at rest, by the speed alone
# and with current, since the force envelope is an estimate.
_SPEED_SHARE, _FORCE_BY_SPEED, _FORCE_WITH_CURRENT = 0.9, 0.5, 0.8
# Shares of acceleration and jerk that a cycle takes: turns at corners, and the ways from and to rest, take more of them.
_ACCELERATION_SHARE, _JERK_SHARE = 0.2, 0.05
# A cycle has at least so many setpoints, and so many samples.
_SETPOINTS_PER_CYCLE, _SAMPLES_PER_CYCLE = 20, 50


@dataclass(frozen=True, kw_only=True)
class DamperTest(abc.ABC):
    """Base of the damper tests: frozen dataclasses of `mrd_base.quantity` fields.

    A field that is None follows from the limits of the bench.
    """

    name: str = quantity(doc="letters, digits, - and _; begins the names of the recordings")
    rate: float = quantity(500.0, "Hz", "samples per second", lower=25, upper=2000)
    description: str = quantity("", doc="purpose of the test")

    @abc.abstractmethod
    def experiments(self, bench: GeneratorSettings) -> tuple[Experiment, ...]:
        """Return the experiments of the test, in their order.

        Raises
        ------
        InputError
            With one line, for a level that the bench does not bear. `mrd_trajectory.plan.plan` checks the whole motion.
        """

    @property
    def decides(self) -> bool:
        """Whether the test looks at each of its recordings, and may end the set by `reason_to_stop`."""
        return False

    def reason_to_stop(self, name: str, recorded: Callable[[str], Array]) -> str:
        """Return why the set ends after a recording, or "".

        Parameters
        ----------
        name : str
            Name of the experiment of this test that was recorded last.
        recorded : callable
            Returns the recorded force (n,) in N of an experiment of this test, given by its name.
        """
        return ""


def level_field(unit: str, doc: str, default: Any = None, *, lower: float = 0.0, upper: float = 10.0) -> Any:
    """Declare a level, or levels, between bounds in SI units (m, m/s or A); the limits of the bench are checked later."""
    return quantity(default, unit, doc, lower=lower, upper=upper)


def speed_field(doc: str) -> Any:
    """Declare a speed of the rod, or speeds."""
    return level_field("mm/s", f"{doc}; by default from the limits of the bench", lower=1e-7)


def amplitude_field(doc: str = "half of peak to peak") -> Any:
    """Declare an amplitude of the rod."""
    return level_field("mm", f"{doc}; by default from the limits of the bench", lower=1e-6)


def current_field(doc: str) -> Any:
    """Declare a current of the coil, or currents."""
    doc = f"{doc}; by default from the limits of the bench"
    return level_field("mA", doc, lower=-LARGEST_CURRENT, upper=LARGEST_CURRENT)


def chosen_amplitude(given: float | None, share: float, bench: GeneratorSettings) -> float:
    """Return the given amplitude in m, or a share of the usable reach.

    Raises
    ------
    InputError
        If the given one is beyond the reach.
    """
    if given is None:
        return rounded_down(share * USABLE * bench.limits.reach)
    if given > bench.limits.reach:
        raise InputError(
            f"amplitude_mm: found {given * 1e3:.4g}, expected at most {bench.limits.reach * 1e3:.4g}, the reach of the bench"
        )
    return given


def chosen_speed(given: float | None, share: float, amplitude: float, rate: float, bench: GeneratorSettings) -> float:
    """Return the given speed in m/s, or a share of the largest one that the bench bears at an amplitude in m.

    Raises
    ------
    InputError
        If the given one is above the limit, or if the damper exceeds the limit of the force at rest.
    """
    if given is not None:
        return checked_speeds((given,), "speed_mm_per_s", bench)[0]
    limits, envelope = bench.limits, bench.force_envelope
    frequency = min(rate / _SAMPLES_PER_CYCLE, bench.setpoint_rate / _SETPOINTS_PER_CYCLE)
    return rounded_down(
        share
        * min(
            _SPEED_SHARE * limits.speed,
            math.sqrt(_ACCELERATION_SHARE * limits.acceleration * amplitude),
            math.cbrt(_JERK_SHARE * limits.jerk * amplitude**2),
            4 * amplitude * frequency,
            envelope.speed(_bearable_force(_FORCE_BY_SPEED, bench), 0.0),
        )
    )


def least_amplitude(speed: float, bench: GeneratorSettings) -> float:
    """Return the amplitude in m below which cycles of a speed in m/s turn too sharply for the bench."""
    limits = bench.limits
    by_acceleration = speed**2 / (_ACCELERATION_SHARE * limits.acceleration)
    return max(by_acceleration, math.sqrt(speed**3 / (_JERK_SHARE * limits.jerk)))


def checked_speeds(speeds: tuple[float, ...], key: str, bench: GeneratorSettings) -> tuple[float, ...]:
    """Return speeds in m/s; refuse one that is above the limit of the bench."""
    _check(max(speeds) * 1e3, bench.limits.speed * 1e3, key, "speed")
    return speeds


def chosen_current(given: float | None, share: float, speed: float, bench: GeneratorSettings) -> float:
    """Return the given current in A, or a share of the largest one that the bench bears at a speed in m/s.

    Raises
    ------
    InputError
        If the given one is outside of the limits, or if the damper exceeds the limit of the force at rest.
    """
    if given is not None:
        return checked_currents((given,), "current_mA", bench)[0]
    current = bench.force_envelope.current(_bearable_force(_FORCE_WITH_CURRENT, bench), speed)
    return rounded_down(share * max(0.0, min(current, bench.limits.current_max)))


def checked_currents(currents: tuple[float, ...], key: str, bench: GeneratorSettings) -> tuple[float, ...]:
    """Return currents in A; refuse one that is outside of the limits of the bench."""
    _check(max(currents) * 1e3, bench.limits.current_max * 1e3, key, "current")
    if min(currents) < bench.limits.current_min:
        raise InputError(
            f"{key}: found {min(currents) * 1e3:.4g}, expected at least {bench.limits.current_min * 1e3:.4g}, the least "
            "current of the bench"
        )
    return currents


def _check(value: float, limit: float, key: str, quantity_name: str) -> None:
    if value > limit * (1 + 1e-9):
        raise InputError(
            f"{key}: found {value:.4g}, expected at most {limit:.4g}, the limit of the bench for the {quantity_name}"
        )


def _bearable_force(share: float, bench: GeneratorSettings) -> float:
    """Return the force in N at rest without current, and a share of what the limit leaves above it."""
    at_rest, limit = bench.force_envelope.at_rest(0.0), bench.limits.force
    if at_rest >= limit:
        raise InputError(
            f"limits.force_N: found {limit:.4g}, expected more than the {at_rest:.4g} N that the damper may give at rest "
            "without current by force_envelope; correct one of them in the bench's file"
        )
    return at_rest + share * (limit - at_rest)


def rounded_down(value: float) -> float:
    """Return a value ≥ 0 with three digits, as people write it, and no larger: it may be a limit."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / unit + 1e-9) * unit:.3g}")


def cycles_of(
    test: DamperTest,
    name: str,
    *,
    motion: str,
    speed: float,
    amplitude: float,
    currents: tuple[float, ...],
    cycles: int,
    repeats: int = 1,
    until: Until | None = None,
) -> Experiment:
    """Return an experiment of equal cycles around mid-stroke.

    Parameters
    ----------
    test : DamperTest
    name : str
        Added to the name of the test; "" for the only experiment of a test.
    motion : str
        ``"sine"``, with the speed as its peak, or ``"triangle"``.
    speed, amplitude : float
        In m/s and m.
    currents : tuple of float
        In A, one after the other, each for so many ``cycles``.
    repeats : int
        Number of passes over all of this.
    """
    rod: Waveform
    if motion == "sine":
        period = 2 * math.pi * amplitude / speed
        rod = Sine(amplitude, 1 / period)
    else:
        period = 4 * amplitude / speed
        rod = Triangle(amplitude, speed)
    coil = Constant(currents[0]) if len(currents) == 1 else Staircase(currents, cycles * period)
    levels = ", ".join(f"{1e3 * current:.5g}" for current in currents)
    what = f"{motion} of {1e3 * speed:.4g} mm/s, ±{1e3 * amplitude:.4g} mm, at {levels} mA"
    return Experiment(
        f"{test.name}_{name}" if name else test.name,
        cycles * period * len(currents),
        test.rate,
        rod,
        coil,
        repeats,
        description=f"{test.description}: {what}" if test.description else what,
        until=until,
    )
