"""Experiments to choose from where recordings leave a question open: none exceeds the limits of the bench."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from mrd_base import InputError
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.waveforms import Constant, Waveform
from mrd_trajectory.waveforms.aprbs import Aprbs
from mrd_trajectory.waveforms.chirp import Chirp
from mrd_trajectory.waveforms.ladder import Ladder
from mrd_trajectory.waveforms.multisine import Multisine
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trajectory.waveforms.triangle import Triangle
from mrd_trajectory.waveforms.waveform import fields_in

RATE = 500.0
"""Hz."""

SECONDS = 12.0

SHRINKING, TRIALS = 0.8, 8
"""What does not fit within the limits is made smaller by this factor, at most so many times."""

_MM, _MA = 1e-3, 1e-3


def _multisine(amplitude: float, highest: float, seed: int, offset: float = 0.0) -> Multisine:
    """In mm and Hz; its period is half the run, so that what differs between the halves is noise."""
    return Multisine(amplitude * _MM, 0.2, highest, SECONDS / 2, 1.0, seed, offset * _MM)


def _levels(highest: float, seed: int, shortest: float = 0.03, longest: float = 0.3) -> Aprbs:
    """Random levels from 0 to so many mA."""
    return Aprbs(0.0, highest * _MA, shortest, longest, 12, seed)


def _at(level: float) -> Constant:
    """In mA."""
    return Constant(level * _MA)


def _candidates() -> Iterator[tuple[str, str, Waveform, Waveform]]:
    """Name, description, what rod and coil do; on the shipped bench all of them fit within the limits as they are."""
    sizes = (("large", 12.0, 8.0, 260.0), ("medium", 5.0, 8.0, 400.0), ("small", 1.0, 12.0, 480.0))
    for size, amplitude, highest, current in sizes:
        moves, rod = f"odd multisine of {amplitude:g} mm up to {highest:g} Hz", _multisine(amplitude, highest, 1)
        yield f"{size}_random_current", f"{moves} at random currents", rod, _levels(current, 2)
        yield f"{size}_no_current", f"{moves} without current", rod, _at(0)
        yield f"{size}_current", f"{moves} at constant current", rod, _at(current)
    steps = Ladder((0.1, 0.01), 20 * _MM, 3.0)
    yield "steps_at_two_speeds", "steps of current at constant 100 and 10 mm/s", steps, Prbs(0.0, 0.35, 0.06, 8, 2)
    triangle = Triangle(20 * _MM, 0.05)
    yield "slow_steps", "long steps of current at constant 50 mm/s", triangle, Prbs(0.0, 0.45, 0.3, 8, 4)
    yield "fast_steps", "fast steps of current at constant 50 mm/s", triangle, Prbs(0.0, 0.45, 0.016, 10, 5)
    loops = (0, 0.2, 0.4, 0.5, 0.4, 0.2, 0, 0.2, 0.4, 0.2, 0.3, 0.2, 0.4, 0.5, 0.3, 0.1, 0.3, 0.1, 0, 0.5)
    yield (
        "current_loops",
        "nested loops of the current at constant 30 mm/s",
        Triangle(24 * _MM, 0.03),
        Staircase(loops, 0.3),
    )
    ladder = Ladder((0.15, 0.05, 0.015, 0.005), 18 * _MM, 1.0)
    yield "speed_ladder", "triangles of 5 to 150 mm/s at three currents", ladder, Staircase((0.0, 0.12, 0.24), 4.0)
    slow = Ladder((0.0003, 0.001, 0.003, 0.01), 2 * _MM, 1.5)
    for end, side in (("inner", -1), ("outer", 1)):
        yield (
            f"slow_reversals_{end}",
            f"triangles of 0.3 to 10 mm/s near the {end} end",
            replace(slow, offset=side * 0.0238),
            Staircase((0.0, 0.1), 6.0),
        )
    whole = Sine(25.8 * _MM, 1 / 6)
    yield "whole_stroke", "two slow sines over the whole stroke, without current", whole, _at(0)
    yield "whole_stroke_current", "two slow sines over the whole stroke, at random currents", whole, _levels(400, 6)
    for end, side in (("inner", -1), ("outer", 1)):
        fast = Sine(13 * _MM, 2.0, side * 0.0125)
        yield f"fast_{end}", f"fast sine towards the {end} end, without current", fast, _at(0)
    yield "fast_random_current", "fast sine at random currents", Sine(8 * _MM, 2.0), _levels(300, 7)
    chirp = Chirp(16 * _MM, 0.5, 12.0, constant_speed=True)
    yield "chirp_no_current", "chirp of 0.5 to 12 Hz at equal peak speed, without current", chirp, _at(0)
    yield "chirp_random_current", "chirp of 0.5 to 12 Hz at equal peak speed, at random currents", chirp, _levels(350, 8)
    micro = Chirp(0.4 * _MM, 1.0, 10.0, constant_speed=True)
    yield "micro_strokes", "strokes of 0.4 down to 0.04 mm at high currents", micro, Staircase((0.58, 0.2, 0.4), 1.0)


@cache
def library(bench: GeneratorSettings) -> tuple[Plan, ...]:
    """Experiments of a quarter of a minute, each within the limits of a bench.

    Those that go beyond a limit are scaled down, in motion and current; those that do not fit even then are left out. The
    last one takes longer: it warms the damper.

    They stand here, not in files, so that they come with the package and suit another bench's limits.
    """
    experiments = [
        Experiment(name, SECONDS, RATE, rod, coil, description=description) for name, description, rod, coil in _candidates()
    ]
    warm = Experiment(
        "long_and_warm",
        SECONDS,
        RATE,
        _multisine(12, 8, 9),
        _at(240),
        repeats=3,
        description=("the same fast motion for half a minute at constant current: warmth and settling"),
    )
    fitted = (within(experiment, bench) for experiment in (*experiments, warm))
    return tuple(planned for planned in fitted if planned is not None)


def within(experiment: Experiment, bench: GeneratorSettings) -> Plan | None:
    """The experiment within the limits of a bench, as large as a few trials find it; None where it does not fit."""
    for trial in range(TRIALS):
        factor = SHRINKING**trial
        rod, coil = _scaled(experiment.rod, factor), _scaled(experiment.coil, factor)
        try:
            return plan(replace(experiment, rod=rod, coil=coil), bench.limits, bench.force_envelope)
        except InputError:
            continue
    return None


def _scaled(waveform: Waveform, factor: float) -> Waveform:
    """Levels, and the slopes between them, smaller by a factor."""
    changes = {}
    for field in (*fields_in(waveform, "level"), *fields_in(waveform, "level/s")):
        value = getattr(waveform, field.name)
        changes[field.name] = tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
    return replace(waveform, **changes)  # type: ignore[type-var]
