"""Cycles: dissipated energy, equivalent viscous damping, width of the hysteresis; and ratios of forces."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from mrd_characterisation.average import average
from mrd_characterisation.characterisation import Loop, Value, by_size
from mrd_characterisation.force_speed import branch_difference
from mrd_characterisation.strokes import Cycle

ENERGY = (
    "Closed integral of the unfiltered force over the smoothed position along one cycle; mean over the periodic cycles of "
    "the same current, peak speed and stroke."
)
DAMPING = (
    "Energy of a cycle over the integral of the squared smoothed velocity over its time, which for a sine of amplitude X "
    "and angular frequency w is E / (pi w X²); mean over the same cycles."
)
WIDTH = (
    "Decelerating less accelerating branch, in the direction that resists the motion, at half the peak speed; mean of both "
    "directions and of the same cycles. A stiffness widens it."
)
ASYMMETRY = (
    "(R - C) / (R + C) of the resisting forces of rebound, R, and compression, C, at this speed; a gas force counts. The "
    "interval follows from those of both forces."
)
RANGE = (
    "Resisting force at the largest current over that at the smallest one, at the same speed; both are means of rebound and "
    "compression, so that a gas force cancels. The interval follows from those of the four forces."
)


def cycle_values(groups: Sequence[Sequence[Cycle]]) -> list[Value]:
    """Return energy, equivalent viscous damping and hysteresis width of groups of equal cycles."""
    values = []
    for cycles in groups:
        names = [cycle.run.run.name for cycle in cycles]
        condition: dict[str, Any] = {
            "current": cycles[0].current,
            "speed": float(np.mean([cycle.peak_speed for cycle in cycles])),
            "stroke": float(np.mean([cycle.length for cycle in cycles])),
        }
        energies, squares = zip(*(_energy_and_square(cycle) for cycle in cycles), strict=True)
        dampings = [energy / square for energy, square in zip(energies, squares, strict=True)]
        values.append(Value("energy_per_cycle", *average(energies, names), ENERGY, **condition))
        values.append(Value("equivalent_damping", *average(dampings, names), DAMPING, **condition))
        widths = [0.5 * (branch_difference(cycle.rebound) - branch_difference(cycle.compression)) for cycle in cycles]
        if not any(map(math.isnan, widths)):
            values.append(Value("hysteresis_width", *average(widths, names), WIDTH, **condition))
    return values


def _energy_and_square(cycle: Cycle) -> tuple[float, float]:
    """Return the dissipated energy of a cycle in J, and the integral of its squared velocity in m²/s."""
    run = cycle.run
    position, force = run.motion.position[cycle.samples], run.run.force[cycle.samples]
    # The first sample again closes the loop.
    energy = trapezoid(np.append(force, force[0]), np.append(position, position[0]))
    square = trapezoid(run.motion.velocity[cycle.samples] ** 2, run.run.time[cycle.samples])
    return float(energy), float(square)


def representative_loop(cycles: Sequence[Cycle]) -> Loop:
    """Return the cycle of a group with the median energy, closed as for its energy."""
    energies = [_energy_and_square(cycle)[0] for cycle in cycles]
    cycle = cycles[int(np.argsort(energies)[len(energies) // 2])]
    motion = cycle.run.motion
    series = (motion.position, motion.velocity, cycle.run.run.force)
    return Loop(
        cycle.current,
        cycle.peak_speed,
        cycle.length,
        cycle.run.run.name,
        *(np.append(one[cycle.samples], one[cycle.samples.start]) for one in series),
    )


def asymmetries(forces: Sequence[Value]) -> list[Value]:
    """Return the asymmetry of rebound and compression at each current and speed of forces at speeds."""
    values = []
    for rebound, compression in _pairs(forces):
        total = _resisting((rebound, compression))
        if total > 0.0:
            value = (rebound.value + compression.value) / total
            slopes = (-2.0 * compression.value / total**2, 2.0 * rebound.value / total**2)
            values.append(_ratio("asymmetry", value, slopes, (rebound, compression), ASYMMETRY, rebound.current))
    return values


def dynamic_ranges(forces: Sequence[Value]) -> list[Value]:
    """Return the force at the largest current over that at the smallest one, at each speed at which both were recorded."""
    values = []
    currents = by_size(value.current or 0.0 for value in forces)
    for speed in sorted({value.speed or 0.0 for value in forces}) if len(currents) > 1 else ():
        pairs = {pair[0].current or 0.0: pair for pair in _pairs(forces) if pair[0].speed == speed}
        least, most = pairs.get(currents[0]), pairs.get(currents[-1])
        if least and most and (low := _resisting(least)) > 0.0:
            high = _resisting(most)
            slopes = (1.0 / low, -1.0 / low, -high / low**2, high / low**2)
            values.append(_ratio("dynamic_range", high / low, slopes, (*most, *least), RANGE, most[0].current))
    return values


def _pairs(forces: Sequence[Value]) -> list[tuple[Value, Value]]:
    """Return the forces of rebound and compression at the same current and speed."""
    compressions = {(value.current, value.speed): value for value in forces if value.direction == "compression"}
    rebounds = [value for value in forces if value.direction == "rebound"]
    return [(one, compressions[one.current, one.speed]) for one in rebounds if (one.current, one.speed) in compressions]


def _resisting(pair: tuple[Value, Value]) -> float:
    """Return the sum of the resisting forces of both directions in N; a gas force cancels."""
    return pair[0].value - pair[1].value


def _ratio(
    quantity: str, value: float, slopes: Sequence[float], forces: Sequence[Value], definition: str, current: float | None
) -> Value:
    """Return a ratio of forces, whose errors go on to it by its derivatives (slopes) with respect to them."""
    half = math.hypot(*(slope * (force.upper - force.value) for slope, force in zip(slopes, forces, strict=True)))
    return Value(
        quantity,
        value,
        value - half,
        value + half,
        math.hypot(*(slope * force.scatter for slope, force in zip(slopes, forces, strict=True))),
        min(force.cycles for force in forces),
        min(force.runs for force in forces),
        definition,
        current=current,
        speed=forces[0].speed,
    )
