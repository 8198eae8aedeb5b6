"""Free travel in the damper's joint, against a film."""

from numba import njit

from mrd_trials.truth.effects.play import offset_in_play
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

PLAY, RESISTANCE = size("play", 3e-4, 2e-3), shape("resistance", 15e3, 40e3, logarithmic=True)

EFFECT = TrueEffect(
    "joint_play",
    "Free travel in the damper's joint",
    (
        development(
            "film", "crossing slows down in proportion to the film that is left", PLAY, RESISTANCE, shared=("play",)
        ),
        development(
            "elastic", "dead zone between elastic flanks (Nordin & Gutman 2002)", PLAY, RESISTANCE, shared=("play",)
        ),
        evaluation(
            "reynolds",
            "film that resists with its thickness to the power -3 (Reynolds 1886)",
            PLAY,
            RESISTANCE,
            shared=("play",),
        ),
        evaluation(
            "sigmoid", "tanh of the force without memory (Merzouki & Cadiou 2005)", PLAY, shape("turning_force", 40.0, 120.0)
        ),
    ),
    in_series=True,
)


@njit(cache=True, nogil=True)
def joint_offset(p: PlantValues, offset: float, force: float, step: float) -> float:
    """Return the offset (m) of the joint from the middle of its play after a step."""
    resistance, turning = p.joint_play_resistance, p.joint_play_turning_force
    return float(offset_in_play(p.joint_play_formula, offset, p.joint_play_play, force, resistance, 0.0, turning, step))
