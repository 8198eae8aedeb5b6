"""Advice: what to record next, so that explanations that the recordings leave open are told apart.

Each experiment of a library is judged for each pair of explanations: how far is the force that one explanation predicts from
anything that the other one can predict after it is fitted to all recorded runs and to this prediction? This is T-optimal
design (Hunter & Reiner 1965; Atkinson & Fedorov 1975). The experiment that gives most information about which explanation is
true, in a second of the bench's time, is the best one.
"""

import itertools
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np

from mrd_base.progress import ignore
from mrd_diagnosis.diagnosis import Advice
from mrd_diagnosis.experiment_design.experiment_library import RATE, library, sizes_of, sizes_of_bench, usual_bench
from mrd_diagnosis.experiment_design.information import expected_information
from mrd_diagnosis.experiment_design.separation import Pair, Predictor, Separation
from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.effect_names import effect_name, effect_names
from mrd_identification.parallel import in_threads
from mrd_runs.scales import scales_of
from mrd_sim.effects import EFFECTS, STAGES
from mrd_trajectory.experiment import format_experiment
from mrd_trajectory.plan import Plan
from mrd_trajectory.settings import GeneratorSettings

HIGHEST_RATE = 2000.0
"""Highest sample rate in Hz of an advised experiment."""

SENSORS: Mapping[tuple[str, ...], str] = {
    ("load_cell_gain", "load_cell_drift"): (
        "Before and after the runs, hang dead weights on the load cell, and tare it with the rod free."
    ),
    ("thermal_fade", "settling"): (
        "Record the damper's temperature too, and the same run with a cold damper, with a warm one and after a rest."
    ),
    ("temperature_dependence",): "Heat the damper from outside, and record the same run with it cold and hot.",
    ("backlash", "joint_play", "series_compliance"): "Add a second displacement sensor across the damper itself.",
    ("channel_delay", "force_sensor_lag"): (
        "Disconnect the drive, give the rod one sharp blow, and record position and force at 10 kHz or more, for example "
        "with an oscilloscope on the wires that enter the converter, behind all amplifiers and filters. A delay of the "
        "channel shifts the rise of the force and keeps its shape; a lag of the sensor lets it begin at once, but makes it "
        "slow."
    ),
    ("lvdt_nonlinearity", "servo_ripple"): "Compare the position sensor with the motor's encoder or with gauge blocks.",
    ("current_sensor_error",): "Record the sensors without current, and measure the current with a shunt beside its sensor.",
    ("mains_hum", "channel_crosstalk"): (
        "Record with the load cell off the damper, at rest and while rod and current move."
    ),
}
"""Measurement advised besides the runs, by effect; the first entry that applies counts."""

SENSORS_OF_STAGE = {
    "drive": "Add a displacement sensor on the rod, besides the one on the drive.",
    "magnetics": "Add a search coil or a Hall sensor at the piston, which shows the flux.",
    "fluid": "Record the damper's temperature and its gas pressure too.",
    "structure": "Add a load cell at the other end of the damper.",
    "sensing": "Check the load cell and its amplifier with known forces.",
}
"""Measurement advised for any other effect, by its stage."""


def advise(
    explanations: Mapping[str, Refit],
    weighting: Weighting,
    rng: np.random.Generator | None = None,
    *,
    probabilities: Mapping[str, float] | None = None,
    without: Refit | None = None,
    bench: GeneratorSettings | None = None,
    progress: Callable[[float], None] = ignore,
) -> Advice | None:
    """Advise which experiment, or else which sensor, tells explanations apart.

    Parameters
    ----------
    explanations : mapping
        Refits on the weighting by what they explain the gap by: an effect, another damper model, "" for no effect.
    weighting : Weighting
    rng : numpy Generator, optional
        Source of the errors that are drawn. Without one, the same errors are drawn each time.
    probabilities : mapping, optional
        Probability of each explanation; by default, all are as likely.
    without : Refit, optional
        The model without what the explanations explain the gap by. With it, an experiment must separate the explanations by
        more than the error of their formulas, see `mrd_diagnosis.fitting.statistics.certainty`.
    bench : GeneratorSettings, optional
        Limits that no experiment exceeds; by default, those of the shipped bench, enlarged or reduced to a damper of another
        size.
    progress : callable
        Called with the fraction of the work that is done.

    Returns
    -------
    Advice or None
        None for fewer than two explanations. An experiment is advised if it tells at least one pair apart with fewer wrong
        choices than `Thresholds.wrong_choices`: among these, the one that gives most information in a second of the bench's
        time. One that is recorded already is not advised again.
    """
    if len(explanations) < 2:
        return None
    sizes = sizes_of_bench(bench) if bench else sizes_of(scales_of([recording.run for recording in weighting.recordings]))
    rng, bench = rng or np.random.default_rng(0), bench or usual_bench(sizes)
    recorded = {recording.run.name for recording in weighting.recordings}
    fitting = library(bench, sizes)
    plans = [planned for planned in fitting if planned.experiment.name not in recorded]
    completed = itertools.count(1)
    predictor = Predictor.from_refits(explanations, weighting, rng, without)

    def separate(item: tuple[Plan, np.random.Generator]) -> dict[Pair, Separation] | None:
        separations = predictor.separations(item[0], bench.limits.force, item[1])
        progress(next(completed) / len(plans))
        return separations

    separations_of_plans = in_threads(separate, list(zip(plans, rng.spawn(len(plans)), strict=True)))
    safe = [(planned, of_plan) for planned, of_plan in zip(plans, separations_of_plans, strict=True) if of_plan is not None]
    if not safe:
        pair = next(itertools.combinations(explanations, 2))
        text = (
            f"No experiment that can be advised is safe: each would exceed {bench.limits.force:g} N or another limit."
            if plans or not fitting
            else "Every experiment that fits this bench is recorded already."
        )
        return Advice(f"{text} {_sensor_for(pair, predictor)}", between=pair)
    probabilities = probabilities or dict.fromkeys(explanations, 1.0)
    planned, separations = max(safe, key=lambda item: _merit(item[0], item[1], probabilities))
    open_pairs = [pair for pair, separation in separations.items() if not separation.is_conclusive]
    worst_pair = max(open_pairs, key=lambda pair: separations[pair].error_rate, default=None)
    if worst_pair and len(open_pairs) == len(separations):
        return _advise_sensor(planned, worst_pair, separations[worst_pair], predictor)
    advice = _advise_experiment(planned, separations, weighting)
    if worst_pair:
        said = set(worst_pair) <= set(advice.between)
        undecided = "" if said else f" It does not decide between {effect_names(worst_pair)}."
        return replace(advice, text=f"{advice.text}{undecided} {_sensor_for(worst_pair, predictor)}")
    return advice


def sensor(effects: Collection[str], other_effects: Collection[str]) -> str:
    """Return what to measure that tells explanations apart where no run does, given their effects."""
    differing = [effect for effect in EFFECTS if (effect in effects) != (effect in other_effects)]
    for shown, text in SENSORS.items():
        if any(effect in shown for effect in differing):
            return text
    if not differing:
        return "Diagnose the recordings with the other damper model as well: no effect is the difference."
    # The earliest stage between cause and reading decides.
    first = min((EFFECTS[effect] for effect in differing), key=lambda effect: STAGES.index(effect.stage))
    return f"{SENSORS_OF_STAGE[first.stage]} Another measurement for {effect_name(first.id)}: {first.separated_by}."


def _sensor_for(pair: Pair, predictor: Predictor) -> str:
    effects, other_effects = (predictor.explanations[name].effects for name in pair)
    return sensor(effects, other_effects)


def _advise_experiment(planned: Plan, separations: Mapping[Pair, Separation], weighting: Weighting) -> Advice:
    """Advise an experiment that tells at least one pair of explanations apart."""
    separated = {pair: separation for pair, separation in separations.items() if separation.is_conclusive}
    between = tuple(dict.fromkeys(name for pair in separations for name in pair if any(name in p for p in separated)))
    error_rate = max(separation.error_rate for separation in separated.values())
    experiment = replace(planned.experiment, rate=_rate(weighting))
    undecided = [pair for pair in separations if pair not in separated and set(pair) <= set(between)]
    but = "".join(f", but not between {effect_names(pair)}" for pair in undecided)
    text = (
        f"Record {experiment.name}: {experiment.description}. It decides between {effect_names(between)}{but}; "
        f"after it, such a choice would be wrong in {_percent(error_rate)} of all cases."
    )
    return Advice(text, format_experiment(experiment), between, error_rate)


def _advise_sensor(best: Plan, pair: Pair, separation: Separation, predictor: Predictor) -> Advice:
    """Advise a sensor for a pair of explanations that no run tells apart, not even the best one."""
    run = f"the best run that this bench can make ({best.experiment.name})"
    if separation.error_rate >= THRESHOLDS.wrong_choices:
        text = (
            f"After {run}, a choice between {effect_names(pair)} would still be wrong in {_percent(separation.error_rate)} "
            f"of all cases; {_percent(THRESHOLDS.wrong_choices)} is wanted. So use another measurement."
        )
    else:
        text = (
            f"Even in {run}, {effect_names(pair)} differ by less than the error of either formula. So use another "
            "measurement."
        )
    return Advice(f"{text} {_sensor_for(pair, predictor)}", between=pair)


def _merit(
    planned: Plan, separations: Mapping[Pair, Separation], probabilities: Mapping[str, float]
) -> tuple[bool, float, float]:
    """Return whether a run tells any explanations apart, its information per second, and, where that is nothing, its largest
    squared distance per second.
    """
    decides = any(separation.is_conclusive for separation in separations.values())
    farthest = max(separation.squared_distance for separation in separations.values())
    return decides, expected_information(probabilities, separations) / planned.duration, farthest / planned.duration


def _rate(weighting: Weighting) -> float:
    """Return the sample rate in Hz of the recordings, so that all runs can be compared, unless it is low."""
    fastest = max(recording.run.rate for recording in weighting.recordings)
    return float(f"{np.clip(fastest, RATE, HIGHEST_RATE):.3g}")


def _percent(error_rate: float) -> str:
    return f"{100 * error_rate:.2g} %" if error_rate > 1e-4 else "less than 0.01 %"
