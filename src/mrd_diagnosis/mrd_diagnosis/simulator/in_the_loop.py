"""Effects before the damper, with a simulator of the user's own in the loop.

An effect before the damper changes the motion or the current to which the simulator answers. While effects are searched, the
damper model that stands for the simulator answers to the change alone. Here the simulator itself is asked, along the motion
and the current that the effects leave: what it has beyond the model is found there instead of along the rod's motion, with
derivatives over the parameters of these effects by differences. With both, a refit is a step of Gauss and Newton on the
simulator's own force. It is repeated until the sizes stay.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.fitting.refit import Refit, refit, refit_on, scaled_inverse
from mrd_diagnosis.fitting.statistics import effect_parameters
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_diagnosis.search.model_comparison import ModelComparison
from mrd_identification.recording import Recording, consecutive_modelled_forces
from mrd_runs.signals.smoothed_run import Excess
from mrd_sim.effects import EFFECTS
from mrd_sim.effects.effect import Effect
from mrd_sim.models import DamperModel
from mrd_sim.path import make_path, run_path
from mrd_sim.simulators.simulator import Signals, Simulator

Array = NDArray[np.float64]

ROUNDS = 5
"""Refits with the simulator in the loop, at most."""

SETTLED = 0.2
"""Share of its standard deviation by which a size may still change in the last round."""

STEPS = (2e-3, 5e-2)
"""Least and largest difference of a parameter, as a share of its range; between them it is the standard deviation."""

RIVALS = 2
"""Effects in the place of each cause that the simulator is asked about, nearest first."""


def acts_before(effect: Effect) -> bool:
    """Whether an effect changes the motion or the current of the damper, and not only the force behind it."""
    return effect.stage in ("drive", "magnetics") or effect.elongation is not None


def with_excess(recording: Recording, excess: Excess) -> Recording:
    """Return a recording with what a simulator has beyond the model that stands for it."""
    smoothed = replace(recording.smoothed, excess=excess)
    path = run_path(smoothed).led_in(recording.path.lead_in)
    return replace(recording, smoothed=smoothed, path=path if recording.step == 1 else path.coarse(recording.counted))


def forces_in_series(model: DamperModel, theta: Array, recordings: Sequence[Recording]) -> list[Array]:
    """Return the force (m,) in N under which elements in series give way, on the vertices of `DamperModel.integrated`.

    It is the force of the damper, with what the measured force has beyond the modelled one. So it is known before the
    simulator answers to the motion that the elements leave, however far its model is from it.
    """
    forces: list[Array] = []
    state: Array | None = None
    for recording, modelled in zip(recordings, consecutive_modelled_forces(model, theta, recordings), strict=True):
        path = recording.path
        state = model.initial_state(path) if state is None else model.next_state(state, path)
        force = model.force_of_damper(theta, path, state)
        vertices = model.integrated(path)
        lacking = recording.run.force - modelled
        forces.append(force + np.interp(np.cumsum(vertices.dt), np.cumsum(vertices.dt)[vertices.samples], lacking))
    return forces


@dataclass
class SimulatorInLoop:
    """A simulator that is asked about the motion and the current that effects leave.

    Attributes
    ----------
    simulator : Simulator
        It answers to any motion (`Simulator.answers_anew`).
    model : DamperModel
        Model that stands for it.
    plain : ndarray (parameters,)
        Parameters with which the model alone reproduces it.
    failure : str
        Why it could not be asked, where it failed; then every answer stays that of the stand-in.
    """

    simulator: Simulator
    model: DamperModel
    plain: Array
    failure: str = ""

    def refit_comparison(self, comparison: ModelComparison) -> ModelComparison:
        """Return a comparison whose chosen effects and nearest rivals were refitted with the simulator in the loop."""
        if self.failure:
            return comparison
        weighting = comparison.weighting
        try:
            chain = tuple(self.refitted(weighting, step) for step in comparison.chain)
        except InputError as error:
            self.failure = str(error)
            return comparison
        alternatives = {}
        for effect, others in comparison.alternatives.items():
            rivals = sorted((name for name in others if name in EFFECTS and name != effect), key=_cost_in(others))
            asked = {name: self.refitted_if_possible(weighting, others[name]) for name in rivals[:RIVALS]}
            alternatives[effect] = {**others, **asked, effect: chain[-1]}
        return replace(comparison, chain=chain, alternatives=alternatives)

    def refitted_if_possible(self, weighting: Weighting, stood_in: Refit) -> Refit:
        """Return a refit with the simulator in the loop; the same where the simulator fails."""
        try:
            return self.refitted(weighting, stood_in)
        except InputError:
            return stood_in

    def refitted(self, weighting: Weighting, stood_in: Refit) -> Refit:
        """Return a refit with the simulator in the loop; the same where it is in it, or no effect acts before the damper.

        Raises
        ------
        InputError
            When the simulator fails.
        """
        problem = stood_in.problem
        names = [p.name for p in problem.parameters if any(p.name.startswith(f"{e.id}.") for e in _before(problem.model))]
        if not names or any(r.smoothed.excess and r.smoothed.excess.slopes for r in problem.recordings):
            return stood_in
        found = stood_in
        recordings: Sequence[Recording] = weighting.recordings
        for _ in range(ROUNDS):
            deviation = np.sqrt(np.diag(scaled_inverse(found.information, 1e-12)))[: len(problem.free)]
            recordings = self.linearised(found, recordings, names, deviation)
            in_loop = replace(weighting, recordings=recordings)
            before = problem.unit(found.theta)
            found = refit(in_loop.problem(problem.model, found.theta), found.theta, stood_in.folds)
            moved = np.abs(problem.unit(found.theta) - before) / np.maximum(deviation, STEPS[0])
            if all(moved[place] < SETTLED for place, p in enumerate(problem.parameters) if p.name in names):
                break
        return found

    def linearised(
        self, found: Refit, recordings: Sequence[Recording], names: Sequence[str], deviation: Array
    ) -> list[Recording]:
        """Return recordings with the excess of the simulator near the parameters of a refit."""
        problem, theta = found.problem, found.theta
        unit = problem.unit(theta)
        whole = [recording.whole for recording in problem.recordings]
        forces = forces_in_series(problem.model, theta, whole)
        here = self.answers(problem.model, theta, whole, forces)
        slopes: list[dict[str, tuple[float, Array]]] = [{} for _ in recordings]
        for place, parameter in enumerate(problem.parameters):
            if parameter.name not in names:
                continue
            step = float(np.clip(deviation[place], *STEPS))
            moved = unit.copy()
            moved[place] += step if unit[place] + step <= 1.0 else -step
            there = problem.theta(moved)
            index = problem.free[place]
            answers = self.answers(problem.model, there, whole, forces)
            for of_run, changed, same in zip(slopes, answers, here, strict=True):
                of_run[parameter.name] = float(theta[index]), (changed - same) / (there[index] - theta[index])
        return [
            recording if recording.without_effects else with_excess(recording, Excess(force, of_run))
            for recording, force, of_run in zip(recordings, here, slopes, strict=True)
        ]

    def answers(
        self, model: DamperModel, theta: Array, recordings: Sequence[Recording], forces: Sequence[Array]
    ) -> list[Array]:
        """Return what the simulator has beyond the model (n,) in N along the motion and current that effects leave.

        ``forces`` are those under which elements in series give way, see `forces_in_series`.
        """
        answers: list[Array] = []
        state: Array | None = None
        for recording, force in zip(recordings, forces, strict=True):
            if recording.without_effects and recording.smoothed.excess is not None:
                answers.append(recording.smoothed.excess.force)
                continue
            path = recording.path
            state = model.initial_state(path) if state is None else model.next_state(state, path)
            signals = Signals(recording.run.time, *model.motion_of_damper(theta, path, force, state))
            along = make_path(signals.time, signals.position, signals.velocity, signals.acceleration, signals.current)
            answers.append(self.simulator.force(signals) - self.model.alone.force(self.plain, along))
        return answers

    def corrected(
        self, model: DamperModel, theta: Array, recordings: Sequence[Recording], first: int = 0
    ) -> list[Recording]:
        """Return recordings with the excess at the parameters of effects, from number ``first`` on; those before it have it.

        They come one after the other, because what effects keep outlasts a run.

        Raises
        ------
        InputError
            When the simulator fails.
        """
        if not _before(model):
            return list(recordings[first:])
        forces = forces_in_series(model, theta, recordings)
        answers = self.answers(model, theta, recordings, forces)
        return [with_excess(r, Excess(force)) for r, force in zip(recordings[first:], answers[first:], strict=True)]

    def prepared(self, best: Refit, recordings: Sequence[Recording]) -> list[Recording]:
        """Return further recordings, which follow those of a refit, with the excess at its parameters."""
        if self.failure or not recordings:
            return list(recordings)
        known = [recording.whole for recording in best.problem.recordings]
        try:
            return self.corrected(best.problem.model, best.theta, [*known, *recordings], len(known))
        except InputError as error:
            self.failure = str(error)
            return list(recordings)

    def note(self, complete: ModelComparison) -> str:
        """Return what the simulator itself says about the effects before the damper; empty where there are none."""
        best = complete.best
        before = [effect.id for effect in _before(best.problem.model)]
        name = self.simulator.name
        if self.failure:
            return (
                f"The simulator could not be asked about effects before the damper, which its model answers: {self.failure}."
            )
        if not before:
            return ""
        stood_in, in_loop = (effect_parameters(fit) for fit in (refit_on(complete.weighting, best), best))
        apart = [
            f"{parameter} is {_worded(in_loop[parameter].value)} {in_loop[parameter].unit}, and "
            f"{_worded(stood_in[parameter].value)} {in_loop[parameter].unit} with the model"
            for parameter in in_loop
            if parameter.partition(".")[0] in before and _differ(in_loop[parameter].value, stood_in[parameter].value)
        ]
        told = (
            f"{name} itself answered to the motion and the current that {' and '.join(before)} leave{'s'[len(before) - 1 :]}"
        )
        if not apart:
            return f"{told}; the model that stands for it gives the same sizes within their intervals."
        sizes = "; ".join(apart)
        return f"{told}: {sizes} that stands for it. The two disagree by more than their intervals; the first counts."


def _before(model: DamperModel) -> list[Effect]:
    """Return the effects before the damper; none around a model that does not stand for the simulator."""
    return [effect for effect in model.effects if model.stands_for and acts_before(effect)]


def _cost_in(refits: Mapping[str, Refit]) -> Callable[[str], float]:
    return lambda name: refits[name].held_out_cost


def _differ(one: Interval, other: Interval) -> bool:
    """Whether two values differ by more than the half widths of their intervals together."""
    return abs(one.value - other.value) > 0.5 * math.hypot(one.upper - one.lower, other.upper - other.lower)


def _worded(interval: Interval) -> str:
    return f"{interval.value:.3g} ({interval.lower:.3g} to {interval.upper:.3g})"
