"""Another form of the damper model in the place of an effect: what is missing may be no effect at all."""

from collections.abc import Iterator

import numpy as np

from mrd_identification.gap.ground import Ground, first_fit
from mrd_identification.gap.refit import Refit, refit
from mrd_identification.problem import current_levels, pose
from mrd_sim.models import MODELS, DamperModel, find_model

OTHERS = (
    "hyperbolic_tangent", "algebraic", "sigmoid", "bouc_wen", "modified_bouc_wen", "shear_thinning_bouc_wen",
    "modified_dahl", "modified_lugre",
)
"""Models with a loop of different shape."""

STARTS = 20
"""Random points from which each is fitted: a form that needs more of them is no easy explanation."""


def forms(ground: Ground, base: DamperModel, enough: float, rng: np.random.Generator) -> dict[str, Refit]:
    """Refits, by name, of the base with more freedom and of other models, on the same ground, until one explains the gap.

    Parameters
    ----------
    ground : Ground
    base : DamperModel
    enough : float
        Mean squared error beyond noise, over the variance of noise, that an explanation may leave.
    rng : numpy Generator
    """
    found = {}
    for name, model, freed in _variants(ground, base):
        plain, _ = pose(model, ground.recordings, fixed=ground.fixed, freed=freed)
        start = first_fit(plain, None, rng, STARTS, 1)
        found[name] = refit(ground.problem(model, start, freed), start, ground.parts)
        if found[name].level - 1.0 <= enough:
            break
    return found


def _variants(ground: Ground, base: DamperModel) -> Iterator[tuple[str, DamperModel, tuple[str, ...]]]:
    levels, _ = current_levels([recording.run for recording in ground.recordings])
    freed = tuple(parameter.name for parameter in base.parameters if not parameter.free)
    if freed and base.id != "quasi_static":  # whose fixed parameters are its dimensions
        yield f"{base.id} with {', '.join(freed)} freed", base, freed
    if levels > 2 and any(law == "affine" for law in base.laws.values()):
        yield f"{base.id} with quadratic current laws", find_model(base.id, "quadratic"), ()
    for name in OTHERS:
        if name != base.id:
            yield name, MODELS[name], ()
