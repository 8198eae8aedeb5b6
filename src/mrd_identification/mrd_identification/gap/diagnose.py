"""From recordings and a simulator to a diagnosis."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_identification.fit_file import StoredFit
from mrd_identification.gap.ceiling import explainable
from mrd_identification.gap.diagnosis import (
    Alternative,
    Candidate,
    Cause,
    Diagnosis,
    Interval,
    RunNoise,
    Trace,
    Verdict,
)
from mrd_identification.gap.ground import Ground, first_fit
from mrd_identification.gap.judge import closed, nrmse, probabilities, resampled, values
from mrd_identification.gap.noise import run_noise
from mrd_identification.gap.null import null_errors, null_gains, p_value
from mrd_identification.gap.preflight import preflight
from mrd_identification.gap.refit import Refit, Scatter, errors_of, own_error, refit, without_each
from mrd_identification.gap.where import where
from mrd_identification.gap.which import LEAST_GAIN, LEFT_OVER, Trial, search
from mrd_identification.gap.words import describe, human
from mrd_identification.polish import descend
from mrd_identification.problem import Recording, in_threads, pose, prepare
from mrd_runs import Run
from mrd_sim.effects import EFFECTS, find_effects
from mrd_sim.models import DamperModel, find_model

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

NO_GAP = 1.5
"""Mean squared error over the variance of noise up to which noise may be all there is: its estimate errs by so much."""

UNEXPLAINED = 0.3
"""Mean squared error beyond noise, over the variance of noise, that may be left of an explained gap."""

IMPRECISE = 0.03
"""Share of a gap that may be left of it too: an effect's form and the step of its integration are never quite right."""

MOST_PART = 0.5
"""Share of the explainable gap that causes must close to be named."""

CERTAIN = 0.8
"""Probability from which an effect is named without an alternative."""

WORTH_NAMING = 0.05
"""Probability from which a rival is told."""

MIMICRY = 0.9
"""Share of what the best effect closes from which another one is said to act alike on these runs."""

BEYOND = 1.15
"""A run goes beyond the others where its stroke, speed or current is larger than theirs by this factor."""

ALONE = 0.8
"""Share of what all runs say of an effect's parameter that makes one run the only one to say it."""

FIRST_SCATTER = Scatter(0.01, 2.0)
"""Of runs of the same bench, before anything is learned from them: relative, and in N."""


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
    blank = Diagnosis(
        base, "data_fault", "", _held_out_by(runs, held_out), seed, 0.0, findings, None, Interval(np.nan), Interval(np.nan),
        Interval(np.nan), Interval(np.nan), np.nan, None, (), (), (), None, (), (), None, {}, (), (),
    )
    if any(finding.severity == "fault" for finding in findings):
        return _said(replace(blank, elapsed=time.monotonic() - began))
    recordings = in_threads(prepare, [*runs, *held_out])
    fitted, unseen = recordings[: len(runs)], recordings[len(runs) :]

    progress("fitting the model", 0.05)
    own_lag = simulator is not None and simulator[base.names.index("coil_lag")] > 0.0
    fixed = {} if own_lag else {"coil_lag": 0.0}
    if own_lag:
        candidates = [effect for effect in candidates if effect != "coil_lag"]
    posed, notes = pose(base, fitted, fixed=fixed)
    theta = first_fit(posed, simulator, rng)
    noises = run_noise(fitted, base, theta, rng)
    reference = [recording.modelled(base, theta) for recording in fitted]
    ground = Ground(fitted, noises, FIRST_SCATTER, reference, fixed).after(errors_of(posed, theta))
    problem = ground.problem(base)
    noise = null_errors(problem, theta, [found.force for found in ground.noises], rng)
    alone = refit(problem, theta, ground.parts, noise)
    present = _testable(candidates, base, fitted)
    progress("trying effects", 0.15)
    chosen, trials = search(
        ground, alone, [effect for effect in candidates if effect not in present], noise,
        lambda share: progress("trying effects", 0.15 + 0.6 * share),
    )
    progress("judging", 0.75)
    singles = [trial for trial in trials if len(trial.effects) == 1]
    nulls = null_gains(alone, [trial.refit for trial in singles], rng) if singles else np.zeros(1)
    judged = _Judged.of(ground, alone, chosen, trials, rng)
    return _said(
        replace(
            _conclude(blank, judged, singles, nulls, present, simulator, unseen, rng, progress),
            elapsed=time.monotonic() - began,
            notes=tuple(notes),
        )
    )


def _said(diagnosis: Diagnosis) -> Diagnosis:
    return replace(diagnosis, sentence=describe(diagnosis))


def _held_out_by(runs: Sequence[Run], held_out: Sequence[Run]) -> str:
    return "runs" if held_out else "leave-one-run-out" if len(runs) > 1 else "blocks"


def _simulator(base: DamperModel, parameters: StoredFit | None) -> Array | None:
    if parameters is None:
        return None
    if parameters.model != base.id:
        raise InputError(f"--parameters: of the model {parameters.model}, expected {base.id}")
    return base.vector({name: value for name, value in parameters.values.items() if "." not in name})


def _testable(candidates: Sequence[str], base: DamperModel, recordings: Sequence[Recording]) -> dict[str, str]:
    """Candidates of which these recordings can say nothing whatever their size, and why."""
    found: dict[str, str] = {}
    rate = min(recording.run.rate for recording in recordings)
    still = all(np.ptp(recording.path.current) < 1e-3 for recording in recordings)
    for name in candidates:
        if EFFECTS[name].structural and base.states:
            found[name] = "the model has its own"
        if name == "mains_hum" and rate < 130.0:
            found[name] = f"at {rate:.0f} Hz the mains frequency cannot be seen"
        if still and name in ("coil_lag", "magnetic_hysteresis"):
            found[name] = "the current never changes within a run"
    return found


@dataclass(frozen=True)
class _Judged:
    """The refits between which is judged, on the noise floor of the best of them.

    Attributes
    ----------
    ground : Ground
    alone : Refit
        The model without effects.
    chain : list of Refit
        With one effect, two, ...
    effects : tuple of str
        Those of the chain, in its order.
    rivals : dict
        For each effect of the chain, refits in which another one, or none (""), takes its place.
    """

    ground: Ground
    alone: Refit
    chain: list[Refit]
    effects: tuple[str, ...]
    rivals: dict[str, dict[str, Refit]]

    @property
    def best(self) -> Refit:
        return self.chain[-1] if self.chain else self.alone

    @classmethod
    def of(
        cls, first: Ground, alone: Refit, chosen: Sequence[Trial], trials: Sequence[Trial], rng: np.random.Generator
    ) -> "_Judged":
        """Learn noise and scatter from the best model, and fit anew what may still be it."""
        best = chosen[-1].refit if chosen else alone
        scatter = learned_scatter(best)
        noises = run_noise(first.recordings, best.problem.model, best.theta, rng)
        # A run's own gain multiplies the force of the plain model still: else it would bring the effects in by itself.
        ground = replace(first, noises=noises, scatter=scatter).after(errors_of(best.problem, best.theta))

        def again(old: Refit) -> Refit:
            return refit(ground.problem(old.problem.model), old.theta, ground.parts)

        ranked = sorted(trials, key=lambda trial: trial.refit.total)
        effects = chosen[-1].effects if chosen else ()
        slots: dict[str, dict[str, Trial]] = {}
        for effect in effects:
            others = [other for other in effects if other != effect]
            replaced = [
                (next(iter(set(trial.effects) - set(others)), ""), trial)
                for trial in ranked
                if len(trial.effects) == len(effects) and set(others) <= set(trial.effects)
            ]
            slots[effect] = dict(replaced[:6])
        everything = {id(trial.refit): trial.refit for of in slots.values() for trial in of.values()}
        everything |= {id(trial.refit): trial.refit for trial in chosen} | {id(alone): alone}
        refits = dict(zip(everything, in_threads(again, list(everything.values())), strict=True))
        chain = [refits[id(trial.refit)] for trial in chosen]
        rivals: dict[str, dict[str, Refit]] = {}
        for effect, of in slots.items():
            rivals[effect] = {name: refits[id(trial.refit)] for name, trial in of.items()}
            if len(effects) == 1:
                rivals[effect][""] = refits[id(alone)]
        return cls(ground, refits[id(alone)], chain, effects, rivals)


def learned_scatter(fitted: Refit) -> Scatter:
    """Scatter of gain and offset of runs, by expectation-maximisation from what a refit leaves of each run."""
    problem = fitted.problem
    known = []
    for index, block in enumerate(problem.blocks):
        whitening = problem.whitenings[index]
        columns = np.stack([whitening.reference, np.ones_like(whitening.reference)], axis=1) * whitening.weight[:, None]
        error = (problem.modelled(fitted.theta, index) - problem.force[block]) * whitening.weight
        # A gap is no noise: what it leaves makes offset and gain of a run less certain.
        known.append((columns.T @ columns, columns.T @ error, max(1.0, float(np.mean(error**2)))))
    variance = np.array([FIRST_SCATTER.gain**2, FIRST_SCATTER.offset**2])
    for _ in range(50):
        moments = []
        for gram, right, level in known:
            covariance = np.linalg.inv(gram / level + np.diag(1 / variance))
            moments.append((covariance @ right / level) ** 2 + np.diag(covariance))
        variance = np.clip(np.mean(moments, axis=0), [1e-6, 1e-2], [0.04**2, 20.0**2])
    return Scatter(float(np.sqrt(variance[0])), float(np.sqrt(variance[1])))


def _conclude(
    blank: Diagnosis,
    judged: _Judged,
    singles: Sequence[Trial],
    nulls: Array,
    present: Mapping[str, str],
    simulator: Array | None,
    unseen: Sequence[Recording],
    rng: np.random.Generator,
    progress: Progress,
) -> Diagnosis:
    ground, samples = judged.ground, judged.ground.samples
    best = judged.best
    # --- how far
    noises = list(ground.noises)
    traces = _traces(judged)
    if unseen:
        held = run_noise(unseen, best.problem.model, best.theta, rng)
        traces += _held_out_traces(judged, unseen, held, ground.scatter)
    counted = [trace for trace in traces if trace.held_out] or traces
    before, after, floor, lengths, draws = _units(counted, rng)
    variance = float(np.var(np.concatenate([trace.recording.force for trace in counted])))
    gap = closed(before, after, floor, draws)
    # --- verdict
    shares = resampled(len(best.noises), rng)
    sizes = np.array([part.stop - part.start for _, part in ground.parts], dtype=float)
    allowed = UNEXPLAINED + IMPRECISE * (judged.alone.level - 1.0)
    least_left = float(np.quantile((shares @ best.noises) / (shares @ sizes), 0.1)) - 1.0
    part = _part_closed(judged.alone, best, judged, rng).value if judged.effects else 0.0
    chances = {
        effect: dict(zip(rivals, probabilities(list(rivals.values()), rng), strict=True))
        for effect, rivals in judged.rivals.items()
    }
    verdict: Verdict
    if judged.alone.level <= NO_GAP and part < MOST_PART:
        verdict = "no_gap"
    elif part < MOST_PART or (best.level - 1.0 > allowed and least_left > 0.7 * allowed):
        verdict = "unknown_effect"
    elif all(chances[effect][effect] >= CERTAIN for effect in judged.effects):
        verdict = "explained"
    else:
        verdict = "ambiguous"
    found = values(best) if judged.effects else {}
    listed = _candidates(judged, singles, nulls, chances, ground, rng)
    alone_p = {candidate.effects[0]: candidate.p_value for candidate in listed if len(candidate.effects) == 1}
    steps = [judged.alone, *judged.chain]
    causes = tuple(
        Cause(
            effect,
            float(chances[effect][effect]),
            alone_p[effect],
            _part_closed(steps[index], steps[index + 1], judged, rng),
            {name: value for name, value in found.items() if name.startswith(f"{effect}.")},
        )
        for index, effect in enumerate(judged.effects)
    )
    alternatives = tuple(
        Alternative(other, effect, float(chance), "predicts unseen parts as well as the cause does")
        for effect, of in chances.items()
        for other, chance in sorted(of.items(), key=lambda item: -item[1])
        if other not in ("", effect) and chance >= WORTH_NAMING
    )
    if verdict == "no_gap":
        judged = replace(judged, chain=[], effects=(), rivals={})
        best, causes, alternatives = judged.alone, (), ()
    progress("looking where the gap lies", 0.9)
    residuals = [trace.before for trace in counted]
    seen, of_noise = [trace.recording for trace in counted], [trace.noise for trace in counted]
    places = where(seen, of_noise, residuals, rng) if verdict != "no_gap" else ()
    ceiling = explainable(seen, residuals, [noise.sigma for noise in of_noise], rng) if verdict != "no_gap" else np.nan
    nearest = None
    if verdict == "unknown_effect":
        nearest = next((candidate for candidate in listed if candidate.effects == judged.effects), None)
    progress("done", 1.0)
    return replace(
        blank,
        verdict=verdict,
        unfitted=_unfitted(judged, simulator, variance),
        floor=nrmse(floor, lengths, variance, draws),
        before=nrmse(before, lengths, variance, draws),
        after=nrmse(after, lengths, variance, draws),
        closed=gap if judged.effects else Interval(np.nan),
        ceiling=float(ceiling),
        where=places,
        causes=causes if verdict in ("explained", "ambiguous") else (),
        alternatives=alternatives if verdict in ("explained", "ambiguous") else (),
        nearest=nearest,
        candidates=tuple(c for c in listed if not c.remark.startswith("cannot")),
        untestable=tuple(
            [c for c in listed if c.remark.startswith("cannot")]
            + [Candidate((name,), np.nan, Interval(np.nan), np.nan, 0.0, {}, remark=why) for name, why in present.items()]
        ),
        parameters=dict(zip(best.problem.model.names, map(float, best.theta), strict=True)),
        effects=tuple(effect.id for effect in best.problem.model.effects),
        traces=tuple(traces),
    )


def _candidates(
    judged: _Judged,
    singles: Sequence[Trial],
    nulls: Array,
    chances: Mapping[str, Mapping[str, float]],
    ground: Ground,
    rng: np.random.Generator,
) -> list[Candidate]:
    """Every effect that was tried, alone, and the chosen ones together; best first."""
    first = next(iter(judged.effects), None)
    energy = np.array([float(np.sum(ground.noises[run].sigma ** 2)) for run in range(len(ground.recordings))]).sum()
    variance = float(np.var(np.concatenate([recording.force for recording in ground.recordings])))
    samples = ground.samples
    ranked = sorted(singles, key=lambda trial: trial.refit.total)
    needed = max(LEAST_GAIN * samples, float(np.quantile(nulls, 0.95)))
    found = []
    lead = ranked[0].refit if ranked else None
    without = judged.alone.plain.sum()
    for trial in ranked:
        effect = find_effects(trial.effects)[0]
        seen = judged.rivals.get(first or "", {}).get(effect.id) if len(judged.effects) == 1 else None
        shown = seen or trial.refit
        gain = trial.gain
        remark, smallest = "", ""
        size = effect.parameters[0]
        if trial.score.strength > 0:
            least = abs(effect.typical[size.name]) * np.sqrt(needed / trial.score.strength)
            smallest = human(float(least), size.unit)
            if least > max(abs(size.lower), abs(size.upper)):
                remark = "cannot be tested: even the largest plausible size would not show"
        if trial.score.left_over < LEFT_OVER and gain < needed:
            remark = "cannot be tested: the model's own parameters take it up"
        alike: tuple[str, ...] = ()
        if lead is not None and ranked[0].effects != trial.effects:
            whole = ranked[0].unseen_gain
            if whole > needed and trial.unseen_gain >= MIMICRY * whole:
                alike = ranked[0].effects
        found.append(
            Candidate(
                trial.effects,
                float(np.sqrt(shown.plain.sum() / samples / variance)),
                Interval(float(np.clip((without - shown.plain.sum()) / max(without - energy, 1e-9), -1.0, 1.0)))
                if without > energy else Interval(np.nan),
                p_value(gain, nulls),
                float(chances.get(effect.id, {}).get(effect.id, chances.get(first or "", {}).get(effect.id, 0.0))),
                values(shown),
                alike,
                remark,
                smallest,
            )
        )
    if len(judged.effects) > 1:
        best = judged.best
        found.insert(
            0,
            Candidate(
                judged.effects,
                float(np.sqrt(best.plain.sum() / samples / variance)),
                _part_closed(judged.alone, best, judged, rng),
                min(candidate.p_value for candidate in found if candidate.effects[0] in judged.effects),
                float(np.prod([chances[effect][effect] for effect in judged.effects])),
                values(best),
            ),
        )
    return found




def _part_closed(before: Refit, after: Refit, judged: _Judged, rng: np.random.Generator) -> Interval:
    """Share of the explainable gap that lies between two refits, on parts held out in turn."""
    floor = np.concatenate([noise.sigma for noise in judged.ground.noises]) ** 2
    of_parts = np.array([floor[part].sum() for _, part in judged.ground.parts])
    gap = judged.alone.plain - of_parts
    draws = resampled(len(gap), rng)
    gained = before.plain - after.plain
    if gap.sum() <= 0:
        return Interval(np.nan)
    shares = (draws @ gained) / np.where(draws @ gap > 0, draws @ gap, np.nan)
    ends = np.nanquantile(np.clip(shares, -1.0, 1.0), (0.025, 0.975)) if np.isfinite(shares).any() else (np.nan, np.nan)
    return Interval(float(np.clip(gained.sum() / gap.sum(), -1.0, 1.0)), *map(float, ends))


def _extrapolations(recordings: Sequence[Recording]) -> list[str]:
    """In which respect each run goes beyond all others; empty where it does not."""
    reach = {
        "stroke": [float(np.ptp(recording.path.position)) for recording in recordings],
        "speed": [float(np.quantile(np.abs(recording.path.velocity), 0.995)) for recording in recordings],
        "current": [float(np.quantile(np.abs(recording.path.current), 0.995)) for recording in recordings],
    }
    found = []
    for index in range(len(recordings)):
        others = {name: max((v for i, v in enumerate(of) if i != index), default=0.0) for name, of in reach.items()}
        least = {"stroke": 1e-4, "speed": 1e-3, "current": 0.02}
        beyond = [name for name, of in reach.items() if of[index] > BEYOND * others[name] + least[name]]
        found.append(" and ".join(beyond) if len(recordings) > 1 else "")
    return found


def _of_runs(fitted: Refit, judged: _Judged) -> Array:
    """Parameters (runs, parameters) that have not seen the run: a step from the joint optimum, then fitted to the others."""
    problem = fitted.problem
    places = np.array([run for run, _ in judged.ground.parts])
    runs = range(len(judged.ground.recordings))
    grams = np.stack([fitted.grams[places == run].sum(axis=0) for run in runs])
    slopes = np.stack([fitted.slopes[places == run].sum(axis=0) for run in runs])
    starts = without_each(problem, problem.unit(fitted.theta), grams, slopes)

    def of(run: int) -> Array:
        silent = problem.whitenings[run].silent()
        others = replace(problem, whitenings=(*problem.whitenings[:run], silent, *problem.whitenings[run + 1 :]))
        unit, _ = descend(others, problem.unit(starts[run]), np.arange(len(problem.free)), 10, 1e-4, renewal=4)
        return problem.theta(unit)

    return np.stack(in_threads(of, list(runs)))


def _unseen_residuals(fitted: Refit, judged: _Judged, beyond: Sequence[str]) -> list[Array]:
    """Measured minus modelled force of each run, which was left out, or of its parts where no other run reaches as far."""
    by_run = _of_runs(fitted, judged) if len(judged.ground.recordings) > 1 else None
    thetas = fitted.problem.theta(fitted.problem.unit(fitted.theta))
    parts = without_each(fitted.problem, fitted.problem.unit(thetas), fitted.grams, fitted.slopes)
    found = []
    for run, block in enumerate(fitted.problem.blocks):
        if by_run is not None and not beyond[run]:
            found.append(-own_error(fitted.problem, by_run[run], run)[1])
            continue
        residual = np.empty(block.stop - block.start)
        for (place, part), theta in zip(judged.ground.parts, parts, strict=True):
            if place == run:
                here = slice(part.start - block.start, part.stop - block.start)
                residual[here] = -own_error(fitted.problem, theta, run)[1][here]
        found.append(residual)
    return found


def _alone_in(judged: _Judged) -> set[int]:
    """Runs that are (nearly) the only ones to say how large an effect is."""
    problem = judged.best.problem
    of_effects = [i for i, parameter in enumerate(problem.parameters) if "." in parameter.name]
    places = np.array([run for run, _ in judged.ground.parts])
    told = np.stack([np.diagonal(gram)[of_effects] for gram in judged.best.grams])
    by_run = np.stack([told[places == run].sum(axis=0) for run in range(len(judged.ground.recordings))])
    shares = by_run / np.maximum(by_run.sum(axis=0), 1e-300)
    return set(map(int, np.flatnonzero((shares > ALONE).any(axis=1))))


def _traces(judged: _Judged) -> list[Trace]:
    beyond = _extrapolations(judged.ground.recordings)
    for run in _alone_in(judged):
        beyond[run] = beyond[run] or "what the effect needs to show"
    before = _unseen_residuals(judged.alone, judged, beyond)
    after = _unseen_residuals(judged.best, judged, beyond) if judged.effects else before
    own = [_own(judged.best, run) for run in range(len(beyond))]
    return [
        Trace(recording, noise, b, a, offset, gain, extrapolates=where_to)
        for recording, noise, b, a, (gain, offset), where_to in zip(
            judged.ground.recordings, judged.ground.noises, before, after, own, beyond, strict=True
        )
    ]


def _own(fitted: Refit, run: int) -> tuple[float, float]:
    """Gain and offset (N) of a run, measured against modelled."""
    error = fitted.problem.modelled(fitted.theta, run) - fitted.problem.recordings[run].force
    gain, offset = fitted.problem.whitenings[run].own @ error
    return -float(gain), -float(offset)


def _held_out_traces(
    judged: _Judged, unseen: Sequence[Recording], noises: Sequence[RunNoise], scatter: Scatter
) -> list[Trace]:
    """Runs that were set aside, with the parameters of all others."""
    alone, best = judged.alone, judged.best
    reference = [recording.modelled(alone.problem.model, alone.theta) for recording in unseen]
    ground = Ground(unseen, noises, scatter, reference, judged.ground.fixed)
    both = [(ground.problem(fitted.problem.model), fitted.theta) for fitted in (alone, best)]
    beyond = _extrapolations([*judged.ground.recordings, *unseen])[len(judged.ground.recordings) :]
    found = []
    for run, recording in enumerate(unseen):
        before, after = (-own_error(problem, theta, run)[1] for problem, theta in both)
        problem, theta = both[1]
        gain, offset = problem.whitenings[run].own @ (problem.modelled(theta, run) - recording.force)
        found.append(Trace(recording, noises[run], before, after, -float(offset), -float(gain), True, beyond[run]))
    return found


def _units(traces: Sequence[Trace], rng: np.random.Generator) -> tuple[Array, Array, Array, Array, Array]:
    """Squared errors in N² before, after and of the floor, samples, and bootstrap draws, by what scatters independently.

    These are runs; of fewer than four, stretches of theirs.
    """
    pieces = 1 if len(traces) >= 4 else -(-8 // len(traces))

    def cut(series: Array) -> list[Array]:
        return np.array_split(series, pieces)

    before = np.array([float(p @ p) for trace in traces for p in cut(trace.before)])
    after = np.array([float(p @ p) for trace in traces for p in cut(trace.after)])
    floor = np.array([float(p @ p) for trace in traces for p in cut(trace.noise.sigma)])
    samples = np.array([float(len(p)) for trace in traces for p in cut(trace.before)])
    return before, after, floor, samples, resampled(len(samples), rng)


def _unfitted(judged: _Judged, simulator: Array | None, variance: float) -> float | None:
    """NRMSE of the simulator as it was handed in."""
    if simulator is None:
        return None
    error = judged.alone.problem.errors(simulator)
    return float(np.sqrt(np.mean(error**2) / variance))
