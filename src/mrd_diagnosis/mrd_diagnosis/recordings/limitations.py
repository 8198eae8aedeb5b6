"""Limitations: effects about which recordings say nothing at all, and notes on what limits a diagnosis."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.diagnosis import RunNoise, UntestableEffect
from mrd_diagnosis.recordings.multisine import distortion
from mrd_diagnosis.recordings.repetition import repeating_period
from mrd_diagnosis.wording.quantities import format_quantity
from mrd_identification.needs import needs_met
from mrd_identification.recording import Recording, current_levels
from mrd_sim.effects import EFFECTS, NEEDS
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]

SLOW_RATE = 100.0
"""Sampling rate in Hz below which time constants of coil and fluid fall between the samples."""


def untestable_effects(
    model: DamperModel, parameters: Array | None, candidates: Sequence[str], recordings: Sequence[Recording]
) -> tuple[UntestableEffect, ...]:
    """Return the candidates about which these recordings say nothing, whatever their size.

    Parameters
    ----------
    model : DamperModel
    parameters : ndarray (parameters,) or None
        Of the simulator as it is, where they are known.
    candidates : sequence of str
    recordings : sequence of Recording
    """
    reasons: dict[str, str] = {}
    has = needs_met(recordings)
    for effect in candidates:
        if contains(model, effect):
            reasons[effect] = "the model contains it already"
        if effect == "coil_lag" and parameters is not None and parameters[model.names.index(effect)] > 0.0:
            reasons[effect] = "the simulator contains it already"
        for need in EFFECTS[effect].needs:
            if not has[need]:
                reasons[effect] = NEEDS[need]
    return tuple(UntestableEffect(effect, why) for effect, why in reasons.items())


def contains(model: DamperModel, effect: str) -> bool:
    """Whether a damper model describes an effect by itself."""
    if EFFECTS[effect].structural:
        return bool(model.states)
    return EFFECTS[effect].coefficient in {coefficient.name for coefficient in model.coefficients}


def limitation_notes(recordings: Sequence[Recording], noise: Sequence[RunNoise]) -> list[str]:
    """Return sentences on what limits a diagnosis of these recordings."""
    notes = []
    if len(recordings) == 1:
        notes.append(
            "Only one run: its segments replace runs, which is weaker evidence, and the scatter between runs is unknown."
        )
    if {noise_of_run.source for noise_of_run in noise} == {"residual"}:
        notes.append(
            "No run repeats another one, so the noise of the force was estimated from the fast part of the model's error."
        )
    rate = min(recording.run.rate for recording in recordings)
    if rate < SLOW_RATE:
        notes.append(
            f"The sampling rate is {rate:.0f} Hz: effects faster than about {1000 / rate:.0f} ms, or smaller than the rod's "
            "travel between two samples, are not visible and cannot be ruled out."
        )
    return [*notes, *filter(None, (_distortion_note(recording) for recording in recordings))]


def _distortion_note(recording: Recording) -> str:
    """Return what an odd multisine at constant current shows of noise and distortion; empty for other runs."""
    run = recording.run
    period = None if current_levels([run])[1] else repeating_period(recording.smoothed)
    try:
        levels = distortion(run, period) if period else None
    except InputError:  # periodic, but no odd multisine
        levels = None
    if levels is None:
        return ""
    if levels.excited == 1:
        motion, even, odd = "is a sine", "even multiples of its frequency", "odd multiples"
    else:
        motion, even, odd = "has a motion of odd harmonics only", "even harmonics", "odd ones that the motion has not"
    noise, of_even, of_odd = (format_quantity(level, "N") for level in (levels.noise, levels.even, levels.odd))
    beside = f" and {of_odd} rms at {odd} (friction, hysteresis)" if np.isfinite(levels.odd) else ""
    return (
        f"Run {run.name} {motion}. Its force differs by {noise} rms from period to period (noise); {of_even} rms lie at "
        f"{even} (asymmetry){beside}."
    )
