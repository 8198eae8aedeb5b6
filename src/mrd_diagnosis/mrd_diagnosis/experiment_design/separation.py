"""What to record next, so that explanations that the recordings leave open are told apart.

For each experiment of a library and each two explanations: how far the force that one predicts stays apart from whatever the
other can predict once it is fitted to everything recorded so far and to that prediction (T-optimality: Hunter & Reiner 1965;
Atkinson & Fedorov 1975).
"""

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtr

from mrd_diagnosis.diagnosis import Advice
from mrd_diagnosis.experiment_design.candidates import RATE, library
from mrd_diagnosis.refit import GapProblem, Refit, Scatter, whitening
from mrd_diagnosis.report.sentences import name_of
from mrd_diagnosis.statistics import CERTAIN, certainty, dispersion
from mrd_diagnosis.weighting import Ground
from mrd_identification.least_squares import levenberg_marquardt
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording
from mrd_runs import Run
from mrd_runs.signals.motion import motion_errors
from mrd_runs.signals.smoothed_run import exact_run
from mrd_sim.effects import EFFECTS, STAGES
from mrd_sim.models import SeriesSolutions
from mrd_sim.path import Path, make_path
from mrd_trajectory.experiment import format_experiment
from mrd_trajectory.plan import Plan
from mrd_trajectory.settings import GeneratorSettings, read_settings

Array = NDArray[np.float64]
Pair = tuple[str, str]

ALLOWED_ERROR = 0.05
"""Share of wrong choices between two explanations that an experiment may leave, to be worth its time."""

EVALUATIONS = 3
"""Of a rival along each experiment: it starts near its optimum, and what it cannot learn in two steps is a difference."""

DRAWS, AROUND = 4, 15
"""Runs with drawn errors from which their variance is learned, over so many samples around each one."""

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
    ground: Ground,
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
        Refits on the ground by what they explain the gap by: an effect's id, another form, "" for the model alone.
    ground : Ground
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
        choices than `ALLOWED_ERROR`: the one that does so for most pairs, and among those the one that separates them best.
    """
    if len(rivals) < 2:
        return None
    rng = rng or np.random.default_rng(0)
    plans, done = library(bench), itertools.count(1)
    foreseen = Foreseen.of(rivals, ground, rng, without)

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
            if errors[left] >= ALLOWED_ERROR
            else "they differ by less than either may err in its form"
        )
        return Advice(f"No run of the library would tell {_listed(left)} apart ({why}); {remedy}.", between=left)
    between = tuple(name for name in rivals if any(name in pair for pair in told))
    worst = max(told.values())
    experiment = replace(planned.experiment, rate=_rate(ground))
    text = f"Record {experiment.name}, {experiment.description}: it tells {_listed(between)} apart"
    if left:
        text += f", but not {_listed(left)} from each other: {remedy}"
    return Advice(f"{text} ({_percent(worst)} wrong choices to expect).", format_experiment(experiment), between, worst)


@dataclass(frozen=True)
class Separation:
    """How well a run tells two explanations apart, whichever is true.

    Attributes
    ----------
    squared : float
        Distance of their white predictions, squared.
    certainty : float
        Probability of the true one afterwards, as far as either may err in its form.
    """

    squared: float
    certainty: float = 1.0

    @property
    def error_rate(self) -> float:
        """Share of wrong choices to expect from noise."""
        return float(ndtr(-0.5 * np.sqrt(self.squared)))

    @property
    def tells(self) -> bool:
        """Whether the run would be worth its time."""
        return self.error_rate < ALLOWED_ERROR and self.certainty >= CERTAIN


def sensor(one: Collection[str], other: Collection[str]) -> str:
    """What to measure that tells explanations apart which no run does, given their effects."""
    differing = [effect for effect in EFFECTS if (effect in one) != (effect in other)]
    for effects, text in SENSORS.items():
        if any(effect in effects for effect in differing):
            return text
    # Where cause becomes reading, the earliest stage decides.
    first = min((EFFECTS[effect] for effect in differing), key=lambda effect: STAGES.index(effect.stage))
    return f"{SENSORS_OF_STAGE[first.stage]} (for {name_of(first.id)}: {first.separated_by})"


def _merit(planned: Plan, distances: Mapping[Pair, Separation]) -> tuple[int, float]:
    """Pairs that a run tells apart; the smallest distance of these, or the largest of all, for every second of it."""
    told = [found.squared for found in distances.values() if found.tells]
    return len(told), (min(told) if told else max(found.squared for found in distances.values())) / planned.duration


def _rate(ground: Ground) -> float:
    """Hz: that of the recordings, so that all can be compared, unless it is a slow one."""
    fastest = max(recording.run.rate for recording in ground.recordings)
    return float(f"{np.clip(fastest, RATE, 2000.0):.3g}")


def _listed(names: Sequence[str]) -> str:
    said = [name_of(name) for name in names]
    return ", ".join(said[:-1]) + f" and {said[-1]}"


def _percent(error: float) -> str:
    return f"{100 * error:.2g} %" if error > 1e-4 else "below 0.01 %"


# --- what is foreseen


@dataclass(frozen=True)
class Foreseen:
    """What rivals predict of a run that is not recorded yet, and the errors to expect of it.

    Attributes
    ----------
    rivals : mapping
    ground : Ground
    noise : float
        N rms, of the force sensor and of what the best model misses.
    misreadings : tuple of ndarray (4, n)
        Drawn errors of smoothed motions: s, m, m/s, m/s². They are those of the runs so far, so that they hang together as
        these do.
    without : _Rival, optional
        What leaves the gap.
    """

    rivals: Mapping[str, "_Rival"]
    ground: Ground
    noise: float
    misreadings: tuple[Array, ...]
    without: "_Rival | None" = None

    @classmethod
    def of(cls, rivals: Mapping[str, Refit], ground: Ground, rng: np.random.Generator, without: Refit | None = None) -> Self:
        """With errors as they were in the runs so far."""
        chosen = [ground.recordings[place].smoothed for place in rng.integers(0, len(ground.recordings), DRAWS)]
        drawn = []
        for smoothed in chosen:
            time = smoothed.run.time
            errors = motion_errors(time, smoothed.motion, rng, 1)
            drawn.append(np.stack([time - time[0], *(series[0] for series in errors)]))
        of_force = float(np.mean([noise.force**2 for noise in ground.noises]))
        return cls(
            {name: _Rival.of(refit, ground.fixed) for name, refit in rivals.items()},
            ground,
            float(np.hypot(np.sqrt(of_force), ground.missing)),
            tuple(drawn),
            _Rival.of(without, ground.fixed) if without else None,
        )

    def separations(self, planned: Plan, largest_force: float, rng: np.random.Generator) -> dict[Pair, Separation] | None:
        """How far, in standard deviations, a run brings each pair apart; None where a force is too large.

        Either of a pair may be true, so the smaller distance counts. One that contains the other can always imitate it: then
        only the truth of the larger one can show.
        """
        times = planned.times()
        at = planned.at(times)
        path = make_path(times, at.position, at.velocity, at.acceleration, at.current)
        shifts = np.linspace(-0.5, 0.5, DRAWS) / planned.experiment.rate
        misread = [self._misread(planned, *each) for each in zip(self.misreadings, shifts, strict=True)]
        imagined = {}
        for name, rival in self.rivals.items():
            theta = rival.problem.theta(rival.unit)
            force = rival.force(theta, path)
            if not np.abs(force).max() <= largest_force:
                return None
            run = Run(planned.experiment.name, times, at.position, at.velocity, at.current, force, at.acceleration)
            errors = np.stack([rival.force(theta, wrong) - force for wrong in misread])
            variance = np.mean(errors**2, axis=0)
            # Of a few draws: neighbours help, but must not wear down a peak.
            sigma = np.sqrt(self.noise**2 + np.maximum(variance, uniform_filter1d(variance, AROUND)))
            white = (errors + rng.normal(0.0, self.noise, errors.shape)) / sigma
            together = max(self.ground.together, float(np.mean([dispersion(error) for error in white])))
            imagined[name] = Recording(exact_run(run, at.acceleration), path, slice(0, len(run))), sigma, together
        gaps = {name: self._gap(self.without, *of) for name, of in imagined.items()} if self.without else {}
        found = {}
        for one, other in itertools.combinations(self.rivals, 2):
            both = []
            for true, instead in ((one, other), (other, one)):
                if not self.rivals[true].within(self.rivals[instead]):
                    squared = self.distance(*imagined[true], self.rivals[instead])
                    ahead = self.rivals[instead].total - self.rivals[true].total + imagined[true][2] * squared
                    both.append(Separation(squared, certainty(ahead, gaps[true]) if gaps else 1.0))
            found[one, other] = Separation(min(of.squared for of in both), min(of.certainty for of in both))
        return found

    def _gap(self, without: "_Rival", imagined: Recording, sigma: Array, together: float) -> float:
        """Squared white error that would be left of all runs, this one included, without what is true."""
        so_far = without.total - min(rival.total for rival in self.rivals.values())
        return so_far + together * self.distance(imagined, sigma, together, without)

    def _misread(self, planned: Plan, drawn: Array, shift: float) -> Path:
        """The run's path as it may be measured; no one knows when between two samples the current switched, so ``shift``."""
        times = planned.times()
        at = planned.at(times)
        position, velocity, acceleration = (np.interp(times % drawn[0, -1], drawn[0], series) for series in drawn[1:])
        current = planned.at(times + shift).current
        return make_path(times, at.position + position, at.velocity + velocity, at.acceleration + acceleration, current)

    def distance(self, imagined: Recording, sigma: Array, together: float, rival: "_Rival") -> float:
        """Squared distance of a run from a rival that is fitted to it and, by its normal matrix, to those before.

        Parameters
        ----------
        imagined : Recording
        sigma : ndarray (n,)
            N, its noise.
        together : float
            By how much its errors count less than as many independent ones.
        rival : _Rival
        """
        old = rival.problem
        # As in `Ground.problem`.
        scatter = Scatter(self.ground.scatter.gain / np.sqrt(together), self.ground.scatter.offset / np.sqrt(together))
        problem = _Afterwards(
            old.model,
            (imagined,),
            old.free,
            old.base,
            whitenings=(whitening(sigma, imagined.force, scatter),),
            sigmas=(sigma,),
            rival=rival,
        )
        _, cost = levenberg_marquardt(problem, rival.unit, np.arange(len(old.free)), EVALUATIONS, 1e-3, renewal=EVALUATIONS)
        return 2.0 * cost / together


@dataclass(frozen=True)
class _Rival:
    """What the runs so far make of a model.

    Attributes
    ----------
    problem : GapProblem
        With all parameters free of which other runs may tell.
    unit : ndarray (free,)
        The optimum.
    root : ndarray (free, free)
        Root of the normal matrix there.
    total : float
        Squared white error that it leaves of these runs, unseen.
    states : dict
        What of the runs so far outlasts them, such as heat, by the bytes of the parameters.
    """

    problem: GapProblem
    unit: Array
    root: Array
    total: float
    states: dict[bytes, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, refit: Refit, fixed: Collection[str]) -> Self:
        """From a refit; ``fixed`` are the names of parameters that no run shall free."""
        problem, unit, gram = refit.problem, refit.problem.unit(refit.theta), refit.grams.sum(axis=0)
        model = problem.model
        free = tuple(i for i, p in enumerate(model.parameters) if p.free and p.name not in fixed)
        silent = sorted(set(free) - set(problem.free))
        if silent:
            # At one current nothing is known of slopes over current: they are as usual, and the rest is fitted anew to suit.
            theta = refit.theta.copy()
            theta[silent] = model.defaults[silent]
            problem = replace(problem, free=free, base=theta)
            known = np.flatnonzero(~np.isin(free, silent))
            unit, _ = levenberg_marquardt(problem, problem.unit(theta), known, 10, 1e-6)
            jacobian = problem.jacobian(unit)
            gram = jacobian.T @ jacobian
        values, vectors = np.linalg.eigh(gram)
        return cls(problem, unit, np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, refit.total)

    @property
    def effects(self) -> frozenset[str]:
        """Ids."""
        return frozenset(effect.id for effect in self.problem.model.effects)

    def within(self, other: "_Rival") -> bool:
        """Whether the other contains it: the same damper model with more effects."""
        return self.problem.model.id == other.problem.model.id and self.effects < other.effects

    def force(self, theta: Array, path: Path, solutions: SeriesSolutions | None = None) -> Array:
        """Force (n,) in N of a run after those so far."""
        model, recordings = self.problem.model, self.problem.recordings
        if not any(effect.carries for effect in model.effects):
            return model.force(theta, path, solutions=solutions)
        key = theta.tobytes()
        if key not in self.states:
            state = model.initial_state(recordings[0].path).astype(theta.dtype)
            for place, recording in enumerate(recordings):
                state = model.next_state(state, recording.path) if place else state
                model.force(theta, recording.path, state)
            self.states[key] = state
        return model.force(theta, path, model.next_state(self.states[key], path), solutions)


@dataclass(frozen=True, kw_only=True)
class _Afterwards(GapProblem):
    """A rival fitted to an imagined run, held by the runs before."""

    rival: _Rival

    def forces(self, theta: Array, solutions: SeriesSolutions | None = None) -> Array:
        return self.rival.force(theta, self.recordings[0].path, solutions)

    def residuals(self, theta: Array) -> Array:
        return np.concatenate([super().residuals(theta), self.rival.root @ (self.unit(theta) - self.rival.unit)])

    def jacobian(self, unit: Array, indices: Sequence[int] | NDArray[np.intp] | None = None) -> Array:
        chosen = slice(None) if indices is None else np.asarray(indices)
        return np.vstack([super().jacobian(unit, indices), self.rival.root[:, chosen]])
