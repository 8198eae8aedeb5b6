"""Stability of a hybrid test: which delay of the actuator the loop of emulated system and measured damper bears.

The force comes late, so part of the energy that the damper should take is fed into the emulated system. The loop is looked
at as sampled: exact propagation of the system, predictor, dead time, lag, and the damper by its describing function, that is
by the linear damper which gives the same first harmonic on a sine of one amplitude (Horiuchi et al., Earthq. Eng. Struct.
Dyn. 28 (1999) 1121, for linear specimens). The winding number of the characteristic function counts the unstable modes.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_control.controller import Actuator, step_matrix
from mrd_control.linear import LinearSystem, propagate
from mrd_control.prediction import MODEL, find_predictor
from mrd_sim.damper import Damper
from mrd_sim.path import make_path

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

AMPLITUDE = 2e-3
"""m of the rod, at which a loop has to be stable. No delayed loop with a yielding damper is stable at all amplitudes: before
the fluid yields the damper is stiff, and the loop trembles within a fraction of this."""
SLOWEST_GROWTH = 0.02
"""1/s. A mode that grows more slowly counts as stable."""
LONGEST = 0.5
"""s of delay, up to which the margin is looked for."""
FREQUENCIES = np.geomspace(0.1, 400.0, 40)
"""Hz, at which the describing function is computed."""
CYCLES, PER_CYCLE = 3, 256
HEAVIEST = 1e4
"""Factor on the masses up to which a stable one is looked for."""


@dataclass(frozen=True)
class Margin:
    """How much delay a hybrid loop bears.

    Attributes
    ----------
    delay : float
        s, of dead time and lag together, from which on the loop is unstable; infinite where it bears any.
    frequency : float
        Hz, of the mode that becomes unstable first.
    current : float
        A, at which this happens.
    least, most : float
        s: the loop stays stable while the delay is between these and the predictor stays prepared for the one declared.
    """

    delay: float
    frequency: float
    current: float
    least: float = math.nan
    most: float = math.nan

    def describe(self, has: float) -> str:
        """Say how much delay the loop bears, and which error of a declared delay ``has`` in s."""
        bears = f"it is stable up to a delay of {1e3 * self.delay:.3g} ms and has {1e3 * has:.3g} ms"
        return f"{bears}; compensated for these it stays stable from {1e3 * self.least:.3g} to {1e3 * self.most:.3g} ms"


def describing_function(damper: Damper, amplitude: float, current: float) -> tuple[Array, Array]:
    """Return stiffness in N/m and viscous coefficient in N s/m of the equivalent linear damper at `FREQUENCIES`.

    Parameters
    ----------
    damper : Damper
    amplitude : float
        Of the rod, m.
    current : float
        Constant, A.
    """
    stiffness, viscous = np.empty_like(FREQUENCIES), np.empty_like(FREQUENCIES)
    theta = damper.model.without_effects(damper.theta)
    for i, w in enumerate(2.0 * math.pi * FREQUENCIES):
        phase = 2.0 * math.pi * np.arange(CYCLES * PER_CYCLE) / PER_CYCLE
        sine, cosine = np.sin(phase), np.cos(phase)
        motion = amplitude * sine, amplitude * w * cosine, -amplitude * w * w * sine
        path = make_path(phase / w, *motion, np.full_like(phase, current))
        last = slice(-PER_CYCLE, None)
        force = damper.model.force(theta, path)[last]
        stiffness[i] = 2.0 * np.mean(force * sine[last]) / amplitude
        viscous[i] = 2.0 * np.mean(force * cosine[last]) / (amplitude * w)
    return stiffness, viscous


def stability_margin(
    system: LinearSystem,
    damper: Damper,
    actuator: Actuator,
    rate: float,
    currents: Sequence[float],
    amplitude: float = AMPLITUDE,
) -> Margin:
    """Return the least delay margin over the coil currents.

    The dead time of the actuator is varied, its lag kept. Unless the actuator says by how much it predicts, its predictor is
    prepared for each delay; so the margin of a compensated loop is the delay up to which compensation can work.

    Parameters
    ----------
    system : LinearSystem
    damper : Damper
    actuator : Actuator
    rate : float
        Hz, of the controller.
    currents : sequence of float
        A.
    amplitude : float
        Of the rod, m.
    """
    functions = [(describing_function(damper, amplitude, current), current) for current in currents]
    return _least_margin(system, functions, actuator, rate)


def check_stability(
    system: LinearSystem,
    damper: Damper,
    actuator: Actuator,
    rate: float,
    currents: Sequence[float],
    amplitude: float = AMPLITUDE,
) -> Margin:
    """Return the `stability_margin` of a set-up that is stable, and how wrong its delay may be.

    Raises
    ------
    InputError
        For an unstable set-up: how much delay it bears, and with how much more mass it would bear its own.
    """
    functions = [(describing_function(damper, amplitude, current), current) for current in currents]
    margin = _least_margin(system, functions, actuator, rate)

    has = actuator.total_delay
    if margin.delay > has:
        # Of the currents, the ends and the worst one; all of them would double the time of the check.
        few = [function for function, current in functions if current in (currents[0], margin.current, currents[-1])]

        def stable(total: float) -> bool:
            wrong = replace(actuator, delay=max(total - actuator.lag, 0.0), ahead=actuator.predicted)
            return all(unstable_modes(system, *function, wrong, rate)[0] == 0 for function in few)

        return replace(margin, least=_edge(stable, has, actuator.lag), most=_edge(stable, has, has + LONGEST))

    def heavy_enough(factor: float) -> bool:
        heavier = replace(system, mass=factor * system.mass)
        return all(unstable_modes(heavier, *function, actuator, rate)[0] == 0 for function, _ in functions)

    remedy = f"a total delay below {1e3 * margin.delay:.3g} ms (compensate it)"
    if heavy_enough(HEAVIEST):
        low, high = 1.0, HEAVIEST
        while high / low > 1.01:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if heavy_enough(middle) else (middle, high)
        remedy += f", or {high:.3g} times the masses"
    raise InputError(
        f"the hybrid loop is unstable: at {margin.current:.3g} A it is stable up to a delay of {1e3 * margin.delay:.3g} ms "
        f"and has {1e3 * actuator.total_delay:.3g} ms (grows at {margin.frequency:.3g} Hz); stable would be {remedy}"
    )


def trembling_amplitude(
    system: LinearSystem, damper: Damper, actuator: Actuator, rate: float, currents: Sequence[float], most: float = 0.02
) -> float:
    """Return the amplitude of the rod in m above which the loop is stable: it trembles with about this one."""
    low, high = 1e-6, most
    while high / low > 1.05:
        middle = math.sqrt(low * high)
        stable = all(
            unstable_modes(system, *describing_function(damper, middle, current), actuator, rate)[0] == 0
            for current in currents
        )
        low, high = (low, middle) if stable else (middle, high)
    return high


def _least_margin(
    system: LinearSystem, functions: Sequence[tuple[tuple[Array, Array], float]], actuator: Actuator, rate: float
) -> Margin:
    return min(
        (_margin(system, function, actuator, rate, current) for function, current in functions),
        key=lambda margin: margin.delay,
    )


def _edge(stable: Callable[[float], bool], inside: float, outside: float) -> float:
    """Return the delay in s at which stability ends on the way from a stable delay to another one, or this other one."""
    last = inside
    for part in np.geomspace(1e-2, 1.0, 16):
        delay = inside + part * (outside - inside)
        if not stable(delay):
            while abs(delay - last) > 1e-3 * max(delay, last):
                middle = 0.5 * (last + delay)
                last, delay = (middle, delay) if stable(middle) else (last, middle)
            return last
        last = delay
    return outside


def _margin(system: LinearSystem, function: tuple[Array, Array], actuator: Actuator, rate: float, current: float) -> Margin:
    """Return the margin with one linear damper: a search for the first unstable delay, then bisection."""

    def unstable(total: float) -> tuple[int, float]:
        changed = replace(actuator, delay=max(total - actuator.lag, 0.0))
        return unstable_modes(system, *function, changed, rate)

    low, high = actuator.lag, math.inf
    if unstable(low)[0]:
        return Margin(0.0, unstable(low)[1], current)
    for delay in actuator.lag + np.geomspace(0.05 / rate, LONGEST, 80):
        if unstable(delay)[0]:
            high = float(delay)
            break
        low = float(delay)
    if math.isinf(high):
        return Margin(math.inf, math.nan, current)
    while high - low > 1e-3 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if unstable(middle)[0] else (middle, high)
    return Margin(low, unstable(high)[1], current)


def unstable_modes(
    system: LinearSystem, stiffness: Array, viscous: Array, actuator: Actuator, rate: float
) -> tuple[int, float]:
    """Return the number of unstable modes of a hybrid loop, and the frequency in Hz where it is nearest to another number.

    Parameters
    ----------
    system : LinearSystem
    stiffness, viscous : ndarray (frequencies,)
        Of the damper in N/m and N s/m at `FREQUENCIES`.
    actuator : Actuator
    rate : float
        Hz.
    """
    characteristic, angular = _characteristic(system, stiffness, viscous, actuator, rate)
    # Along half the circle; the other half mirrors it. All poles of the function lie inside, so what turns are the zeros
    # outside.
    turned = float(np.sum(np.angle(characteristic[1:] / characteristic[:-1])))
    nearest = int(np.argmin(np.abs(characteristic)))
    return round(-turned / math.pi), float(angular[nearest] / (2.0 * math.pi))


def _characteristic(
    system: LinearSystem, stiffness: Array, viscous: Array, actuator: Actuator, rate: float
) -> tuple[Complex, Array]:
    """Return 1 - (damper)(actuator)(predictor)(system) just outside the unit circle, and the angular frequencies."""
    period, order = 1.0 / rate, system.order
    step = step_matrix(system, period)
    transition, entry = step[:, :order], step[:, order + 2] + step[:, order + 5]
    poles, vectors = np.linalg.eig(transition)
    angular = _frequencies(np.abs(np.angle(poles)) * rate, rate)
    z = np.exp((SLOWEST_GROWTH + 1j * angular) * period)
    ahead = actuator.predicted
    row, direct, prediction = system.outputs[3], 0.0, np.ones_like(z)
    if actuator.predictor == MODEL:
        # The travel of the emulated system ``ahead``, if the force stayed as it is; the base is no part of the loop.
        future = propagate(system.a, system.b, max(ahead, 1e-9))
        direct = float(row[:order] @ (future.before + future.after)[:, 2])
        row = row[:order] @ future.transition
    elif actuator.predictor == "polynomial":
        weights, _ = find_predictor(actuator.predictor).prepare(period, ahead)
        spacing = max(round(ahead * rate), 1)
        prediction = sum(weight * z ** (-i * spacing) for i, weight in enumerate(weights))
    elif actuator.predictor == "adaptive":
        guess = max(ahead, period)
        row = row + guess * system.outputs[4] + 0.5 * guess * guess * system.outputs[5]
        direct = row[order + 2]
    inner = np.linalg.solve(vectors, entry)
    response = ((row[:order] @ vectors) * inner / (z[:, None] - poles)).sum(axis=1) + direct / z
    samples = actuator.delay * rate
    whole = math.floor(samples)
    rod = z**-whole * ((1.0 - samples + whole) + (samples - whole) / z)
    if actuator.lag > 0.0:
        left = math.exp(-period / actuator.lag)
        share = actuator.lag / period * (1.0 - left)
        lagged = ((1.0 - share) + (share - left) / z) / (1.0 - left / z)
        speed = (1.0 - lagged) / actuator.lag
    else:
        lagged, speed = np.ones_like(z), (3.0 - 4.0 / z + 1.0 / z**2) / (2.0 * period)
    frequency = angular / (2.0 * math.pi)
    damper = np.interp(frequency, FREQUENCIES, stiffness) * lagged + np.interp(frequency, FREQUENCIES, viscous) * speed
    return np.asarray(1.0 - damper * rod * prediction * response), angular


def _frequencies(natural: Array, rate: float) -> Array:
    """Return angular frequencies from 0 to the Nyquist frequency, dense at the natural ones in rad/s."""
    around = SLOWEST_GROWTH * np.sinh(np.linspace(-14.0, 14.0, 400))
    dense = np.concatenate([np.unique(natural)[:, None] + around]).ravel()
    every = np.concatenate([np.geomspace(1e-3, math.pi * rate, 3000), dense, [0.0]])
    return np.unique(every[(every >= 0.0) & (every <= math.pi * rate)])
