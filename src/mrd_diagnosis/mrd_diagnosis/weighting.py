"""The ground on which models are compared: recordings, the noise in them, the parts that are held out in turn."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import RunNoise
from mrd_diagnosis.refit import GapProblem, Scatter, whitening
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, consecutive_forces
from mrd_identification.residual_correlation import correlation_length
from mrd_sim.effects import EFFECTS
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]

PART = 4.0
"""s; shorter parts of a run hang together too much to be judged by each other, but see `FEWEST_PARTS`."""

FEWEST_PARTS = 8
"""Fewer of them say too little of scatter."""

STARTS = 64
"""Random points from which the best are fitted when nothing is known of the parameters."""


@dataclass(frozen=True)
class Ground:
    """Recordings and what is known of their errors.

    Attributes
    ----------
    recordings : sequence of Recording
    noises : sequence of RunNoise
    scatter : Scatter
    fixed : mapping
        Values of the model's parameters that are not searched.
    missing : float
        N rms by which the best model so far errs beyond noise. As long as something is missing, samples without noise say no
        more than others.
    together : float
        Samples over which its error hangs together: a run's own gain and offset are as much less free, or they would stand
        in for what is missing.
    """

    recordings: Sequence[Recording]
    noises: Sequence[RunNoise]
    scatter: Scatter
    fixed: Mapping[str, float]
    missing: float = 0.0
    together: float = 1.0

    def problem(self, model: DamperModel, theta: Array, freed: Sequence[str] = ()) -> GapProblem:
        """What these recordings can tell about a model, with white residuals where it is true.

        Parameters
        ----------
        model : DamperModel
        theta : ndarray (parameters,)
            Near the optimum: a run's own gain multiplies the force that they give.
        freed : sequence of str
            See `mrd_identification.problem.make_problem`.
        """
        posed, _ = make_problem(model, self.recordings, fixed=self.fixed, freed=freed)
        base = posed.base.copy()
        # What is never searched stays as it is: the mains' frequency.
        kept = [i for i, p in enumerate(model.parameters) if not (p.free or p.name in freed or p.name in self.fixed)]
        base[kept] = theta[kept].real
        root = np.sqrt(self.together)
        scatter = Scatter(self.scatter.gain / root, self.scatter.offset / root)
        sigmas = tuple(noise.sigma for noise in self.noises)
        whitenings = tuple(
            whitening(np.sqrt(sigma**2 + self.missing**2), force, scatter)
            for sigma, force in zip(sigmas, consecutive_forces(model, theta, self.recordings), strict=True)
        )
        return GapProblem(posed.model, posed.recordings, posed.free, base, whitenings=whitenings, sigmas=sigmas)

    def after(self, model: DamperModel, theta: Array) -> "Ground":
        """The ground on which a model with these parameters is the best so far."""
        left = []
        for recording, noise, force in zip(
            self.recordings, self.noises, consecutive_forces(model, theta, self.recordings), strict=True
        ):
            error = force - recording.force
            gain, offset = whitening(noise.sigma, force, self.scatter).own @ error
            left.append(error - gain * force - offset)
        error, sigma = np.concatenate(left), np.concatenate([noise.sigma for noise in self.noises])
        missing = float(np.sqrt(max(float(np.mean(error**2 - sigma**2)), 0.0)))
        white = error / np.sqrt(sigma**2 + missing**2)
        share = missing**2 / (missing**2 + float(np.mean(sigma**2)))
        return replace(self, missing=missing, together=1.0 + share * (correlation_length(white) - 1.0))

    @property
    def noise_share(self) -> float:
        """What noise alone contributes to the squared white error of everything."""
        return float(sum(np.sum(n.sigma**2 / (n.sigma**2 + self.missing**2)) for n in self.noises))

    @property
    def samples(self) -> int:
        """Counted samples."""
        return sum(len(recording.force) for recording in self.recordings)

    @property
    def parts(self) -> list[tuple[int, slice]]:
        """Place of the run and samples among all counted ones, for each part that is held out in turn."""
        found, start = [], 0
        fewest = -(-FEWEST_PARTS // len(self.recordings))
        for run, recording in enumerate(self.recordings):
            length = len(recording.force)
            count = max(fewest, min(3, int(recording.run.duration / PART)), 1)
            edges = start + np.linspace(0, length, count + 1).astype(int)
            found += [(run, slice(int(a), int(b))) for a, b in itertools.pairwise(edges)]
            start += length
        return found


def first_fit(
    problem: Problem, start: Array | None, rng: np.random.Generator, starts: int = STARTS, evaluations: int = 100
) -> Array:
    """Least squares (parameters,) from ``start``, if there is one, and from the best of random points of the box.

    Parameters in which the force is linear follow from the others (variable projection), so few points are enough.
    """
    units = np.vstack([problem.unit(problem.model.defaults), rng.random((starts, len(problem.free)))])
    thetas, norms = problem.project(problem.theta(units))
    best = np.argsort(norms[:, 0], kind="stable")[: 1 + starts // 20]
    begins = [*thetas[best], *([] if start is None else [problem.theta(problem.unit(start))])]
    brief = [fit_least_squares(problem, begin, 15) for begin in begins]
    return fit_least_squares(problem, min(brief, key=lambda found: found[1])[0], evaluations)[0]


def without_effect(model: DamperModel, theta: Array, effect: str) -> tuple[DamperModel, Array]:
    """The model without one of its effects, and its other parameters."""
    poorer = model.with_effects([other for other in model.effects if other.id != effect])
    values = dict(zip(model.names, theta, strict=True))
    return poorer, np.array([values[name] for name in poorer.names])


def with_effect(model: DamperModel, theta: Array, effect: str) -> tuple[DamperModel, Array]:
    """The model with one more effect, and its parameters with the effect neutral."""
    present = {other.id for other in model.effects}
    richer = replace(model, effects=()).with_effects(
        [EFFECTS[name] for name in EFFECTS if name in present or name == effect]
    )
    values = dict(zip(model.names, theta, strict=True))
    return richer, np.array([values.get(p.name, p.default) for p in richer.parameters])
