"""The catalogue of damper models: one file and one line each."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_runs.scales import REFERENCE, Scales
from mrd_sim.effects import find_effects
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.loading import read_models
from mrd_sim.models.model import DamperModel
from mrd_sim.parameter import Parameter

MODELS: dict[str, DamperModel] = {
    name: import_module(f"mrd_sim.models.{name}").MODEL
    for name in (
        "linear_viscous",
        "bingham",
        "quasi_static",
        "biviscous",
        "hysteretic_biviscous",
        "polynomial",
        "hyperbolic_tangent",
        "algebraic",
        "sigmoid",
        "bouc_wen",
        "normalised_bouc_wen",
        "modified_bouc_wen",
        "shear_thinning_bouc_wen",
        "modified_dahl",
        "modified_lugre",
        "gamota_filisko",
    )
}
"""Catalogue, by id. Each entry is the file of its name."""

_SHIPPED = frozenset(MODELS)

MODEL_FOLDERS: dict[str, str] = {}
"""Folder of each model of the user's own, by id."""


def find_model(
    name: str, laws: str | Mapping[str, str] | None = None, effects: Sequence[str] = (), scales: Scales = REFERENCE
) -> DamperModel:
    """Return a model by its id, with current laws as in `DamperModel.with_laws` and effects by their ids.

    Its ranges are those for a damper of the given scales.

    Raises
    ------
    InputError
        For an unknown model, law, coefficient or effect; lists the known ones.
    """
    if name not in MODELS:
        raise InputError(f"unknown model {unknown_key(name, MODELS)}")
    model = MODELS[name].with_laws(laws) if laws else MODELS[name]
    model = model.scaled(scales)
    return model.with_effects(find_effects(effects, scales)) if effects else model


def restored(name: str, laws: Mapping[str, str], effects: Sequence[str], scales: Scales, stands_for: str) -> DamperModel:
    """Return the model that has been pickled as these."""
    return replace(find_model(name, laws, effects, scales), stands_for=stands_for)


def load_models(folder: str | Path) -> tuple[DamperModel, ...]:
    """Add a user's own models to this process's catalogue: one from every ``*.py`` of a folder that assigns ``MODEL``.

    A model that is loaded again replaces the former one.

    Raises
    ------
    InputError
        When a model cannot be used, or its id is in use; names the file.
    """
    loaded: dict[str, DamperModel] = {}
    for file, model in read_models(folder).items():
        if model.id in _SHIPPED or model.id in loaded:
            raise InputError(f"{file}: there is a model {model.id} already, expected another id")
        loaded[model.id] = model
    MODELS.update(loaded)
    MODEL_FOLDERS.update(dict.fromkeys(loaded, str(folder)))
    return tuple(loaded.values())


__all__ = ["MODELS", "MODEL_FOLDERS", "Coefficient", "DamperModel", "Parameter", "find_model", "load_models", "restored"]
