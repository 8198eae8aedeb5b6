"""What recordings can tell of effects: the smallest_size size that they would show, and which run shows it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mrd_diagnosis.base_fit import BaseFit, with_effect
from mrd_diagnosis.noise_model import estimate_noise
from mrd_diagnosis.refit import refit
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import RunScatter, Weighting
from mrd_identification.parallel import in_threads
from mrd_identification.recording import prepare_recording
from mrd_sim.damper import Damper
from mrd_sim.effects import Effect, find_effects
from mrd_sim.simulate import Instruments, measure_plans
from mrd_trajectory.plan import Plan

Array = NDArray[np.float64]

_FINEST = 1e-5
"""Of the largest plausible size: smaller ones are not looked for."""

_HUSHED = 0.01
"""Of the noise that is left where what effects do is looked at: else they would act on the noise as well."""


@dataclass(frozen=True)
class Detectability:
    """What recordings can tell of one effect.

    Attributes
    ----------
    effect : str
    smallest_size : float
        Least magnitude of the effect's first parameter, in its unit, that would show; infinite where none would that is
        plausible.
    unabsorbed : float
        Share of its change of the force, at that size or else at the largest one, that the model's own parameters and
        what differs from run to run cannot imitate.
    information : ndarray (runs,)
        Of each run in what they cannot: the evidence for the effect. They sum to one, or are zero where nothing changes.
    """

    effect: str
    smallest_size: float
    unabsorbed: float
    information: Array

    @property
    def remark(self) -> str:
        """Why these recordings cannot test the effect; empty where they can."""
        if np.isfinite(self.smallest_size):
            return ""
        if not self.information.any():
            return "it does not act in these runs"
        if self.unabsorbed < THRESHOLDS.untestable_share:
            return "the model's own parameters take it up"
        return "even the largest plausible size would not show"


def simulate_base_fit(
    plans: Sequence[Plan], damper: Damper, rng: np.random.Generator, instruments: Instruments | None = None
) -> tuple[Weighting, BaseFit]:
    """What a diagnosis would stand on, were these plans recorded of a damper that is just as its model says.

    The noise is in the floor, but not in the recordings: what an effect does to them is what it would do to the truth.

    Parameters
    ----------
    plans : sequence of Plan
        In the order of recording.
    damper : Damper
    rng : numpy Generator
    instruments : Instruments, optional
        How they measure; the scatter of runs is known.
    """
    instruments = instruments or Instruments()
    hushed = {e.name: _HUSHED * getattr(instruments, e.name) for e in fields(instruments) if e.name.endswith("_noise")}
    model, theta = damper.model, damper.theta
    noisy, still = (
        in_threads(prepare_recording, measure_plans(plans, damper, own, instruments=used))
        for own, used in zip(
            rng.spawn(2), (instruments, replace(instruments, run_gain=0.0, run_offset=0.0, **hushed)), strict=True
        )
    )
    recordings = [replace(other, counted=one.counted) for one, other in zip(noisy, still, strict=True)]
    weighting = Weighting(
        recordings,
        estimate_noise(noisy, model, theta, rng),
        RunScatter(instruments.run_gain, instruments.run_offset),
        {"coil_lag": float(theta[model.names.index("coil_lag")])},
    )
    return weighting, BaseFit.linearise(weighting, refit(weighting.problem(model, theta), theta, weighting.folds))


def detectable_sizes(
    weighting: Weighting, base_fit: BaseFit, effects: Sequence[str], needed: float | None = None
) -> list[Detectability]:
    """Smallest sizes of effects that recordings would show beside a model, and what each run contributes.

    An effect shows when what it changes of the white residual, less what the model's own parameters can imitate, has so much
    energy that a diagnosis names it, be the estimate of the noise off as it may. Its shape is the typical one.

    Parameters
    ----------
    weighting : Weighting
    base_fit : BaseFit
        The model refitted on this weighting.
    effects : sequence of str
        Ids, of effects that the model does not have.
    needed : float, optional
        Squared white residual that it takes; by default, what a model leaves that `Thresholds.noise_chi_square` no
        longer takes for noise. See `mrd_diagnosis.effect_search.detection_threshold`.
    """
    energy = (THRESHOLDS.noise_chi_square - 1.0) * weighting.samples if needed is None else needed
    return in_threads(lambda effect: _detectability(weighting, base_fit, effect, energy), find_effects(effects))


def _detectability(weighting: Weighting, base_fit: BaseFit, effect: Effect, needed: float) -> Detectability:
    model, plain = with_effect(base_fit.refit.problem.model, base_fit.refit.theta, effect.id)
    problem = weighting.problem(model, plain)
    largest = largest_size(effect)

    def change(log_share: float) -> tuple[Array, float]:
        """White residual that is left of the effect at a share of its largest size, and how much of its change that is."""
        theta = plain.copy()
        for name, value in sized(effect, np.exp(log_share) * largest).items():
            theta[model.names.index(f"{effect.id}.{name}")] = value
        changed = problem.residuals(theta) - base_fit.residual
        left = changed - base_fit.jacobian @ (base_fit.inverse @ (base_fit.jacobian.T @ changed))
        return left, float(np.linalg.norm(left) / np.linalg.norm(changed)) if changed.any() else 1.0

    def margin(log_share: float) -> float:
        left, _ = change(log_share)
        return float(np.log(max(float(left @ left), 1e-6 * needed) / needed))

    at, lowest = 0.0, float(np.log(_FINEST))
    shows = margin(at) > 0.0
    if shows:
        at = float(brentq(margin, lowest, at, xtol=0.01)) if margin(lowest) < 0.0 else lowest
    left, unabsorbed = change(at)
    evidence = np.array([float(left[block] @ left[block]) for block in problem.blocks])
    return Detectability(
        effect.id,
        abs(largest) * float(np.exp(at)) if shows and unabsorbed >= THRESHOLDS.untestable_share else float("inf"),
        unabsorbed,
        evidence / max(float(evidence.sum()), np.finfo(float).tiny),
    )


def largest_size(effect: Effect) -> float:
    """Bound of an effect's first parameter on the side of its typical value."""
    size = effect.parameters[0]
    return size.upper if effect.typical[size.name] > 0 else size.lower


def sized(effect: Effect, size: float) -> dict[str, float]:
    """An effect's parameters at a size: its typical shape; what else has a sign and is neutral at zero grows with it."""
    first = effect.parameters[0]
    factor = size / effect.typical[first.name]
    found = {}
    for p in effect.parameters:
        value = effect.typical.get(p.name, p.default)
        if p is first or (p.default == 0.0 and p.lower < 0.0 < p.upper):
            value = float(np.clip(value * factor, p.lower, p.upper))
        found[p.name] = value
    return found
