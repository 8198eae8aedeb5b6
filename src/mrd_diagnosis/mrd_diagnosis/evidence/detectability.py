"""Detectability: the smallest size of each effect that recordings would show, and the runs that show it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mrd_diagnosis.diagnosis import Interval, ParameterEstimate
from mrd_diagnosis.fitting.base_fit import LinearisedRefit, with_effect
from mrd_diagnosis.fitting.refit import refit
from mrd_diagnosis.fitting.weighting import RunScatter, Weighting
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.effect_names import effect_clause
from mrd_diagnosis.wording.quantities import format_quantity
from mrd_identification.parallel import in_threads
from mrd_identification.recording import prepare_recording
from mrd_sim.damper import Damper
from mrd_sim.effects import Effect, find_effects
from mrd_sim.simulate import Instruments, measure_plans
from mrd_trajectory.plan import Plan

Array = NDArray[np.float64]

SMALLEST_SHARE = 1e-5
"""Share of the largest plausible size below which no smaller size is looked for."""

REDUCED_NOISE = 0.01
"""Share of the noise in the recordings on which effects act; with all of it, effects would act on the noise as well."""


LEAST_ENERGY = 1e-6
"""Share of the energy that is needed which stands for none, so that its logarithm is finite."""

SIZE_TOLERANCE = 0.01
"""Relative error of the smallest detectable size."""


@dataclass(frozen=True)
class Detectability:
    """Detectability of one effect in given recordings.

    Attributes
    ----------
    effect : str
    smallest_size : float
        Smallest detectable magnitude of the effect's first parameter, in its unit; infinite where even the largest plausible
        size is not detectable.
    unabsorbed : float
        Share of the effect's change of the force, at that size or else at the largest one, that the model's own parameters
        and the scatter of the runs cannot imitate.
    information : ndarray (runs,)
        Share of each run in the evidence for the effect. The shares sum to one, or are zero where the effect does not act.
    """

    effect: str
    smallest_size: float
    unabsorbed: float
    information: Array

    @property
    def remark(self) -> str:
        """Reason why these recordings cannot test the effect; empty where they can."""
        if np.isfinite(self.smallest_size):
            return ""
        if not self.information.any():
            return "it does not act in these runs"
        if self.unabsorbed < THRESHOLDS.untestable_share:
            return "the model's own parameters take it up"
        return "even the largest plausible size would not show"


DIVERGED = 1e100
"""White residual beyond which a model has diverged. The square of it is still a number."""


def simulate_base_fit(
    plans: Sequence[Plan], damper: Damper, rng: np.random.Generator, instruments: Instruments | None = None
) -> tuple[Weighting, LinearisedRefit]:
    """Simulate recordings of a damper without effects, and return their weighting and base fit.

    The noise is in the weighting, but hardly in the recordings: effects then change the recordings as they change the true
    force.

    Parameters
    ----------
    plans : sequence of Plan
        In the order of recording.
    damper : Damper
    rng : numpy Generator
    instruments : Instruments, optional
        Noise, filters and run scatter of the measurement; the scatter counts as known.
    """
    instruments = instruments or Instruments()
    reduced = {
        field.name: REDUCED_NOISE * getattr(instruments, field.name)
        for field in fields(instruments)
        if field.name.endswith("_noise")
    }
    quiet_instruments = replace(instruments, run_gain=0.0, run_offset=0.0, **reduced)
    model, theta = damper.model, damper.theta
    noisy, quiet = (
        in_threads(prepare_recording, measure_plans(plans, damper, generator, instruments=used))
        for generator, used in zip(rng.spawn(2), (instruments, quiet_instruments), strict=True)
    )
    recordings = [replace(q, counted=n.counted) for n, q in zip(noisy, quiet, strict=True)]
    weighting = Weighting(
        recordings,
        estimate_noise(noisy, model, theta, rng),
        RunScatter(instruments.run_gain, instruments.run_offset),
        {"coil_lag": float(theta[model.names.index("coil_lag")])},
    )
    return weighting, LinearisedRefit.around(weighting, refit(weighting.problem(model, theta), theta, weighting.folds))


def detectable_sizes(
    weighting: Weighting, base_fit: LinearisedRefit, effects: Sequence[str], needed: float | None = None
) -> list[Detectability]:
    """Return the smallest sizes of effects that recordings would show, and what each run contributes.

    An effect is detectable when its change of the white residual, without what the model's own parameters can imitate, has
    enough energy to be named by a diagnosis even if the noise estimate is wrong. The effect has its typical shape.

    Parameters
    ----------
    weighting : Weighting
    base_fit : LinearisedRefit
        The model refitted on this weighting.
    effects : sequence of str
        Ids of effects that the model does not have.
    needed : float, optional
        Sum of squared white residuals that is needed. By default, it is the one that raises the reduced chi-square above
        `Thresholds.noise_chi_square`. See `mrd_diagnosis.search.effect_search.detection_threshold`.
    """
    energy = (THRESHOLDS.noise_chi_square - 1.0) * weighting.samples if needed is None else needed
    named = find_effects(effects, base_fit.refit.problem.model.scales)
    return in_threads(lambda effect: _detectability(weighting, base_fit, effect, energy), named)


def _detectability(weighting: Weighting, base_fit: LinearisedRefit, effect: Effect, needed: float) -> Detectability:
    model, neutral = with_effect(base_fit.refit.problem.model, base_fit.refit.theta, effect.id)
    problem = weighting.problem(model, neutral)
    largest = largest_size(effect)

    def unabsorbed_change(log_share: float) -> tuple[Array, float]:
        """Return the unabsorbed change of the white residual by a share of the largest size, and its share of the change."""
        theta = neutral.copy()
        for name, value in scaled_effect(effect, np.exp(log_share) * largest).items():
            theta[model.names.index(f"{effect.id}.{name}")] = value
        # At its largest size, an effect may let the model diverge.
        change = np.clip(np.nan_to_num(problem.residuals(theta), nan=np.inf), -DIVERGED, DIVERGED) - base_fit.residual
        unabsorbed = base_fit.unabsorbed(change)
        return unabsorbed, float(np.linalg.norm(unabsorbed) / np.linalg.norm(change)) if change.any() else 1.0

    def margin(log_share: float) -> float:
        unabsorbed, _ = unabsorbed_change(log_share)
        return float(np.log(max(float(unabsorbed @ unabsorbed), LEAST_ENERGY * needed) / needed))

    log_share, lowest = 0.0, float(np.log(SMALLEST_SHARE))
    detectable = margin(log_share) > 0.0
    if detectable:
        log_share = float(brentq(margin, lowest, log_share, xtol=SIZE_TOLERANCE)) if margin(lowest) < 0.0 else lowest
    unabsorbed, share = unabsorbed_change(log_share)
    evidence = np.array([float(unabsorbed[block] @ unabsorbed[block]) for block in problem.blocks])
    return Detectability(
        effect.id,
        abs(largest) * float(np.exp(log_share)) if detectable and share >= THRESHOLDS.untestable_share else float("inf"),
        share,
        evidence / max(float(evidence.sum()), np.finfo(float).tiny),
    )


def clause_of_size(effect: Effect, size: float) -> str:
    """Return an effect of a size without sign, with its typical shape, as a clause."""
    values = scaled_effect(effect, math.copysign(size, largest_size(effect)))
    units = {parameter.name: parameter.unit for parameter in effect.parameters}
    clause = effect_clause(
        effect.id, {name: ParameterEstimate(Interval(value), units[name]) for name, value in values.items()}
    )
    first = effect.parameters[0]
    if not effect.phrase or f"{{{first.name}" in effect.phrase:
        return clause
    return f"{clause}, with a {first.name.replace('_', ' ')} of {format_quantity(size, first.unit)}"


def largest_size(effect: Effect) -> float:
    """Return the bound of an effect's first parameter on the side of its typical value."""
    size = effect.parameters[0]
    return size.upper if effect.typical[size.name] > 0 else size.lower


def scaled_effect(effect: Effect, size: float) -> dict[str, float]:
    """Return an effect's parameters at a size: its typical shape, with all signed parameters scaled along."""
    first = effect.parameters[0]
    factor = size / effect.typical[first.name]
    values = {}
    for p in effect.parameters:
        value = effect.typical.get(p.name, p.default)
        if p is first or (p.default == 0.0 and p.lower < 0.0 < p.upper):
            value = float(np.clip(value * factor, p.lower, p.upper))
        values[p.name] = value
    return values
