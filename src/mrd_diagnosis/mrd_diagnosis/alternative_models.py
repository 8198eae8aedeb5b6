"""Another form of the damper model in the place of an effect: what is missing may be no effect at all."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.refit import Refit, refit
from mrd_diagnosis.weighting import Ground, first_fit
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import make_problem
from mrd_identification.recording import current_levels
from mrd_sim.models import MODELS, DamperModel, find_model

Array = NDArray[np.float64]

OTHERS = (
    "hyperbolic_tangent",
    "algebraic",
    "sigmoid",
    "bouc_wen",
    "modified_bouc_wen",
    "shear_thinning_bouc_wen",
    "modified_dahl",
    "modified_lugre",
)
"""Models with a loop of different shape."""

STARTS = 20
"""Random points from which each is fitted: a form that needs more of them is no easy explanation."""

FREED = 15
"""Evaluations of a model with more freedom, from where it has been fitted without."""


def forms(ground: Ground, alone: Refit, enough: float, rng: np.random.Generator) -> dict[str, Refit]:
    """Refits, by name, of the model with more freedom and of other models, on the same ground, until one explains the gap.

    Parameters
    ----------
    ground : Ground
    alone : Refit
        Of the model without effects.
    enough : float
        Mean squared error beyond noise, over the variance of noise, that an explanation may leave.
    rng : numpy Generator
    """
    found = {}
    for name, model, freed, start in _variants(ground, alone):
        plain, _ = make_problem(model, ground.recordings, fixed=ground.fixed, freed=freed)
        begin = first_fit(plain, None, rng, STARTS, 1) if start is None else fit_least_squares(plain, start, FREED)[0]
        found[name] = refit(ground.problem(model, begin, freed), begin, ground.parts)
        if found[name].level - 1.0 <= enough:
            break
    return found


_Variant = tuple[str, DamperModel, tuple[str, ...], Array | None]
"""Name, model, parameters that are searched although they are not usually, and where from if that is known."""


def _variants(ground: Ground, alone: Refit) -> Iterator[_Variant]:
    base = alone.problem.model
    levels, _ = current_levels([recording.run for recording in ground.recordings])
    freed = tuple(parameter.name for parameter in base.parameters if not parameter.free)
    if freed and base.id != "quasi_static":  # whose fixed parameters are its dimensions
        yield f"{base.id} with {', '.join(freed)} freed", base, freed, alone.theta
    if levels > 2 and any(law == "affine" for law in base.laws.values()):
        richer = find_model(base.id, "quadratic")
        values = dict(zip(base.names, alone.theta, strict=True))
        start = np.array([values.get(parameter.name, parameter.default) for parameter in richer.parameters])
        yield f"{base.id} with quadratic current laws", richer, (), start
    for name in OTHERS:
        if name != base.id:
            yield name, MODELS[name], (), None
