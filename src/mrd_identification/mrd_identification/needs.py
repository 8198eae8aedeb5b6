"""What effects need of recordings (`mrd_sim.effects.NEEDS`), and whether recordings have it."""

from collections.abc import Sequence

import numpy as np

from mrd_identification.recording import Recording, current_levels
from mrd_runs import Run
from mrd_runs.signals.mains import MAINS_LINES, shows_line
from mrd_sim.effects.effect import Need

LEAST_TEMPERATURE_CHANGE = 2.0
"""K. Whatever the damper, a smaller change is that of the thermometer: thermocouples and their amplifiers are off by as
much, and vary with the room. No fluid changes by more than some per cent over it."""


def needs_met(recordings: Sequence[Recording]) -> dict[Need, bool]:
    """Return for each need of an effect whether recordings meet it."""
    runs = [recording.run for recording in recordings]
    levels, varies = current_levels(runs)
    rate = min(run.rate for run in runs)
    return {
        "changing current": varies,
        "several currents": levels > 1,
        "changing temperature": temperature_changes(runs),
        "mains frequency": any(shows_line(frequency, rate) for frequency in MAINS_LINES),
    }


def temperature_changes(runs: Sequence[Run]) -> bool:
    """Whether every run has a temperature, and these differ by more than `LEAST_TEMPERATURE_CHANGE` over all of them."""
    temperatures = [run.temperature for run in runs if run.temperature is not None]
    if len(temperatures) < len(runs):
        return False
    return float(np.ptp(np.quantile(np.concatenate(temperatures), [0.01, 0.99]))) > LEAST_TEMPERATURE_CHANGE
