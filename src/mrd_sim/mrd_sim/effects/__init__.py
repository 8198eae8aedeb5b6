"""The catalogue of effects: one file and one line each."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_runs.scales import REFERENCE, Scales
from mrd_sim.effects.effect import FAULTS, NEEDS, PLACES, STAGES, Effect, Place, Stage
from mrd_sim.effects.loading import read_effects

EFFECTS: dict[str, Effect] = {
    name: import_module(f"mrd_sim.effects.{name}").EFFECT
    for name in (
        "lvdt_nonlinearity",
        "servo_ripple",
        "backlash",
        "current_sensor_error",
        "magnetic_hysteresis",
        "current_saturation",
        "coil_lag",
        "fluid_change",
        "gas_loss",
        "gas_spring",
        "series_compliance",
        "bypass_flow",
        "cavitation",
        "flow_asymmetry",
        "shear_thinning",
        "rate_dependent_hysteresis",
        "pre_yield_hysteresis",
        "thermal_fade",
        "temperature_dependence",
        "settling",
        "seal_friction",
        "side_load_friction",
        "hardening_spring",
        "end_stop",
        "joint_play",
        "moving_mass",
        "load_cell_gain",
        "load_cell_drift",
        "force_sensor_lag",
        "channel_crosstalk",
        "channel_delay",
        "mains_hum",  # last: its phase is that of the recorded force
    )
}
"""Catalogue, by id. Each entry is the file of its name."""

_SHIPPED = frozenset(EFFECTS)

EFFECT_FOLDERS: dict[str, str] = {}
"""Folder of each effect of the user's own, by id."""


def find_effects(names: Sequence[str], scales: Scales = REFERENCE) -> tuple[Effect, ...]:
    """Return effects by their ids, in the order of the catalogue whatever that of the names; a user's own come last.

    Their ranges are those for a damper of the given scales.

    Raises
    ------
    InputError
        When a name is not known, or given twice; lists the known ones.
    """
    for name in names:
        if name not in EFFECTS:
            raise InputError(f"unknown effect {unknown_key(name, EFFECTS)}")
        if list(names).count(name) > 1:
            raise InputError(f"effect {name} is named twice, expected once")
    return tuple(effect.scaled(scales) for name, effect in EFFECTS.items() if name in names)


def load_effects(folder: str | Path) -> tuple[Effect, ...]:
    """Add a user's own effects to this process's catalogue: one from every ``*.py`` of a folder that assigns ``EFFECT``.

    An effect that is loaded again replaces the former one.

    Raises
    ------
    InputError
        When an effect cannot be used, or its id is in use; names the file.
    """
    loaded: dict[str, Effect] = {}
    for file, effect in read_effects(folder).items():
        if effect.id in _SHIPPED or effect.id in loaded:
            raise InputError(f"{file}: there is an effect {effect.id} already, expected another id")
        loaded[effect.id] = effect
    EFFECTS.update(loaded)
    EFFECT_FOLDERS.update(dict.fromkeys(loaded, str(folder)))
    return tuple(loaded.values())


__all__ = [
    "EFFECTS",
    "EFFECT_FOLDERS",
    "FAULTS",
    "NEEDS",
    "PLACES",
    "STAGES",
    "Effect",
    "Place",
    "Stage",
    "find_effects",
    "load_effects",
]
