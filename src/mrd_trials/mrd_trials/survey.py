"""What simpler methods say of a gap: the peers that a diagnosis is measured against, on the same recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnose import fit_base
from mrd_diagnosis.effect_search import BaseFit, refit_with_effects, score_effects
from mrd_diagnosis.refit import Refit
from mrd_diagnosis.weighting import Weighting, with_effect
from mrd_identification.parallel import in_threads
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Survey:
    """A model refitted alone and with every effect.

    Attributes
    ----------
    rankings : mapping
        Effects from the best on, by method; "" stands where the method prefers no effect to those after it.
    closed : mapping
        Share of the explainable gap, on parts held out in turn, that each effect closes.
    """

    rankings: Mapping[str, tuple[str, ...]]
    closed: Mapping[str, float]


def survey(runs: Sequence[Run], model: str, seed: int = 0) -> Survey:
    """Refit the model with every effect alone, and rank the effects by five simpler methods.

    ``correlation``: the largest correlation of the residual with what the effect at its typical size changes, nothing being
    refitted. ``score``: the squared residual that the effect would take, what the model can imitate taken out.
    ``in_sample``: the squared residual that it leaves after the refit. ``bic``: the same, with a penalty of log(samples) for
    each parameter, as if all samples were independent. ``random``: by lot.

    Parameters
    ----------
    runs : sequence of Run
        In the order in which they were recorded.
    model : str
    seed : int
    """
    effects = list(EFFECTS)
    rng = np.random.default_rng(seed)
    weighting, alone, _, _ = fit_base(find_model(model), None, in_threads(prepare_recording, runs), rng)
    base_fit = BaseFit.of(weighting, alone)
    trials = refit_with_effects(weighting, base_fit, effects, len(effects))
    fits = {trial.effects[-1]: trial.refit for trial in trials}
    samples, total = len(alone.problem.force), float(alone.cost.sum())
    bic = {
        name: samples * np.log(fit.cost.sum() / total) + _added(fit, alone) * np.log(samples) for name, fit in fits.items()
    }
    promised = {name: found.gain for name, found in zip(effects, score_effects(weighting, base_fit, effects), strict=True)}
    alike = dict(zip(effects, in_threads(lambda name: _correlation(weighting, alone, name), effects), strict=True))
    in_sample = {name: float(fit.cost.sum()) for name, fit in fits.items()}
    lot = [str(name) for name in rng.permutation(sorted(fits))]
    floor = np.concatenate([noise.sigma for noise in weighting.noises]) ** 2
    gap = float(alone.held_out_squares.sum() - floor.sum())
    return Survey(
        {
            "correlation": _ranked({name: -value for name, value in alike.items()}),
            "score": _ranked({name: -value for name, value in promised.items()}),
            "in_sample": _ranked(in_sample | {"": total}),
            "bic": _ranked(bic | {"": 0.0}),
            "random": tuple(lot),
        },
        {
            name: float((alone.held_out_squares - fit.held_out_squares).sum()) / gap if gap > 0 else np.nan
            for name, fit in fits.items()
        },
    )


def _added(fit: Refit, alone: Refit) -> int:
    return len(fit.problem.free) - len(alone.problem.free)


def _correlation(weighting: Weighting, alone: Refit, name: str) -> float:
    """Of the raw residual with the change that the effect makes at its typical size."""
    model, theta = with_effect(alone.problem.model, alone.theta, name)
    typical = {f"{name}.{key}": value for key, value in EFFECTS[name].typical.items()}
    changed = np.array([typical.get(key, value) for key, value in zip(model.names, theta, strict=True)])
    problem = weighting.problem(model, theta)
    change, error = problem.forces(changed) - problem.forces(theta), -problem.errors(theta)
    spread = float(np.std(change) * np.std(error))
    return abs(float(np.mean((change - change.mean()) * (error - error.mean())))) / spread if spread > 0 else 0.0


def _ranked(worth: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(worth, key=lambda name: worth[name]))
