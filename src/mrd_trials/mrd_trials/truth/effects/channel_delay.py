"""The force channel comes late."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

WANDER, SKEW, BEAT = range(3)

WANDERING = 0.15
"""Relative amplitude of a wandering delay."""

SAWTOOTH = 0.4
"""Range of a delay that beats, over its mean."""

DELAY = size("delay", 8.5e-3, 50e-3)

EFFECT = TrueEffect(
    "channel_delay",
    "Force channel comes late",
    (
        development(
            "wander",
            "the load of the computer makes it wander (Cristian 1989)",
            DELAY,
            shape("period", 2.0, 8.0),
            shared=("delay",),
        ),
        development("skew", "clocks run apart during a run (Mills 1991)", DELAY, shape("skew", 0.004, 0.02)),
        evaluation("beat", "polling at another rate: a sawtooth", DELAY, shape("period", 1.5, 6.0), shared=("delay",)),
    ),
)


def delayed_force(p: PlantValues, time: Array, force: Array) -> Array:
    """Return the force of a run as late as its channel brings it; ``time`` (s) is since the start of the run."""
    delay = p.channel_delay_delay
    if delay == 0.0:
        return force
    if p.channel_delay_formula == SKEW:
        late = delay * (1.0 + p.channel_delay_skew * time)
    elif p.channel_delay_formula == BEAT:
        late = delay * (1.0 + SAWTOOTH * (time / p.channel_delay_period % 1.0 - 0.5))
    else:
        late = delay * (1.0 + WANDERING * np.sin(2 * np.pi * time / p.channel_delay_period))
    return np.interp(time - late, time, force)
