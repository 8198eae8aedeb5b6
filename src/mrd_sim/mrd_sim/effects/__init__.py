"""The catalogue of effects: one file and one line each."""

from collections.abc import Sequence

from mrd_base import InputError
from mrd_sim.effects import coil_lag, moving_mass, series_compliance
from mrd_sim.effects.effect import STAGES, Effect, Stage

EFFECTS: dict[str, Effect] = {
    module.EFFECT.id: module.EFFECT
    for module in (
        coil_lag,
        series_compliance,
        moving_mass,
    )
}


def find_effects(names: Sequence[str]) -> tuple[Effect, ...]:
    """Effects by their ids.

    Raises
    ------
    InputError
        When one is not known or named twice; lists those there are.
    """
    for name in names:
        if name not in EFFECTS:
            raise InputError(f"unknown effect {name} (known: {', '.join(EFFECTS)})")
        if list(names).count(name) > 1:
            raise InputError(f"effect {name} is named twice, expected once")
    return tuple(EFFECTS[name] for name in names)


__all__ = ["EFFECTS", "STAGES", "Effect", "Stage", "find_effects"]
