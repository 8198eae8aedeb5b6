"""What to record next, so that explanations that the recordings leave open are told apart.

For each experiment of a library and each two explanations: how far the force that one predicts stays apart from whatever the
other can predict once it is fitted to everything recorded so far and to that prediction (T-optimality: Hunter & Reiner 1965;
Atkinson & Fedorov 1975).
"""

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Advice
from mrd_diagnosis.effect_names import effect_name
from mrd_diagnosis.experiment_design.candidates import RATE, library
from mrd_diagnosis.experiment_design.separation import Foreseen, Pair, Separation
from mrd_diagnosis.refit import Refit
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import Weighting
from mrd_identification.parallel import in_threads
from mrd_sim.effects import EFFECTS, STAGES
from mrd_trajectory.experiment import format_experiment
from mrd_trajectory.plan import Plan
from mrd_trajectory.settings import GeneratorSettings, read_settings

Array = NDArray[np.float64]

BENCH = read_settings(None)

SENSORS: Mapping[tuple[str, ...], str] = {
    ("load_cell_gain", "load_cell_drift"): "hang dead weights on the cell, and tare it with the rod free, before and after",
    ("thermal_fade", "settling"): "record the damper's temperature too, and the same run cold, warm and after a rest",
    ("backlash", "joint_play", "series_compliance"): "add a second displacement sensor, across the damper itself",
    ("channel_delay", "force_sensor_lag"): "show all channels one event, such as a blow to the rod, and compare its times",
    ("lvdt_nonlinearity", "servo_ripple"): "compare the position sensor with the motor's encoder, or with gauge blocks",
    ("current_sensor_error",): "record the sensors without current, and the current through a shunt beside its sensor",
    ("mains_hum", "channel_crosstalk"): "record with the load cell off the damper, at rest and while rod and current move",
}
"""What to measure beside the runs, by effect; the first that fits counts."""

SENSORS_OF_STAGE = {
    "drive": "add a displacement sensor on the rod, beside the one on the drive",
    "magnetics": "add a search coil or a Hall sensor at the piston, which shows the flux",
    "fluid": "record the damper's temperature and its gas pressure too",
    "structure": "add a load cell at the damper's other end",
    "sensing": "check the load cell and its amplifier with known forces",
}
"""The same for any other effect."""


def advise(
    rivals: Mapping[str, Refit],
    weighting: Weighting,
    rng: np.random.Generator | None = None,
    *,
    without: Refit | None = None,
    bench: GeneratorSettings = BENCH,
    progress: Callable[[float], None] = lambda _share: None,
) -> Advice | None:
    """Which experiment, or else which sensor, would tell explanations apart.

    Parameters
    ----------
    rivals : mapping
        Refits on the weighting by what they explain the gap by: an effect's id, another form, "" for the model alone.
    weighting : Weighting
    rng : numpy Generator, optional
        Of the errors that are drawn; the same each time without one.
    without : Refit, optional
        Without what the rivals explain the gap by. An experiment then must tell them apart by more than what a form that is
        a little off leaves of the gap, as `mrd_diagnosis.statistics.probabilities` has it.
    bench : GeneratorSettings, optional
        Whose limits no experiment exceeds; default: the shipped bench.
    progress : callable
        Called with the share of the work that is done.

    Returns
    -------
    Advice or None
        None for fewer than two rivals. An experiment is advised where it tells at least one pair apart, with fewer wrong
        choices than `Thresholds.wrong_choices`: the one that does so for most pairs, and among those the one that separates
        them best.
    """
    if len(rivals) < 2:
        return None
    rng = rng or np.random.default_rng(0)
    plans, done = library(bench), itertools.count(1)
    foreseen = Foreseen.of(rivals, weighting, rng, without)

    def separations(each: tuple[Plan, np.random.Generator]) -> dict[Pair, Separation] | None:
        found = foreseen.separations(each[0], bench.limits.force, each[1])
        progress(next(done) / len(plans))
        return found

    distances_of = in_threads(separations, list(zip(plans, rng.spawn(len(plans)), strict=True)))
    judged = [(planned, found) for planned, found in zip(plans, distances_of, strict=True) if found is not None]
    if not judged:
        pair = next(itertools.combinations(rivals, 2))
        return Advice(
            f"No run of the library is safe: each would exceed the bench's {bench.limits.force:g} N or another limit; "
            f"{sensor(*(foreseen.rivals[name].effects for name in pair))}.",
            between=pair,
        )
    planned, distances = max(judged, key=lambda each: _merit(*each))
    errors = {pair: found.error_rate for pair, found in distances.items()}
    told = {pair: errors[pair] for pair, found in distances.items() if found.tells}
    left = max((pair for pair in errors if pair not in told), key=errors.__getitem__, default=None)
    remedy = left and sensor(*(foreseen.rivals[name].effects for name in left))
    if left and not told:
        why = (
            f"{_percent(errors[left])} wrong choices to expect even after the best one"
            if errors[left] >= THRESHOLDS.wrong_choices
            else "they differ by less than either may err in its form"
        )
        return Advice(f"No run of the library would tell {_listed(left)} apart ({why}); {remedy}.", between=left)
    between = tuple(name for name in rivals if any(name in pair for pair in told))
    worst = max(told.values())
    experiment = replace(planned.experiment, rate=_rate(weighting))
    text = f"Record {experiment.name}, {experiment.description}: it tells {_listed(between)} apart"
    if left:
        text += f", but not {_listed(left)} from each other: {remedy}"
    return Advice(f"{text} ({_percent(worst)} wrong choices to expect).", format_experiment(experiment), between, worst)


def sensor(one: Collection[str], other: Collection[str]) -> str:
    """What to measure that tells explanations apart which no run does, given their effects."""
    differing = [effect for effect in EFFECTS if (effect in one) != (effect in other)]
    for effects, text in SENSORS.items():
        if any(effect in effects for effect in differing):
            return text
    # Where cause becomes reading, the earliest stage decides.
    first = min((EFFECTS[effect] for effect in differing), key=lambda effect: STAGES.index(effect.stage))
    return f"{SENSORS_OF_STAGE[first.stage]} (for {effect_name(first.id)}: {first.separated_by})"


def _merit(planned: Plan, distances: Mapping[Pair, Separation]) -> tuple[int, float]:
    """Pairs that a run tells apart; the smallest distance of these, or the largest of all, for every second of it."""
    told = [found.squared for found in distances.values() if found.tells]
    return len(told), (min(told) if told else max(found.squared for found in distances.values())) / planned.duration


def _rate(weighting: Weighting) -> float:
    """Hz: that of the recordings, so that all can be compared, unless it is a slow one."""
    fastest = max(recording.run.rate for recording in weighting.recordings)
    return float(f"{np.clip(fastest, RATE, 2000.0):.3g}")


def _listed(names: Sequence[str]) -> str:
    said = [effect_name(name) for name in names]
    return ", ".join(said[:-1]) + f" and {said[-1]}"


def _percent(error: float) -> str:
    return f"{100 * error:.2g} %" if error > 1e-4 else "below 0.01 %"
