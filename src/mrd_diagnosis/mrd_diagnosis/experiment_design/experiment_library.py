"""Library of experiments from which the next one is chosen; none exceeds the limits of the bench."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

from mrd_runs.scales import REFERENCE, Scales
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.force import ForceEnvelope
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

LIKE_SHIPPED = 5.0
"""Ratio of the scales of a damper to those of the shipped one, up to which its bench is taken for the shipped one."""


@dataclass(frozen=True)
class Sizes:
    """How much larger motion, current and force are than on the shipped bench."""

    motion: float = 1.0
    current: float = 1.0
    force: float = 1.0

    def mm(self, length: float) -> float:
        """Return a length in m that is given in mm of the shipped bench."""
        return 1e-3 * self.motion * length

    def ma(self, current: float) -> float:
        """Return a current in A that is given in mA of the shipped bench."""
        return 1e-3 * self.current * current


def sizes_of(scales: Scales) -> Sizes:
    """Return the sizes of experiments for a damper of these scales. They say what it did, and not what its bench can do."""
    ratios = scales.stroke / REFERENCE.stroke, scales.current / REFERENCE.current, scales.force / REFERENCE.force
    return Sizes(*(1.0 if 1.0 / LIKE_SHIPPED <= ratio <= LIKE_SHIPPED else ratio for ratio in ratios))


def sizes_of_bench(bench: GeneratorSettings) -> Sizes:
    """Return the sizes of experiments for a bench with these limits."""
    limits, shipped = bench.limits, GeneratorSettings().limits
    return Sizes(limits.stroke / shipped.stroke, limits.current_max / shipped.current_max, limits.force / shipped.force)


def usual_bench(sizes: Sizes) -> GeneratorSettings:
    """Return the limits of the shipped bench, enlarged or reduced to these sizes."""
    shipped = GeneratorSettings()
    limits, expected = shipped.limits, shipped.force_envelope
    motion, current, force = sizes.motion, sizes.current, sizes.force
    return replace(
        shipped,
        limits=replace(
            limits,
            **{name: getattr(limits, name) * motion for name in ("stroke", "margin", "speed", "acceleration", "jerk")},
            **{name: getattr(limits, name) * current for name in ("current_min", "current_max")},
            force=limits.force * force,
        ),
        force_envelope=ForceEnvelope(
            offset=expected.offset * force,
            yield_force=expected.yield_force * force,
            yield_slope=expected.yield_slope * force / current,
            viscosity=expected.viscosity * force / motion,
            viscosity_slope=expected.viscosity_slope * force / motion / current,
        ),
    )


def _multisine(amplitude: float, highest: float, seed: int) -> Multisine:
    """Return an odd multisine, in m and Hz. Its period is half the run: what differs between the halves is noise."""
    return Multisine(amplitude, 0.2, highest, DURATION / 2, 1.0, seed)


def _levels(highest: float, seed: int) -> Aprbs:
    """Return random levels of current from 0 to ``highest`` in A."""
    return Aprbs(0.0, highest, 0.03, 0.3, 12, seed)


def _candidates(sizes: Sizes) -> Iterator[tuple[str, str, Waveform, Waveform]]:
    """Yield name, description, and waveforms of rod and coil. All fit within the limits of `usual_bench`."""
    mm, ma = sizes.mm, sizes.ma
    off = Constant(0.0)

    def text(*lengths: float) -> str:
        return " to ".join(f"{1e3 * mm(length):.3g}" for length in lengths)

    for size, amplitude, highest, current in (
        ("large", 12.0, 8.0, 260.0),
        ("medium", 5.0, 8.0, 400.0),
        ("small", 1.0, 12.0, 480.0),
    ):
        motion, rod = f"odd multisine of {text(amplitude)} mm up to {highest:g} Hz", _multisine(mm(amplitude), highest, 1)
        yield f"{size}_random_current", f"{motion} at random currents", rod, _levels(ma(current), 2)
        yield f"{size}_no_current", f"{motion} without current", rod, off
        yield f"{size}_current", f"{motion} at constant current", rod, Constant(ma(current))
    steps = Ladder((mm(100), mm(10)), mm(20), 3.0)
    at_two = f"steps of current at constant {text(100)} and {text(10)} mm/s"
    # A servo that overshoots at the reversal while the current steps needs a margin to the limit of the force.
    yield "steps_at_two_speeds", at_two, steps, Prbs(0.0, ma(300), 0.06, 8, 2)
    triangle, steady = Triangle(mm(20), mm(50)), f"at constant {text(50)} mm/s"
    yield "slow_steps", f"long steps of current {steady}", triangle, Prbs(0.0, ma(450), 0.3, 8, 4)
    yield "fast_steps", f"fast steps of current {steady}", triangle, Prbs(0.0, ma(450), 0.016, 10, 5)
    loops = (0, 200, 400, 500, 400, 200, 0, 200, 400, 200, 300, 200, 400, 500, 300, 100, 300, 100, 0, 500)
    yield (
        "current_loops",
        f"nested loops of the current at constant {text(30)} mm/s",
        Triangle(mm(24), mm(30)),
        Staircase(tuple(map(ma, loops)), 0.3),
    )
    ladder = Ladder((mm(150), mm(50), mm(15), mm(5)), mm(18), 1.0)
    currents = Staircase((0.0, ma(120), ma(240)), 4.0)
    yield "speed_ladder", f"triangles of {text(5, 150)} mm/s at three currents", ladder, currents
    slow = Ladder((mm(0.3), mm(1), mm(3), mm(10)), mm(2), 1.5)
    for end, side in (("inner", -1), ("outer", 1)):
        yield (
            f"slow_reversals_{end}",
            f"triangles of {text(0.3, 10)} mm/s near the {end} end",
            replace(slow, offset=side * mm(23.8)),
            Staircase((0.0, ma(100)), 6.0),
        )
    whole = Sine(mm(25.8), 1 / 6)
    yield "whole_stroke", "two slow sines over the whole stroke, without current", whole, off
    yield "whole_stroke_current", "two slow sines over the whole stroke, at random currents", whole, _levels(ma(500), 6)
    for end, side in (("inner", -1), ("outer", 1)):
        fast = Sine(mm(13), 2.0, side * mm(12.5))
        yield f"fast_{end}", f"fast sine towards the {end} end, without current", fast, off
    yield "fast_random_current", "fast sine at random currents", Sine(mm(8), 2.0), _levels(ma(300), 7)
    chirp = Chirp(mm(16), 0.5, 12.0, constant_speed=True)
    yield "chirp_no_current", "chirp of 0.5 to 12 Hz at equal peak speed, without current", chirp, off
    yield "chirp_random_current", "chirp of 0.5 to 12 Hz at equal peak speed, at random currents", chirp, _levels(ma(350), 8)
    micro = Chirp(mm(0.4), 1.0, 10.0, constant_speed=True)
    high = Staircase((ma(580), ma(200), ma(400)), 1.0)
    yield "micro_strokes", f"strokes of {text(0.4)} down to {text(0.04)} mm at high currents", micro, high


def library(bench: GeneratorSettings, sizes: Sizes = Sizes(), names: Collection[str] | None = None) -> tuple[Plan, ...]:
    """Return experiments of about a quarter of a minute, each within the limits of a bench; with ``names``, only these.

    Motion and current of an experiment beyond a limit are scaled down; one that does not fit even then is left out. The last
    experiment takes longer, because it warms the damper.

    The experiments are code and not files, so that they come with the package and adapt to the limits of any bench.
    """
    return _planned(bench, sizes, None if names is None else frozenset(names))


@lru_cache(maxsize=8)
def _planned(bench: GeneratorSettings, sizes: Sizes, names: frozenset[str] | None) -> tuple[Plan, ...]:
    experiments = [
        Experiment(name, DURATION, RATE, rod, coil, description=description)
        for name, description, rod, coil in _candidates(sizes)
    ]
    warm = Experiment(
        "long_and_warm",
        DURATION,
        RATE,
        _multisine(sizes.mm(12.0), 8.0, 9),
        Constant(sizes.ma(240)),
        repeats=3,
        description="fast motion at constant current, three times in a row, which warms and settles the damper",
    )
    plans = (
        plan_scaled(experiment, bench.limits, bench.force_envelope)
        for experiment in (*experiments, warm)
        if names is None or experiment.name in names
    )
    return tuple(planned for planned in plans if planned is not None)
