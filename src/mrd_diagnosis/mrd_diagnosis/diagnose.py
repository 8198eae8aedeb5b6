"""From recordings and a simulator to a diagnosis."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.alternative_models import forms
from mrd_diagnosis.closure import closed_between, how_far
from mrd_diagnosis.detectability import coverage
from mrd_diagnosis.diagnosis import Advice, Alternative, Candidate, Cause, Diagnosis, Interval, Verdict
from mrd_diagnosis.effect_search import LEAST_GAIN, NO_GAP, Foundation, Trial, may_be_left, search, showing
from mrd_diagnosis.experiment_design.separation import advise
from mrd_diagnosis.flexible_remainder import explainable
from mrd_diagnosis.localisation import where
from mrd_diagnosis.model_comparison import FIRST_SCATTER, Contest, contest
from mrd_diagnosis.noise_model import distortion, repeating_period, run_noise
from mrd_diagnosis.null_distribution import null_errors, null_gains, p_value
from mrd_diagnosis.preflight import preflight
from mrd_diagnosis.preflight.excitation import one_speed
from mrd_diagnosis.refit import Refit, own_error, refit
from mrd_diagnosis.report.sentences import describe, human
from mrd_diagnosis.statistics import CERTAIN, probabilities, resampled, values
from mrd_diagnosis.weighting import Ground, first_fit
from mrd_identification.fit_file import StoredFit
from mrd_identification.parallel import in_threads
from mrd_identification.problem import make_problem
from mrd_identification.recording import Recording, current_levels, prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import DamperModel, find_model

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

BARELY = 1.1
"""Mean squared error over the variance of noise, as the model alone leaves it, up to which nothing more is asked: an effect
that smooths the measured current makes even noise smaller."""

MOST_PART = 0.75
"""Share of the explainable gap that causes must close to be named."""

MORE_THAN_HALF, LITTLE = 0.5, 0.2
"""The same where less than ``LITTLE`` is left beyond noise, over its variance: its estimate may be off by that."""

WORTH_NAMING = 0.05
"""Probability from which a rival is told."""

SIGNIFICANT = 0.05
"""Probability of so large an improvement in noise alone below which an effect may be named."""

MIMICRY = 0.9
"""Share of what the best effect closes from which another one is said to act alike on these runs."""

MOST_ADVISED = 4
"""Explanations that the next experiment is to separate."""


def no_progress(_stage: str, _fraction: float) -> None:
    """Tell nobody."""


def diagnose(
    runs: Sequence[Run],
    model: str,
    *,
    held_out: Sequence[Run] = (),
    parameters: StoredFit | None = None,
    laws: str | Mapping[str, str] | None = None,
    effects: Sequence[str] = (),
    seed: int = 0,
    progress: Progress = no_progress,
) -> Diagnosis:
    """Explain the gap between a simulator and recordings.

    Parameters
    ----------
    runs : sequence of Run
        In the order in which they were recorded.
    model : str
        Id of the damper model that the simulator has.
    held_out : sequence of Run
        Judge how far the gap closes; without them, each of the runs is left out in turn.
    parameters : StoredFit, optional
        Of the simulator as it is (`mrd_identification.read_fit`). Without them, the model is fitted first.
    laws : str or mapping, optional
        Current laws; see `mrd_sim.models.DamperModel.with_laws`.
    effects : sequence of str
        Ids of the candidates; the whole catalogue when empty.
    seed : int
        The same seed and input give the same answer.
    progress : callable
        Called with what is being worked on and the share that is done; what it raises ends the work.

    Raises
    ------
    InputError
        For an unknown model, law or effect, parameters out of their bounds, or no runs.
    """
    began = time.monotonic()
    rng = np.random.default_rng(seed)
    if not runs:
        raise InputError("no runs to diagnose")
    candidates = [effect.id for effect in find_effects(list(effects) or list(EFFECTS))]
    base = find_model(model, laws if laws is not None else (parameters.laws if parameters else None))
    simulator = _simulator(base, parameters)
    progress("looking at the recordings", 0.0)
    findings = preflight([*runs, *held_out], base)
    nothing = Interval(np.nan)
    diagnosis = Diagnosis(
        model=base,
        verdict="data_fault",
        sentence="",
        held_out_by="runs" if held_out else "leave-one-run-out" if len(runs) > 1 else "blocks",
        seed=seed,
        elapsed=0.0,
        findings=findings,
        unfitted=None,
        floor=nothing,
        before=nothing,
        after=nothing,
        closed=nothing,
        ceiling=np.nan,
        extrapolated=None,
        where=(),
        causes=(),
        alternatives=(),
        nearest=None,
        candidates=(),
        untestable=(),
        advice=None,
        runs=tuple(runs),
        held_out=tuple(held_out),
        parameters={},
        effects=(),
        traces=(),
    )
    if not any(finding.severity == "fault" for finding in findings):
        recordings = in_threads(prepare_recording, [*runs, *held_out])
        asked = _Asked(base, simulator, candidates, recordings[: len(runs)], recordings[len(runs) :])
        diagnosis = _explain(diagnosis, asked, rng, progress)
    progress("done", 1.0)
    return replace(diagnosis, sentence=describe(diagnosis), elapsed=time.monotonic() - began)


@dataclass(frozen=True)
class _Asked:
    """What is to be explained: recordings by a model with some of the candidates."""

    base: DamperModel
    simulator: Array | None
    candidates: Sequence[str]
    recordings: Sequence[Recording]
    held_out: Sequence[Recording]


def _simulator(base: DamperModel, parameters: StoredFit | None) -> Array | None:
    if parameters is None:
        return None
    if parameters.model != base.id:
        raise InputError(f"--parameters: of the model {parameters.model}, expected {base.id}")
    if parameters.effects:
        raise InputError(
            f"--parameters: has the effects {', '.join(parameters.effects)} around the model, expected none; "
            "fit the model alone"
        )
    if dict(parameters.laws) != {name: law for name, law in base.laws.items() if name in parameters.laws}:
        raise InputError(
            f"--parameters: has the current laws {dict(parameters.laws)}, expected those of the model: {dict(base.laws)}"
        )
    return base.vector({name: value for name, value in parameters.values.items() if "." not in name})


def _explain(diagnosis: Diagnosis, asked: _Asked, rng: np.random.Generator, progress: Progress) -> Diagnosis:
    progress("fitting the model", 0.05)
    ground, alone, noise, notes = model_alone(asked.base, asked.simulator, asked.recordings, rng)
    silent = _silent(asked)
    progress("trying effects", 0.15)
    chosen, trials = search(
        ground,
        alone,
        [effect for effect in asked.candidates if effect not in silent],
        noise,
        lambda share: progress("trying effects", 0.15 + 0.6 * share),
    )
    progress("judging", 0.75)
    singles = [trial for trial in trials if len(trial.effects) == 1]
    nulls = null_gains(alone, [trial.refit for trial in singles], rng) if singles else np.zeros(1)
    found = contest(ground, alone, chosen, trials, rng)
    tried: dict[str, Refit] = {}
    if found.effects and one_speed([recording.run for recording in asked.recordings]):
        # At one speed, what another form of the model would do, an effect may do as well.
        progress("trying other forms of the model", 0.77)
        tried = forms(found.ground, found.alone, found.best.level - 1.0, rng)
        found = found.against(tried)
    # What is left beyond what may be left is something else.
    known = min(1.0, may_be_left(found.alone) / max(found.best.level - 1.0, 1e-9))
    chances = {
        effect: dict(zip(rivals, known * probabilities(list(rivals.values()), rng), strict=True))
        for effect, rivals in found.rivals.items()
    }
    by_chance = {trial.effects[-1]: p_value(trial.gain, nulls) for trial in chosen}
    p_values = [by_chance[effect] for effect in found.effects]
    verdict = _verdict(found, alone.level, chances, p_values, rng)
    if verdict == "no_gap":
        found, chances = replace(found, chain=(), effects=(), rivals={}), {}
    listed = _candidates(found, singles, nulls, chances, rng)
    # With something unknown beside it, only what the model lacks by construction is a cause.
    believed = list(takewhile(lambda name: EFFECTS[name].structural or verdict != "unknown_effect", found.effects))
    causes = _causes(found, believed, p_values, chances, rng)
    best = found.best

    progress("judging how far the gap closes", 0.85)
    far = how_far(found, asked.held_out, rng)
    diagnosis = replace(
        diagnosis,
        verdict=verdict,
        unfitted=_unfitted(asked, ground),
        floor=far.floor,
        before=far.before,
        after=far.after,
        closed=far.closed,
        extrapolated=far.extrapolated,
        traces=far.traces,
        candidates=tuple(candidate for candidate in listed if not candidate.remark.startswith(_UNTESTABLE)),
        untestable=tuple(
            [candidate for candidate in listed if candidate.remark.startswith(_UNTESTABLE)]
            + [Candidate((name,), np.nan, Interval(np.nan), np.nan, 0.0, {}, remark=why) for name, why in silent.items()]
        ),
        parameters=dict(zip(best.problem.model.names, map(float, best.theta), strict=True)),
        effects=tuple(effect.id for effect in best.problem.model.effects),
        notes=(*notes, *_notes(asked, ground)),
    )
    if verdict == "no_gap":
        return diagnosis

    progress("looking where the gap lies", 0.9)
    recordings, noises = [t.recording for t in far.counted], [t.noise for t in far.counted]
    residuals = [trace.before for trace in far.counted]
    diagnosis = replace(
        diagnosis,
        where=where(recordings, noises, residuals, rng),
        ceiling=explainable(recordings, residuals, [of_run.sigma for of_run in noises], rng),
    )
    if verdict == "unknown_effect":
        progress("trying other forms of the model", 0.93)
        nearest = next((candidate for candidate in diagnosis.candidates if candidate.effects == found.effects), None)
        if nearest is None and diagnosis.candidates and diagnosis.candidates[0].closed.value > 0.0:
            nearest = diagnosis.candidates[0]
        tried = tried or forms(found.ground, found.alone, may_be_left(found.alone), rng)
        return replace(diagnosis, causes=causes, nearest=nearest, forms=_forms(found, tried, rng))
    progress("looking for the next experiment", 0.95)
    return replace(diagnosis, causes=causes, alternatives=_alternatives(chances), advice=_advice(found, chances))


def model_alone(
    base: DamperModel, simulator: Array | None, recordings: Sequence[Recording], rng: np.random.Generator
) -> tuple[Ground, Refit, list[Array], list[str]]:
    """What effects are compared with.

    Parameters
    ----------
    base : DamperModel
    simulator : ndarray (parameters,) or None
        From where to fit it.
    recordings : sequence of Recording
    rng : numpy Generator

    Returns
    -------
    ground : Ground
        On which effects are tried.
    alone : Refit
        The model without effects.
    noise : list of ndarray
        How it errs by noise alone, see `mrd_diagnosis.null_distribution.null_errors`.
    notes : list of str
        What limits the fit.
    """
    # Lag behind the current is a candidate, unless the simulator has it already.
    fixed = {} if simulator is not None and simulator[base.names.index("coil_lag")] > 0.0 else {"coil_lag": 0.0}
    posed, notes = make_problem(base, recordings, fixed=fixed)
    theta = first_fit(posed, simulator, rng)
    ground = Ground(recordings, run_noise(recordings, base, theta, rng), FIRST_SCATTER, fixed).after(base, theta)
    problem = ground.problem(base, theta)
    noise = null_errors(problem, theta, [found.force for found in ground.noises], ground.scatter, rng)
    return ground, refit(problem, theta, ground.parts, noise), noise, notes


def _silent(asked: _Asked) -> dict[str, str]:
    """Candidates of which these recordings can say nothing whatever their size, and why."""
    found: dict[str, str] = {}
    base = asked.base
    rate = min(recording.run.rate for recording in asked.recordings)
    levels, varies = current_levels([recording.run for recording in asked.recordings])
    for name in asked.candidates:
        if EFFECTS[name].structural and base.states:
            found[name] = "the model has its own"
        if name == "coil_lag" and asked.simulator is not None and asked.simulator[base.names.index(name)] > 0.0:
            found[name] = "the simulator has it already"
        if name == "mains_hum" and rate < 130.0:
            found[name] = f"at {rate:.0f} Hz the mains frequency cannot be seen"
        if not varies and name in ("coil_lag", "magnetic_hysteresis"):
            found[name] = "the current never changes within a run"
        if levels == 1 and name in ("current_saturation", "current_sensor_error"):
            found[name] = "all runs have the same current"
    return found


def _notes(asked: _Asked, ground: Ground) -> list[str]:
    found = []
    if len(asked.recordings) == 1:
        found.append("one run only: its parts take the place of runs, which is weaker, and scatter between runs is unknown")
    if {noise.source for noise in ground.noises} == {"residual"}:
        found.append("nothing repeats: the force's noise is taken from the high frequencies of what the model leaves")
    rate = min(recording.run.rate for recording in asked.recordings)
    if rate < 100.0:
        found.append(
            f"at {rate:.0f} Hz, what takes less than about {1000 / rate:.0f} ms, or less travel than the rod's in a sample, "
            "is not seen: not found is not absent"
        )
    return [*found, *filter(None, (_distorted(recording) for recording in asked.recordings))]


def _distorted(recording: Recording) -> str:
    """What an odd multisine at constant current says of noise and distortion; empty for other runs."""
    run = recording.run
    period = None if current_levels([run])[1] else repeating_period(recording.smoothed)
    try:
        levels = distortion(run, period) if period else None
    except InputError:  # periodic, but no odd multisine
        levels = None
    if levels is None:
        return ""
    return (
        f"run {run.name}, an odd multisine: {levels.noise:.1f} N rms of its force differ from period to period, "
        f"{levels.even:.1f} N lie at even lines (asymmetry), {levels.odd:.1f} N at odd lines that are not excited ("
        "friction, hysteresis)"
    )


def _verdict(
    found: Contest,
    level: float,
    chances: Mapping[str, Mapping[str, float]],
    p_values: Sequence[float],
    rng: np.random.Generator,
) -> Verdict:
    """Given also the ``level`` of the model alone, by the noise that was known of then."""
    best, alone = found.best, found.alone
    part = closed_between(alone, best, found, rng) if found.effects else Interval(0.0, 0.0, 0.0)
    # A gap so small that the estimate of the noise may be what is wrong is one only if an effect surely closes most of it.
    sure = part.lower >= MOST_PART and p_values[0] <= SIGNIFICANT
    if level <= BARELY or (alone.level <= NO_GAP and not sure):
        return "no_gap"
    closed = part.value
    draws = resampled(len(best.noises), rng)
    samples = np.array([part.stop - part.start for _, part in found.ground.parts], dtype=float)
    left = best.level - 1.0
    surely_left = float(np.quantile((draws @ best.noises) / (draws @ samples), 0.1)) - 1.0
    allowed = may_be_left(alone)
    if not closed >= (MOST_PART if left > LITTLE else MORE_THAN_HALF) or (left > allowed and surely_left > 0.7 * allowed):
        return "unknown_effect"
    if found.form and any(of.get(found.form, 0.0) > of[effect] for effect, of in chances.items()):
        return "unknown_effect"
    return "explained" if all(chances[effect][effect] >= CERTAIN for effect in found.effects) else "ambiguous"


def _causes(
    found: Contest,
    effects: Sequence[str],
    p_values: Sequence[float],
    chances: Mapping[str, Mapping[str, float]],
    rng: np.random.Generator,
) -> tuple[Cause, ...]:
    """The first effects that were found, each with what it adds to those before it; first what is likely to close most.

    Their sizes are those without the effects that were found after them.
    """
    steps = [found.alone, *found.chain]
    parameters = values(steps[len(effects)])
    causes = [
        Cause(
            effect,
            float(chances[effect][effect]),
            p_values[index],
            closed_between(steps[index], steps[index + 1], found, rng),
            {name: value for name, value in parameters.items() if name.startswith(f"{effect}.")},
        )
        for index, effect in enumerate(effects)
    ]
    return tuple(sorted(causes, key=lambda cause: -cause.probability * float(np.nan_to_num(cause.closed.value))))


def _alternatives(chances: Mapping[str, Mapping[str, float]]) -> tuple[Alternative, ...]:
    return tuple(
        Alternative(other, effect, float(chance), "predicts what was not fitted nearly as well")
        for effect, of in chances.items()
        for other, chance in sorted(of.items(), key=lambda item: -item[1])
        if other not in ("", effect) and chance >= WORTH_NAMING
    )


def _advice(found: Contest, chances: Mapping[str, Mapping[str, float]]) -> Advice | None:
    """What to record so that the least certain cause is told from its rivals."""
    open_ones = [effect for effect in found.effects if chances[effect][effect] < CERTAIN]
    if not open_ones:
        return None
    effect = min(open_ones, key=lambda name: chances[name][name])
    ranked = sorted((name for name in chances[effect] if name), key=lambda name: -chances[effect][name])[:MOST_ADVISED]
    # A run that tells apart what is out of the question anyway leaves the question open.
    names = [name for name in ranked if name in ranked[:2] or chances[effect][name] >= WORTH_NAMING]
    if len(names) < 2:
        names.append("")
    rivals = found.rivals[effect]
    return advise({name: rivals[name] for name in names}, found.ground, without=rivals[""])


def _forms(found: Contest, tried: Mapping[str, Refit], rng: np.random.Generator) -> tuple[Candidate, ...]:
    """Other forms of the damper model, best first."""
    variance = _variance(found.ground)
    ranked = sorted(tried.items(), key=lambda item: item[1].total)
    return tuple(
        Candidate((name,), _nrmse(fitted, variance), closed_between(found.alone, fitted, found, rng), np.nan, np.nan, {})
        for name, fitted in ranked
    )


_UNTESTABLE = "cannot be tested"


def _candidates(
    found: Contest,
    singles: Sequence[Trial],
    nulls: Array,
    chances: Mapping[str, Mapping[str, float]],
    rng: np.random.Generator,
) -> list[Candidate]:
    """Every effect that was tried, alone, and the chosen ones together; best first."""
    ground, variance = found.ground, _variance(found.ground)
    ranked = sorted(singles, key=lambda trial: trial.refit.total)
    needed = max(LEAST_GAIN * ground.samples, float(np.quantile(nulls, 0.95)))
    lead_gain = ranked[0].unseen_gain if ranked else 0.0
    listed = []
    lead = chances[found.effects[0]] if len(found.effects) == 1 else {}
    rivals = found.rivals[found.effects[0]] if len(found.effects) == 1 else {}
    others = [trial.effects[0] for trial in ranked if trial.effects[0] not in found.effects]
    energy = showing(ground, found.alone, found.best)
    told = {of.effect: of for of in coverage(ground, Foundation.of(ground, found.best), others, energy)}
    refits = [rivals.get(trial.effects[0], trial.refit) for trial in ranked]
    for trial, shown, sizes in zip(ranked, refits, in_threads(values, refits), strict=True):
        name = trial.effects[0]
        remark, smallest = "", ""
        if name in told:
            if np.isfinite(told[name].smallest):
                smallest = human(told[name].smallest, EFFECTS[name].parameters[0].unit)
            elif trial.gain < needed:
                remark = f"{_UNTESTABLE}: {told[name].remark}"
        alike = trial is not ranked[0] and lead_gain > needed and trial.unseen_gain >= MIMICRY * lead_gain
        listed.append(
            Candidate(
                trial.effects,
                _nrmse(shown, variance),
                closed_between(found.alone, shown, found, rng),
                p_value(trial.gain, nulls),
                float(chances[name][name] if name in chances else lead.get(name, 0.0)),
                sizes,
                ranked[0].effects if alike else (),
                remark,
                smallest,
            )
        )
    if len(found.effects) > 1:
        together = Candidate(
            found.effects,
            _nrmse(found.best, variance),
            closed_between(found.alone, found.best, found, rng),
            min(candidate.p_value for candidate in listed if candidate.effects[0] in found.effects),
            float(np.prod([chances[effect][effect] for effect in found.effects])),
            values(found.best),
        )
        listed.insert(0, together)
    return listed


def _variance(ground: Ground) -> float:
    return float(np.var(np.concatenate([recording.force for recording in ground.recordings])))


def _nrmse(fitted: Refit, variance: float) -> float:
    return float(np.sqrt(fitted.plain.sum() / len(fitted.problem.force) / variance))


def _unfitted(asked: _Asked, ground: Ground) -> float | None:
    """NRMSE of the simulator as it was handed in, each run's own offset and gain taken out."""
    if asked.simulator is None:
        return None
    problem = ground.problem(asked.base, asked.simulator)
    errors = [own_error(problem, asked.simulator, run)[1] for run in range(len(ground.recordings))]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2) / np.var(problem.force)))
