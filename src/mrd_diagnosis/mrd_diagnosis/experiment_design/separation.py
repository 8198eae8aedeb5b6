"""Separation: how well an experiment that is not recorded yet would tell explanations apart."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtr

from mrd_diagnosis.experiment_design.prediction import RivalModel, UpdatedProblem
from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.statistics import certainty, error_dispersion, tempering_of
from mrd_diagnosis.fitting.weighting import RunScatter, Weighting, whitening
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.least_squares import levenberg_marquardt
from mrd_identification.recording import Recording
from mrd_runs import Run
from mrd_runs.signals.motion import motion_errors
from mrd_runs.signals.smoothed_run import exact_run
from mrd_sim.path import Path, make_path
from mrd_trajectory.plan import Plan

Array = NDArray[np.float64]
Pair = tuple[str, str]

EVALUATIONS = 3
"""Evaluations of an explanation that is fitted to a predicted run. It starts near its optimum; what it cannot imitate after
two steps is a difference.
"""

DRAWS = 4
"""Draws of the errors of motion and current from which their variance is estimated."""

SMOOTHED_SAMPLES = 15
"""Samples over which that variance is averaged."""


@dataclass(frozen=True)
class Separation:
    """Ability of a run to tell two explanations apart, whichever of them is true.

    Attributes
    ----------
    squared_distance : float
        Squared distance of their white predictions.
    certainty : float
        Probability of the true explanation after the run, although the formula of either may be wrong.
    tempering : float
        Factor by which the squared distance counts less than noise alone says, because the formula of either may be wrong.
    """

    squared_distance: float
    certainty: float = 1.0
    tempering: float = 1.0

    @property
    def tempered_squared_distance(self) -> float:
        """Squared distance that counts; see `mrd_diagnosis.fitting.statistics.probabilities`."""
        return self.squared_distance * self.tempering

    @property
    def error_rate(self) -> float:
        """Expected share of wrong choices because of noise."""
        return float(ndtr(-0.5 * np.sqrt(self.squared_distance)))

    @property
    def is_conclusive(self) -> bool:
        """Whether the run would tell the explanations apart."""
        return self.error_rate < THRESHOLDS.wrong_choices and self.certainty >= THRESHOLDS.named_probability


@dataclass(frozen=True)
class PredictedRun:
    """A run as one explanation predicts it, with the errors to expect.

    Attributes
    ----------
    recording : Recording
        Its force is the predicted one.
    sigma : ndarray (n,)
        Standard deviation of the errors in N.
    dispersion : float
        Factor by which the white errors count less than as many independent ones.
    """

    recording: Recording
    sigma: Array
    dispersion: float


@dataclass(frozen=True)
class Predictor:
    """Predictions of explanations for runs that are not recorded yet.

    Attributes
    ----------
    explanations : mapping
        By name.
    weighting : Weighting
    noise : float
        Error in N rms of the force sensor and of what the best model misses.
    motion_errors : tuple of ndarray (4, n)
        Drawn errors of smoothed motions: time in s, position in m, velocity in m/s, acceleration in m/s². They are drawn for
        recorded runs, so that they are correlated in time as there.
    without : RivalModel, optional
        The model without what the explanations explain the gap by.
    """

    explanations: Mapping[str, RivalModel]
    weighting: Weighting
    noise: float
    motion_errors: tuple[Array, ...]
    without: RivalModel | None = None

    @classmethod
    def from_refits(
        cls, refits: Mapping[str, Refit], weighting: Weighting, rng: np.random.Generator, without: Refit | None = None
    ) -> Self:
        """Make the predictor from refits to the recorded runs, with the errors of these runs."""
        drawn_from = [weighting.recordings[run].smoothed for run in rng.integers(0, len(weighting.recordings), DRAWS)]
        drawn = []
        for smoothed in drawn_from:
            time = smoothed.run.time
            errors = motion_errors(time, smoothed.motion, rng, 1)
            drawn.append(np.stack([time - time[0], *(series[0] for series in errors)]))
        force_variance = float(np.mean([noise.force**2 for noise in weighting.noise]))
        return cls(
            {name: RivalModel.from_refit(refit, weighting.fixed) for name, refit in refits.items()},
            weighting,
            float(np.hypot(np.sqrt(force_variance), weighting.discrepancy)),
            tuple(drawn),
            RivalModel.from_refit(without, weighting.fixed) if without else None,
        )

    def separations(self, planned: Plan, largest_force: float, rng: np.random.Generator) -> dict[Pair, Separation] | None:
        """Return how well a run separates each pair of explanations; None where a predicted force in N is too large.

        Either explanation of a pair may be true, so the smaller distance counts. An explanation that contains the other one
        can always imitate it. Then only the larger one, if it is true, can be recognised.
        """
        predicted = self._predict(planned, largest_force, rng)
        if predicted is None:
            return None
        gaps = {name: self._gap(self.without, run) for name, run in predicted.items()} if self.without else {}
        separations = {}
        for pair in itertools.combinations(self.explanations, 2):
            directed = []
            for true, other in (pair, pair[::-1]):
                if not self.explanations[true].is_nested_in(self.explanations[other]):
                    squared_distance = self.distance(predicted[true], self.explanations[other])
                    lead = (
                        self.explanations[other].held_out_cost
                        - self.explanations[true].held_out_cost
                        + predicted[true].dispersion * squared_distance
                    )
                    if gaps:
                        tempering = tempering_of(predicted[true].dispersion, gaps[true])
                        directed.append(Separation(squared_distance, certainty(lead, gaps[true]), tempering))
                    else:
                        directed.append(Separation(squared_distance))
            separations[pair] = Separation(
                min(separation.squared_distance for separation in directed),
                min(separation.certainty for separation in directed),
                min(separation.tempering for separation in directed),
            )
        return separations

    def distance(self, predicted: PredictedRun, explanation: RivalModel) -> float:
        """Return the squared distance of a predicted run from an explanation that is fitted to it and to the runs before."""
        problem = explanation.problem
        # As in `Weighting.problem`.
        root = np.sqrt(predicted.dispersion)
        scatter = RunScatter(self.weighting.scatter.gain / root, self.weighting.scatter.offset / root)
        updated = UpdatedProblem(
            problem.model,
            (predicted.recording,),
            problem.free,
            problem.base,
            whitenings=(whitening(predicted.sigma, predicted.recording.force, scatter),),
            sigmas=(predicted.sigma,),
            explanation=explanation,
        )
        free = np.arange(len(problem.free))
        _, cost = levenberg_marquardt(updated, explanation.unit, free, EVALUATIONS, 1e-3, renewal=EVALUATIONS)
        return 2.0 * cost / predicted.dispersion

    def _predict(self, planned: Plan, largest_force: float, rng: np.random.Generator) -> dict[str, PredictedRun] | None:
        """Return the run as each explanation predicts it; None where a force in N is too large."""
        times = planned.times()
        setpoint = planned.at(times)
        motion = setpoint.position, setpoint.velocity, setpoint.acceleration
        path = self._at_last_temperature(make_path(times, *motion, setpoint.current))
        shifts = np.linspace(-0.5, 0.5, DRAWS) / planned.experiment.rate
        wrong_paths = [
            self._path_with_errors(planned, drawn, shift) for drawn, shift in zip(self.motion_errors, shifts, strict=True)
        ]
        predicted = {}
        for name, explanation in self.explanations.items():
            theta = explanation.problem.theta(explanation.unit)
            force = explanation.force(theta, path)
            if not np.abs(force).max() <= largest_force:
                return None
            run = Run(
                planned.experiment.name,
                times,
                setpoint.position,
                setpoint.velocity,
                setpoint.current,
                force,
                setpoint.acceleration,
            )
            errors = np.stack([explanation.force(theta, wrong) - force for wrong in wrong_paths])
            variance = np.mean(errors**2, axis=0)
            # The variance comes from few draws: its neighbours raise it, but they must not lower a peak.
            sigma = np.sqrt(self.noise**2 + np.maximum(variance, uniform_filter1d(variance, SMOOTHED_SAMPLES)))
            white = (errors + rng.normal(0.0, self.noise, errors.shape)) / sigma
            dispersion = max(self.weighting.error_correlation, float(np.mean([error_dispersion(error) for error in white])))
            recording = Recording(exact_run(run, setpoint.acceleration), path, slice(0, len(run)))
            predicted[name] = PredictedRun(recording, sigma, dispersion)
        return predicted

    def _gap(self, without: RivalModel, predicted: PredictedRun) -> float:
        """Return the squared white error without an explanation: of recorded runs beyond the best, and of the new one."""
        recorded = without.held_out_cost - min(explanation.held_out_cost for explanation in self.explanations.values())
        return recorded + predicted.dispersion * self.distance(predicted, without)

    def _path_with_errors(self, planned: Plan, drawn: Array, shift: float) -> Path:
        """Return the run's path as it may be measured, with the current switching ``shift`` s later: nobody knows when it
        switches between two samples.
        """
        times = planned.times()
        setpoint = planned.at(times)
        position, velocity, acceleration = (np.interp(times % drawn[0, -1], drawn[0], series) for series in drawn[1:])
        current = planned.at(times + shift).current
        motion = setpoint.position + position, setpoint.velocity + velocity, setpoint.acceleration + acceleration
        return self._at_last_temperature(make_path(times, *motion, current))

    def _at_last_temperature(self, path: Path) -> Path:
        """Return a path along which the damper is as warm as at the end of the recorded runs, where that is known."""
        recorded = self.weighting.recordings[-1].path.temperature
        return path if recorded is None else replace(path, temperature=np.full(len(path.dt), recorded[-1]))
