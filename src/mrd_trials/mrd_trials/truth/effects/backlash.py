"""Free travel between drive and damper, against dry friction and grease."""

from numba import njit

from mrd_trials.truth.effects.play import offset_in_play
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

RESISTANCE = 150.0
"""Viscous resistance in N s/m of the grease."""

PLAY, DRAG = size("play", 2e-4, 6e-4), shape("drag", 5.0, 15.0)

EFFECT = TrueEffect(
    "backlash",
    "Free travel between drive and damper",
    (
        development("film", "crossing slows down in proportion to the film that is left", PLAY, DRAG, shared=("play",)),
        development("elastic", "dead zone between elastic flanks (Nordin & Gutman 2002)", PLAY, DRAG, shared=("play",)),
        evaluation(
            "reynolds", "film that resists with its thickness to the power -3 (Reynolds 1886)", PLAY, DRAG, shared=("play",)
        ),
        evaluation(
            "sigmoid", "tanh of the force without memory (Merzouki & Cadiou 2005)", PLAY, shape("turning_force", 15.0, 45.0)
        ),
    ),
    in_series=True,
)


@njit(cache=True, nogil=True)
def backlash_offset(p: PlantValues, offset: float, force: float, step: float) -> float:
    """Return the offset (m) of the drive from the middle of its play after a step."""
    turning = p.backlash_turning_force
    return float(
        offset_in_play(p.backlash_formula, offset, p.backlash_play, force, RESISTANCE, p.backlash_drag, turning, step)
    )
