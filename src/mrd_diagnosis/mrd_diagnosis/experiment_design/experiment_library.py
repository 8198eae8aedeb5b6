"""Library of experiments from which the next one is chosen; none exceeds the limits of the bench."""

from collections.abc import Iterator
from dataclasses import replace

from mrd_trajectory.experiment import Experiment
from mrd_trajectory.plan import Plan, plan_scaled
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

RATE = 500.0
"""Sample rate in Hz of the experiments."""

DURATION = 12.0
"""Duration in s of an experiment without its repeats."""

MM, MA = 1e-3, 1e-3
"""One millimetre in m, one milliampere in A."""


def _multisine(amplitude: float, highest: float, seed: int, offset: float = 0.0) -> Multisine:
    """Return an odd multisine, in mm and Hz. Its period is half the run: what differs between the halves is noise."""
    return Multisine(amplitude * MM, 0.2, highest, DURATION / 2, 1.0, seed, offset * MM)


def _levels(highest: float, seed: int, shortest: float = 0.03, longest: float = 0.3) -> Aprbs:
    """Return random levels of current from 0 to ``highest`` mA."""
    return Aprbs(0.0, highest * MA, shortest, longest, 12, seed)


def _constant(level: float) -> Constant:
    """Return a constant current in mA."""
    return Constant(level * MA)


def _candidates() -> Iterator[tuple[str, str, Waveform, Waveform]]:
    """Yield name, description, and waveforms of rod and coil. All fit within the limits of the shipped bench."""
    sizes = (("large", 12.0, 8.0, 260.0), ("medium", 5.0, 8.0, 400.0), ("small", 1.0, 12.0, 480.0))
    for size, amplitude, highest, current in sizes:
        motion, rod = f"odd multisine of {amplitude:g} mm up to {highest:g} Hz", _multisine(amplitude, highest, 1)
        yield f"{size}_random_current", f"{motion} at random currents", rod, _levels(current, 2)
        yield f"{size}_no_current", f"{motion} without current", rod, _constant(0)
        yield f"{size}_current", f"{motion} at constant current", rod, _constant(current)
    steps = Ladder((0.1, 0.01), 20 * MM, 3.0)
    yield "steps_at_two_speeds", "steps of current at constant 100 and 10 mm/s", steps, Prbs(0.0, 0.35, 0.06, 8, 2)
    triangle = Triangle(20 * MM, 0.05)
    yield "slow_steps", "long steps of current at constant 50 mm/s", triangle, Prbs(0.0, 0.45, 0.3, 8, 4)
    yield "fast_steps", "fast steps of current at constant 50 mm/s", triangle, Prbs(0.0, 0.45, 0.016, 10, 5)
    loops = (0, 0.2, 0.4, 0.5, 0.4, 0.2, 0, 0.2, 0.4, 0.2, 0.3, 0.2, 0.4, 0.5, 0.3, 0.1, 0.3, 0.1, 0, 0.5)
    yield (
        "current_loops",
        "nested loops of the current at constant 30 mm/s",
        Triangle(24 * MM, 0.03),
        Staircase(loops, 0.3),
    )
    ladder = Ladder((0.15, 0.05, 0.015, 0.005), 18 * MM, 1.0)
    yield "speed_ladder", "triangles of 5 to 150 mm/s at three currents", ladder, Staircase((0.0, 0.12, 0.24), 4.0)
    slow = Ladder((0.0003, 0.001, 0.003, 0.01), 2 * MM, 1.5)
    for end, side in (("inner", -1), ("outer", 1)):
        yield (
            f"slow_reversals_{end}",
            f"triangles of 0.3 to 10 mm/s near the {end} end",
            replace(slow, offset=side * 0.0238),
            Staircase((0.0, 0.1), 6.0),
        )
    whole = Sine(25.8 * MM, 1 / 6)
    yield "whole_stroke", "two slow sines over the whole stroke, without current", whole, _constant(0)
    yield "whole_stroke_current", "two slow sines over the whole stroke, at random currents", whole, _levels(400, 6)
    for end, side in (("inner", -1), ("outer", 1)):
        fast = Sine(13 * MM, 2.0, side * 0.0125)
        yield f"fast_{end}", f"fast sine towards the {end} end, without current", fast, _constant(0)
    yield "fast_random_current", "fast sine at random currents", Sine(8 * MM, 2.0), _levels(300, 7)
    chirp = Chirp(16 * MM, 0.5, 12.0, constant_speed=True)
    yield "chirp_no_current", "chirp of 0.5 to 12 Hz at equal peak speed, without current", chirp, _constant(0)
    yield "chirp_random_current", "chirp of 0.5 to 12 Hz at equal peak speed, at random currents", chirp, _levels(350, 8)
    micro = Chirp(0.4 * MM, 1.0, 10.0, constant_speed=True)
    yield "micro_strokes", "strokes of 0.4 down to 0.04 mm at high currents", micro, Staircase((0.58, 0.2, 0.4), 1.0)


def library(bench: GeneratorSettings) -> tuple[Plan, ...]:
    """Return experiments of about a quarter of a minute, each within the limits of a bench.

    Motion and current of an experiment beyond a limit are scaled down; one that does not fit even then is left out. The last
    experiment takes longer, because it warms the damper.

    The experiments are code and not files, so that they come with the package and adapt to the limits of any bench.
    """
    experiments = [
        Experiment(name, DURATION, RATE, rod, coil, description=description)
        for name, description, rod, coil in _candidates()
    ]
    warm = Experiment(
        "long_and_warm",
        DURATION,
        RATE,
        _multisine(12, 8, 9),
        _constant(240),
        repeats=3,
        description="the same fast motion for half a minute at constant current, which warms and settles the damper",
    )
    plans = (plan_scaled(experiment, bench.limits, bench.force_envelope) for experiment in (*experiments, warm))
    return tuple(planned for planned in plans if planned is not None)
