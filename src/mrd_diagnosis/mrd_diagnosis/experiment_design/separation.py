"""Separation: how well an experiment that is not recorded yet would tell explanations apart."""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtr

from mrd_diagnosis.refit import Refit
from mrd_diagnosis.statistics import certainty, error_dispersion
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import RunScatter, WeightedProblem, Weighting, whitening
from mrd_identification.least_squares import levenberg_marquardt
from mrd_identification.recording import Recording
from mrd_runs import Run
from mrd_runs.signals.motion import motion_errors
from mrd_runs.signals.smoothed_run import exact_run
from mrd_sim.models import SeriesSolutions
from mrd_sim.path import Path, make_path
from mrd_trajectory.plan import Plan

Array = NDArray[np.float64]
Pair = tuple[str, str]

EVALUATIONS = 3
"""Of a rival along each experiment: it starts near its optimum, and what it cannot learn in two steps is a difference."""

DRAWS, AROUND = 4, 15
"""Runs with drawn errors from which their variance is learned, over so many samples around each one."""


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
        return self.error_rate < THRESHOLDS.wrong_choices and self.certainty >= THRESHOLDS.named_probability


@dataclass(frozen=True)
class Foreseen:
    """What rivals predict of a run that is not recorded yet, and the errors to expect of it.

    Attributes
    ----------
    rivals : mapping
    weighting : Weighting
    noise : float
        N rms, of the force sensor and of what the best model misses.
    misreadings : tuple of ndarray (4, n)
        Drawn errors of smoothed motions: s, m, m/s, m/s². They are those of the runs so far, so that they hang together as
        these do.
    without : _Rival, optional
        What leaves the gap.
    """

    rivals: Mapping[str, "_Rival"]
    weighting: Weighting
    noise: float
    misreadings: tuple[Array, ...]
    without: "_Rival | None" = None

    @classmethod
    def of(
        cls, rivals: Mapping[str, Refit], weighting: Weighting, rng: np.random.Generator, without: Refit | None = None
    ) -> Self:
        """With errors as they were in the runs so far."""
        chosen = [weighting.recordings[place].smoothed for place in rng.integers(0, len(weighting.recordings), DRAWS)]
        drawn = []
        for smoothed in chosen:
            time = smoothed.run.time
            errors = motion_errors(time, smoothed.motion, rng, 1)
            drawn.append(np.stack([time - time[0], *(series[0] for series in errors)]))
        of_force = float(np.mean([noise.force**2 for noise in weighting.noise]))
        return cls(
            {name: _Rival.of(refit, weighting.fixed) for name, refit in rivals.items()},
            weighting,
            float(np.hypot(np.sqrt(of_force), weighting.discrepancy)),
            tuple(drawn),
            _Rival.of(without, weighting.fixed) if without else None,
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
            together = max(self.weighting.error_correlation, float(np.mean([error_dispersion(error) for error in white])))
            imagined[name] = Recording(exact_run(run, at.acceleration), path, slice(0, len(run))), sigma, together
        gaps = {name: self._gap(self.without, *of) for name, of in imagined.items()} if self.without else {}
        found = {}
        for one, other in itertools.combinations(self.rivals, 2):
            both = []
            for true, instead in ((one, other), (other, one)):
                if not self.rivals[true].within(self.rivals[instead]):
                    squared = self.distance(*imagined[true], self.rivals[instead])
                    ahead = (
                        self.rivals[instead].held_out_cost - self.rivals[true].held_out_cost + imagined[true][2] * squared
                    )
                    both.append(Separation(squared, certainty(ahead, gaps[true]) if gaps else 1.0))
            found[one, other] = Separation(min(of.squared for of in both), min(of.certainty for of in both))
        return found

    def _gap(self, without: "_Rival", imagined: Recording, sigma: Array, together: float) -> float:
        """Squared white error that would be left of all runs, this one included, without what is true."""
        so_far = without.held_out_cost - min(rival.held_out_cost for rival in self.rivals.values())
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
        # As in `Weighting.problem`.
        scatter = RunScatter(
            self.weighting.scatter.gain / np.sqrt(together), self.weighting.scatter.offset / np.sqrt(together)
        )
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
    problem : WeightedProblem
        With all parameters free of which other runs may tell.
    unit : ndarray (free,)
        The optimum.
    root : ndarray (free, free)
        Root of the normal matrix there.
    held_out_cost : float
        Squared white error that it leaves of these runs, unseen.
    states : dict
        What of the runs so far outlasts them, such as heat, by the bytes of the parameters.
    """

    problem: WeightedProblem
    unit: Array
    root: Array
    held_out_cost: float
    states: dict[bytes, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, refit: Refit, fixed: Collection[str]) -> Self:
        """From a refit; ``fixed`` are the names of parameters that no run shall free."""
        problem, unit, gram = refit.problem, refit.problem.unit(refit.theta), refit.normal_matrices.sum(axis=0)
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
        return cls(problem, unit, np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, refit.held_out_cost)

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
class _Afterwards(WeightedProblem):
    """A rival fitted to an imagined run, held by the runs before."""

    rival: _Rival

    def forces(self, theta: Array, solutions: SeriesSolutions | None = None) -> Array:
        return self.rival.force(theta, self.recordings[0].path, solutions)

    def residuals(self, theta: Array) -> Array:
        return np.concatenate([super().residuals(theta), self.rival.root @ (self.unit(theta) - self.rival.unit)])

    def jacobian(self, unit: Array, indices: Sequence[int] | NDArray[np.intp] | None = None) -> Array:
        chosen = slice(None) if indices is None else np.asarray(indices)
        return np.vstack([super().jacobian(unit, indices), self.rival.root[:, chosen]])
