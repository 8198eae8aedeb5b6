"""Response of the force to the motion: which delay and which low-pass filter the force went through after the damper.

The force of any MR damper is close to a sum of a few terms of the motion: friction that develops over a short travel after
a reversal (Dahl 1968, here for several travels) or above a creep speed (Stanway et al. 1985), a viscous force, springs and
end stops; friction and viscosity also in proportion to the current. Travel explains how loops are rounded in space; a delay
or a filter shifts and rounds them in time. With motions of several speeds, the two differ. So the sum is fitted behind each
of many delays and filters, and the errors are compared. All fits share one set of spectra, which a filter only weights.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft
from scipy.signal import lfilter, windows

from mrd_identification.low_pass import Kind, LowPass
from mrd_identification.recording import current_varies
from mrd_runs import Run
from mrd_runs.scales import scales_of

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

YIELD_TRAVELS = (1.5e-3, 5e-3, 1.5e-2, 5e-2)
"""Travels, over half the span of the position, over which friction develops after a reversal: those of MR fluids, joints and
mounts."""
CREEP_SPEEDS = (0.02, 0.1)
"""Speeds, over that of fast strokes, below which friction may be viscous. It then falls before the motion turns, as if it
were early."""
SPRING_POWERS = (1, 3, 5)
"""Powers of the position with which springs and end stops act."""
VELOCITY = len(YIELD_TRAVELS)
"""Index of the velocity among the terms."""
CURRENT_LAGS = (0.003, 0.02)
"""Lags in s of the force behind the current; their sum imitates what coil, supply and fluid have."""
HIGHEST_FREQUENCY = 40.0
"""Hz up to which the force is compared; above, noise and errors of the motion rule."""
EMPHASISED_FREQUENCY = 10.0
"""Hz up to which errors count in proportion to their frequency, so that reversals count and slow drift does not."""
SEGMENT = 16.0
"""s, length of the segments whose spectra are summed."""
SHORTEST = 2.0
"""s, shortest run whose response is estimated."""
KINDS: tuple[Kind, ...] = (
    "second_order",
    "fourth_order",
    "zero_phase",
    "zero_phase_fourth_order",
    "moving_average",
    "first_order",
)
"""Filters that are tried."""
DELAYS: Array = 5e-3 * np.arange(-50, 81, dtype=np.float64)
"""Delays in s that are tried."""
DELAYS_OF_FILTERS: Array = 1e-2 * np.arange(-12, 26, dtype=np.float64)
"""Further delays in s that are tried with filters."""
CUTOFFS: Array = np.asarray(np.geomspace(0.5, 40.0, 16), np.float64)
"""Cut-off frequencies in Hz that are tried."""
HIGHEST_CUTOFF = 25.0
"""Hz, above which what looks like a filter may be an error of the sum of terms."""
PHYSICAL_DELAYS = (-0.015, 0.06)
"""s. Skew of the channels and moving mass advance the force by some milliseconds; a converter that reads one channel after
the other delays it by up to 50 ms, and force sensors by about 10 ms."""
SLOWEST_SENSOR = 4.0
"""Hz, cut-off of the slowest force sensor that an effect of the catalogue describes (`force_sensor_lag`, 30 ms)."""
LOWEST_RATE_FOR_FILTERS = 95.0
"""Hz, sampling rate from which filters are looked for."""
SURE_DELAY = 2.0
"""Ratio of squared errors from which a delay is sure; the effects of dampers reach 1.1."""
SURE_FILTER = 3.0
"""The same for a filter, which imitates better what a damper has beyond the terms above: on a single sine, effects of
dampers reach 3, with a small error."""
SURE_CURRENT = 5.0
"""The same for a shift of the current."""
LEAST_ERROR_OF_CURRENT = 0.05
"""Squared error, over the power of the force, below which the current is not shifted."""
SAME_SHIFT = 0.015
"""Shifts in s that differ by less are the same."""
LARGEST_COIL_LAG = 0.1
"""s by which the force may follow the current: coil, supply and fluid."""
SHIFTS_OF_CURRENT: Array = 1e-2 * np.arange(-20, 21, dtype=np.float64)
"""Shifts in s of the current that are tried."""
LEAST_IMPROVEMENT = 0.004
"""Decrease of the squared error, over the power of the force, below which a filter is not sure."""


@dataclass(frozen=True)
class Response:
    """What the force went through after the damper, as far as it can be told from physics.

    Attributes
    ----------
    delay : float
        Delay of the force in s, negative where it is early; 0 where a physical lag may explain it.
    channel : str
        The channel that is shifted: ``force``, ``position``, ``current``, or ``""`` where it cannot be told.
    surely_early : bool
        Whether no delay explains the recording either, as a long one may with a periodic motion.
    low_pass : LowPass or None
        Filter of the force.
    """

    delay: float = 0.0
    channel: str = ""
    surely_early: bool = False
    low_pass: LowPass | None = None


@dataclass(frozen=True)
class _Spectra:
    """Spectra of the terms and of the force, as products summed over the segments.

    Attributes
    ----------
    frequency : ndarray (b,)
    terms : ndarray (b, p, p)
        Real part of the products of terms.
    cross : ndarray (b, p)
        Products of the conjugate terms with the force.
    force : float
        Power of the force.
    """

    frequency: Array
    terms: Array
    cross: ComplexArray
    force: float

    def waves(self, delays: Array) -> tuple[Array, Array]:
        """Return real and imaginary part (d, b) of the factors that undo each delay (d,)."""
        if delays is DELAYS_OF_FILTERS:
            return self._waves_of_filters
        angle = 2 * np.pi * np.outer(delays, self.frequency)
        return np.cos(angle), np.sin(angle)

    @cached_property
    def _waves_of_filters(self) -> tuple[Array, Array]:
        return self.waves(DELAYS_OF_FILTERS.copy())


def force_response(run: Run) -> Response:
    """Return what the force of a run went through, or a neutral response where the run does not show it."""
    interval = float(np.median(np.diff(run.time)))
    if run.duration < SHORTEST or np.ptp(np.diff(run.time)) > 0.5 * interval:
        return Response()
    spectra = _spectra(run)
    errors = _errors(spectra, LowPass("none", np.inf))
    # At low rates, one sample is more than any skew.
    earliest = min(PHYSICAL_DELAYS[0], -1.5 * interval)
    physical = (earliest - 1e-9 <= DELAYS) & (PHYSICAL_DELAYS[1] + 1e-9 >= DELAYS)
    lags = [_errors(spectra, LowPass("first_order", cutoff)) for cutoff in CUTOFFS[CUTOFFS >= SLOWEST_SENSOR]]
    explained = min(float(each[physical].min()) for each in (errors, *lags))
    # Slowly sampled, a periodic motion has too few harmonics to tell a filter from other terms.
    fast = 1 / interval >= LOWEST_RATE_FOR_FILTERS
    tried = sorted(_filters(spectra), key=lambda pair: pair[0]) if fast else []
    filtered = tried[0][0] if fast else np.inf
    unfiltered = min(explained, float(errors.min()))
    if unfiltered > SURE_FILTER * filtered and unfiltered > filtered + LEAST_IMPROVEMENT:
        # The cut-offs that were tried lie too far apart to tell the kinds from one another.
        best_of_kinds = {low_pass.kind: low_pass for _, low_pass in reversed(tried)}.values()
        return Response(low_pass=min((_refined(spectra, each) for each in best_of_kinds), key=lambda pair: pair[0])[1])
    best = int(errors.argmin())
    sure = not physical[best] and explained > SURE_DELAY * errors[best]
    if not sure or errors[best] > LEAST_ERROR_OF_CURRENT:
        shift = _shift_against_current(run, min(explained, float(errors[best])))
        if shift != Response() or not sure:
            return shift
    delay = float(DELAYS[best])
    early = bool(delay < 0 and errors[DELAYS >= 0].min() > SURE_DELAY * errors[best])
    return Response(delay, _shifted_channel(run, delay), early)


def delay_behind(run: Run, low_pass: LowPass) -> float:
    """Return the delay in s of the force of a run in addition to a known filter; 0 where the channels' skew explains it."""
    interval = float(np.median(np.diff(run.time)))
    if run.duration < SHORTEST or np.ptp(np.diff(run.time)) > 0.5 * interval:
        return 0.0
    delay = float(DELAYS[_errors(_spectra(run), low_pass).argmin()])
    return delay if abs(delay) > max(-PHYSICAL_DELAYS[0], 1.5 * interval) else 0.0


def _spectra(run: Run, current_delay: float = 0.0) -> _Spectra:
    interval = float(np.median(np.diff(run.time)))
    terms = _terms(run, current_delay)
    terms /= np.linalg.norm(np.diff(terms), axis=1)[:, None] + 1e-300
    length = min(len(run), int(SEGMENT / interval))
    frequency = fft.rfftfreq(length, interval)
    kept = frequency <= min(HIGHEST_FREQUENCY, 0.4 / interval)
    weight = frequency[kept] / (1 + frequency[kept] / EMPHASISED_FREQUENCY)
    window = windows.tukey(length, 0.1)
    of_terms = np.stack([_spectrum(part, window)[..., kept] * weight for part in _segments(terms, length)])
    of_force = np.stack([_spectrum(part, window)[..., kept] * weight for part in _segments(run.force, length)])
    return _Spectra(
        frequency[kept],
        np.einsum("sab,scb->bac", of_terms, of_terms.conj()).real,
        np.einsum("sab,sb->ba", of_terms.conj(), of_force),
        float(np.sum(np.abs(of_force) ** 2)),
    )


def _segments(series: Array, length: int) -> list[Array]:
    return [series[..., start : start + length] for start in range(0, series.shape[-1] - length + 1, length)]


def _spectrum(series: Array, window: Array) -> ComplexArray:
    return np.asarray(fft.rfft((series - series.mean(axis=-1, keepdims=True)) * window))


def _terms(run: Run, current_delay: float) -> Array:
    """Return the terms (p, n) of which the force of a damper is about a sum."""
    interval = float(np.median(np.diff(run.time)))
    scales = scales_of([run])
    travel = np.append(0.0, 0.5 * (run.velocity[1:] + run.velocity[:-1])) * interval
    friction = [_developed_friction(travel, length * scales.stroke) for length in YIELD_TRAVELS]
    slow_friction = [np.tanh(run.velocity / (speed * scales.speed)) for speed in CREEP_SPEEDS]
    middle, half_stroke = 0.5 * (run.position.max() + run.position.min()), 0.5 * float(np.ptp(run.position))
    from_middle = (run.position - middle) / half_stroke
    springs = [from_middle**power for power in SPRING_POWERS]
    terms = [*friction, run.velocity, *slow_friction, *springs]
    if current_varies(run):
        current = np.interp(run.time - current_delay, run.time, run.current)
        for lag in CURRENT_LAGS:
            keep = np.exp(-interval / lag)
            lagged = lfilter([1 - keep], [1, -keep], current, zi=[keep * current[0]])[0]
            terms += [lagged * term for term in (friction[0], friction[2], run.velocity)]
    return np.stack(terms)


@njit(cache=True, nogil=True)
def _developed_friction(travel: Array, length: float) -> Array:
    """Return friction that develops exponentially over a length in m of travel in one direction; it is ±1 then."""
    friction = np.empty_like(travel)
    state = 0.0
    for k in range(len(travel)):
        kept = np.exp(-abs(travel[k]) / length)
        state = state * kept + np.sign(travel[k]) * (1.0 - kept)
        friction[k] = state
    return friction


def _errors(spectra: _Spectra, low_pass: LowPass, delays: Array = DELAYS) -> Array:
    """Return the squared error of the fitted sum behind a filter and each delay, over the power of the force."""
    response = low_pass.response(spectra.frequency)
    count = spectra.cross.shape[1]
    normal = (np.abs(response) ** 2 @ spectra.terms.reshape(len(response), -1)).reshape(count, count)
    cross = response.conj()[:, None] * spectra.cross
    scale = np.sqrt(np.diag(normal))
    scale = np.maximum(scale, 1e-9 * scale.max()) + 1e-300
    cosine, sine = spectra.waves(delays)
    shifted = cosine @ cross.real - sine @ cross.imag
    lower = np.linalg.cholesky(normal / np.outer(scale, scale) + 1e-9 * np.eye(count))
    errors = 1 - np.sum(np.linalg.solve(lower, shifted.T / scale[:, None]) ** 2, axis=0) / spectra.force
    # A damper resists: half a period later, the sum would fit as well with its sign turned.
    return np.where(shifted[:, VELOCITY] > 0, errors, 1.0)


def _filters(spectra: _Spectra) -> Iterator[tuple[float, LowPass]]:
    """Yield the error of each filter at its best delay."""
    for kind in KINDS:
        for cutoff in CUTOFFS[(SLOWEST_SENSOR if kind == "first_order" else HIGHEST_CUTOFF) > CUTOFFS]:
            errors = _errors(spectra, LowPass(kind, float(cutoff)), DELAYS_OF_FILTERS)
            best = int(errors.argmin())
            yield float(errors[best]), LowPass(kind, float(cutoff), float(DELAYS_OF_FILTERS[best]))


def _refined(spectra: _Spectra, low_pass: LowPass) -> tuple[float, LowPass]:
    """Search the cut-off and the delay of a filter more finely; return its error as well."""
    delays = low_pass.delay + 1e-3 * np.arange(-10, 11, dtype=np.float64)
    found = []
    for factor in np.geomspace(1 / 1.35, 1.35, 25):
        candidate = replace(low_pass, cutoff=float(factor * low_pass.cutoff))
        errors = _errors(spectra, candidate, delays)
        found.append((float(errors.min()), replace(candidate, delay=float(delays[errors.argmin()]))))
    return min(found, key=lambda pair: pair[0])


def _shift_against_current(run: Run, explained: float) -> Response:
    """Return a shift of the current or the position against the other channels, if it explains much more."""
    if explained < LEAST_ERROR_OF_CURRENT or not current_varies(run):
        return Response()
    errors = np.array([_errors(_spectra(run, shift), LowPass("none", np.inf)) for shift in SHIFTS_OF_CURRENT])
    shift_index, delay_index = np.unravel_index(int(errors.argmin()), errors.shape)
    early, delay = float(SHIFTS_OF_CURRENT[shift_index]), float(DELAYS[delay_index])
    if explained < SURE_CURRENT * errors.min():
        return Response()
    if abs(early + delay) < 2 * SAME_SHIFT and abs(early) > SAME_SHIFT:
        # Force and current are shifted against the motion in the same way.
        return Response(early, "position", delay < 0)
    interval = float(np.median(np.diff(run.time)))
    # The force follows the current with the lags of coil and fluid, so that a current that is somewhat early is none.
    lags = PHYSICAL_DELAYS[0] - interval <= early <= LARGEST_COIL_LAG
    if lags or not PHYSICAL_DELAYS[0] <= delay <= PHYSICAL_DELAYS[1]:
        return Response()
    return Response(-early, "current", early < 0)


def _shifted_channel(run: Run, delay: float) -> str:
    """Return which channel is shifted; only a current that varies can tell."""
    if not current_varies(run):
        return ""
    # If the position is shifted, then so is the current against it.
    with_force, with_motion = (
        float(_errors(_spectra(run, shift), LowPass("none", np.inf)).min()) for shift in (-delay, 0.0)
    )
    if with_force * 1.5 < with_motion:
        return "position"
    return "force" if with_motion * 1.5 < with_force else ""
