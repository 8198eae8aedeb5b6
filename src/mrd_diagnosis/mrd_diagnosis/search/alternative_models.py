"""Alternative models: another damper model in the place of effects, because what is missing may be no effect at all."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base.progress import ignore
from mrd_diagnosis.fitting.base_fit import fit_base, global_fit
from mrd_diagnosis.fitting.refit import Refit, refit
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import make_problem
from mrd_identification.recording import Recording, current_levels
from mrd_sim.models import DamperModel, find_model

Array = NDArray[np.float64]
Progress = Callable[[float], None]

OTHER_MODELS = (
    "hyperbolic_tangent",
    "algebraic",
    "sigmoid",
    "bouc_wen",
    "modified_bouc_wen",
    "shear_thinning_bouc_wen",
    "modified_dahl",
    "modified_lugre",
)
"""Models whose hysteresis loop has another shape."""

RANDOM_STARTS = 20
"""Random points from which each is fitted: a model that needs more of them is no simple explanation."""

EVALUATIONS = 15
"""Evaluations of a model with more freedom, from where it was fitted without."""


def fit_alternative_models(
    weighting: Weighting, base: Refit, enough: float, rng: np.random.Generator, progress: Progress = ignore
) -> dict[str, Refit]:
    """Refit the base model with more freedom and other models, by name, until one of them explains the gap.

    Parameters
    ----------
    weighting : Weighting
    base : Refit
        The model without effects.
    enough : float
        Excess of the reduced chi-square over 1 that an explanation may leave.
    rng : numpy Generator
    progress : callable
        Called with the fraction of the work that is done at most, before each model.
    """
    refits: dict[str, Refit] = {}
    alternatives = list(_alternatives(weighting, base))
    for place, (name, model, freed, start) in enumerate(alternatives):
        progress(place / len(alternatives))
        plain, _ = make_problem(model, weighting.recordings, fixed=weighting.fixed, freed=freed)
        if start is None:
            theta = global_fit(plain, None, rng, RANDOM_STARTS, 1)
        else:
            theta = fit_least_squares(plain, start, EVALUATIONS)[0]
        refits[name] = refit(weighting.problem(model, theta, freed), theta, weighting.folds)
        if refits[name].chi_square - 1.0 <= enough:
            break
    return refits


def best_model(
    start: DamperModel, recordings: Sequence[Recording], rng: np.random.Generator, progress: Progress = ignore
) -> DamperModel:
    """Return the damper model that predicts held-out folds of recordings best, without effects and more freedom.

    Parameters
    ----------
    start : DamperModel
        Model with which the noise is estimated.
    recordings : sequence of Recording
    rng : numpy Generator
    progress : callable
        As of `fit_alternative_models`.
    """
    fit = fit_base(start, None, recordings, rng)
    others = fit_alternative_models(fit.weighting, fit.base, -np.inf, rng, progress)
    # The diagnosis would go on without the freedom of a model with more parameters fitted.
    refits = [fit.base, *(refitted for refitted in others.values() if all(p.free for p in refitted.problem.parameters))]
    return min(refits, key=lambda refitted: refitted.held_out_cost).problem.model


_AlternativeModel = tuple[str, DamperModel, tuple[str, ...], Array | None]
"""Name, model, parameters that are searched although they usually are not, and the start of the fit if it is known."""


def _alternatives(weighting: Weighting, base: Refit) -> Iterator[_AlternativeModel]:
    model = base.problem.model
    levels, _ = current_levels([recording.run for recording in weighting.recordings])
    freed = tuple(parameter.name for parameter in model.parameters if not (parameter.free or parameter.is_constant))
    if freed and model.id != "quasi_static":  # its fixed parameters are its dimensions
        yield f"{model.id} with {', '.join(freed)} fitted too", model, freed, base.theta
    if levels > 2 and any(law == "affine" for law in model.laws.values()):
        quadratic = model.with_laws("quadratic")
        values = dict(zip(model.names, base.theta, strict=True))
        start = np.array([values.get(parameter.name, parameter.default) for parameter in quadratic.parameters])
        yield f"{model.id} with quadratic current laws", quadratic, (), start
    for name in OTHER_MODELS:
        if name != model.id:
            yield name, find_model(name, scales=model.scales), (), None
