"""The start of a run: what the damper had been through before the first sample is unknown and estimated from the force."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from mrd_identification.least_squares import fit_least_squares
from mrd_identification.parallel import in_threads
from mrd_identification.problem import Problem
from mrd_identification.recording import Recording
from mrd_runs.signals.motion import Motion
from mrd_sim.lead_in import APPROACH, MAY_MOVE, SURELY_MOVES, LeadIn, moving_lead_in, resting_lead_in, still_lead_in
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]
Whiten = Callable[[Array], Array]

REACHES = APPROACH * 3.0 ** -np.arange(9.0)
"""Shares of that stroke that are tried for the travel since the last reversal."""

NEIGHBOURS = 2
"""Histories beside the most likely one, whose difference from it any fit may add to the modelled force."""

ROUNDS, CONVERGED = 6, 0.99
"""Most times that starts and parameters are fitted in turn, and the ratio of costs at which it ends."""

Family = Callable[[float], LeadIn]


def estimate_starts(
    model: DamperModel,
    theta: Array,
    recordings: Sequence[Recording],
    forces: Sequence[Array] | None = None,
    whiten: Sequence[Whiten] | None = None,
) -> list[Recording]:
    """Return recordings with the lead-ins that make the measured forces most likely.

    Histories of one kind are tried (`mrd_sim.lead_in`), and where the rod rests or there is none yet, also none: the damper
    begins at rest and unloaded. What the next most likely ones would change is left in `Recording.other_starts`.

    Parameters
    ----------
    model : DamperModel
    theta : ndarray (parameters,)
        Near the truth.
    recordings : sequence of Recording
        In the order of recording.
    forces : sequence of ndarray (n,), optional
        Force in N at the counted samples that the model has to give; the measured one without it.
    whiten : sequence of callable, optional
        For each run, a function of its errors (n,) whose squares add up to what is to be small; without it, the errors
        less their mean.
    """
    forces = [recording.force for recording in recordings] if forces is None else forces
    whiten = [_without_mean] * len(recordings) if whiten is None else whiten
    stroke = max(float(np.ptp(recording.motion.position)) for recording in recordings)
    states = _states_before(model, theta, recordings)
    return in_threads(
        lambda item: _most_likely(model, theta, *item, stroke), list(zip(recordings, states, forces, whiten, strict=True))
    )


def fit_with_starts(problem: Problem, theta: Array) -> tuple[Problem, Array]:
    """Fit the starts of the runs and the parameters (parameters,) in turn, from parameters found with usual starts.

    A simulation may begin unloaded though the rod moves. If all runs do, that is found by a fit of its own: a wrong start
    and wrong parameters can support each other.
    """
    unloaded = replace(problem, recordings=[replace(r, path=r.path.led_in(None)) for r in problem.recordings])
    of_unloaded, least = fit_least_squares(unloaded, theta)
    before = np.inf
    for _ in range(ROUNDS):
        problem = replace(problem, recordings=estimate_starts(problem.model, theta, problem.recordings))
        theta, cost = fit_least_squares(problem, theta)
        if cost > CONVERGED * before:
            break
        before = cost
    return (unloaded, of_unloaded) if least < cost else (problem, theta)


def _without_mean(errors: Array) -> Array:
    return np.asarray(errors - errors.mean())


def _states_before(model: DamperModel, theta: Array, recordings: Sequence[Recording]) -> list[Array | None]:
    """Return the state before each run of what outlasts a run; None where nothing does or can."""
    if not any(effect.outlasts_run for effect in model.effects):
        return [None] * len(recordings)
    states: list[Array | None] = []
    state: Array | None = None
    for recording in recordings:
        if recording.without_effects:
            states.append(None)
            continue
        state = model.initial_state(recording.path) if state is None else model.next_state(state, recording.path)
        states.append(state.copy())
        model.force(theta, recording.path, state)
    return states


def _most_likely(
    model: DamperModel, theta: Array, recording: Recording, state: Array | None, force: Array, whiten: Whiten, stroke: float
) -> Recording:
    """Return a recording with its most likely lead-in."""
    if recording.without_effects:
        theta = model.without_effects(theta)

    def modelled(lead_in: LeadIn | None) -> Array:
        path = recording.path.led_in(lead_in)
        begin = None if state is None else state.copy()
        return recording.as_recorded(model.force(theta, path, begin))[recording.counted]

    def cost(of_model: Array) -> float:
        return float(np.sum(whiten(of_model - force) ** 2))

    families = _families(recording.motion, stroke)
    tried = [(family, stroke * share) for family in families for share in REACHES]
    lead_ins: list[LeadIn | None] = [family(reach) for family, reach in tried]
    if recording.path.lead_in is None or not _surely_moves(recording.motion):
        lead_ins.append(None)
    candidates = [modelled(lead_in) for lead_in in lead_ins]
    costs = np.array([cost(candidate) for candidate in candidates])
    costs[~np.isfinite(costs)] = np.inf
    order = np.argsort(costs, kind="stable")
    best, lead_in = candidates[order[0]], lead_ins[order[0]]
    if lead_in is not None:
        family, reach = tried[order[0]]
        step = np.log(REACHES[0] / REACHES[1])
        found = minimize_scalar(
            lambda shift: cost(modelled(family(reach * np.exp(shift)))),
            bounds=(-step, step),
            method="bounded",
            options={"xatol": 0.03, "maxiter": 12},
        )
        if found.fun < costs[order[0]]:
            lead_in = family(reach * np.exp(found.x))
            best = modelled(lead_in)
    # The differences from coarse candidates, which are far enough apart to span what a little more or less would change.
    others = np.stack([candidates[i] - best for i in order[1 : 1 + NEIGHBOURS]], axis=1)
    if model.remembers_current and not recording.without_effects:
        lead_in, best, others = _magnetised(lead_in, best, others, recording, modelled, cost)
    return replace(recording, path=recording.path.led_in(lead_in), other_starts=others)


def _magnetised(
    lead_in: LeadIn | None,
    best: Array,
    others: Array,
    recording: Recording,
    modelled: Callable[[LeadIn | None], Array],
    cost: Callable[[Array], float],
) -> tuple[LeadIn | None, Array, Array]:
    """Return the lead-in with the most likely current before, its force, and what other starts would change.

    A larger or a smaller current than the first one may have flowed before, or what the run before has left is there still.
    """
    largest = float(np.abs(recording.path.recorded.current).max())
    magnetised = [replace(lead_in or still_lead_in(), current=current) for current in (largest, -largest)]
    lead_ins, forces = [lead_in, *magnetised], [best, *map(modelled, magnetised)]
    chosen = int(np.argmin([cost(force) for force in forces]))
    changes = [force - forces[chosen] for place, force in enumerate(forces) if place != chosen]
    return lead_ins[chosen], forces[chosen], np.column_stack([others, *changes])


def _surely_moves(motion: Motion) -> bool:
    """Whether the rod moves at the first sample, beyond any error."""
    return bool(abs(motion.velocity[0]) > SURELY_MOVES * np.abs(motion.velocity).max())


def _families(motion: Motion, stroke: float) -> list[Family]:
    """Return the kinds of histories that may have led to the first sample of a motion, as functions of the reach in m."""
    first, largest = float(motion.velocity[0]), float(np.abs(motion.velocity).max())
    families: list[Family] = []
    if abs(first) > MAY_MOVE * largest:
        families.append(lambda reach: moving_lead_in(first, reach, APPROACH * stroke))
    if not _surely_moves(motion):
        speed = float(np.sqrt(np.mean(motion.velocity**2)))
        families.append(lambda reach: resting_lead_in(reach, APPROACH * stroke, speed))
        families.append(lambda reach: resting_lead_in(-reach, APPROACH * stroke, speed))
    return families
