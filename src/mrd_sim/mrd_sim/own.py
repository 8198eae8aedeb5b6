"""Models and effects of the user's own: in the catalogues for one piece of work, and in the next command."""

import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from mrd_sim.effects import EFFECT_FOLDERS, EFFECTS, load_effects
from mrd_sim.models import MODEL_FOLDERS, MODELS, load_models


@contextmanager
def own_catalogue(models_folder: str = "", effects_folder: str = "") -> Iterator[None]:
    """Add the models and effects of the user's own for one piece of work; afterwards the catalogues are as before.

    Parameters
    ----------
    models_folder, effects_folder : str
        Folders as of `load_models` and `load_effects`; empty for none.

    Raises
    ------
    InputError
        When one of them cannot be used; names its file.
    """
    before: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (catalogue, dict(catalogue)) for catalogue in (MODELS, MODEL_FOLDERS, EFFECTS, EFFECT_FOLDERS)
    ]
    try:
        if models_folder:
            load_models(models_folder)
        if effects_folder:
            load_effects(effects_folder)
        yield
    finally:
        for catalogue, entries in before:
            catalogue.clear()
            catalogue.update(entries)


def model_arguments(model: str, laws: str | Mapping[str, str] = "") -> str:
    """Return the options of a tool that name a model and its current laws, where these are not the model's own.

    A mapping has the law of every coefficient, as `DamperModel.laws`. The folders of the user's own models and
    effects follow.
    """
    if not isinstance(laws, str):
        laws = "" if laws == MODELS[model].laws else ",".join(f"{name}={law}" for name, law in laws.items())
    return f"--model {model}" + (f" --law {laws}" if laws else "") + folder_arguments()


def folder_arguments() -> str:
    """Return the options, each after a space, with which another tool knows the user's own models and effects as well."""
    options = [("--models-folder", MODEL_FOLDERS), ("--effects-folder", EFFECT_FOLDERS)]
    return "".join(
        f" {option} {shlex.quote(folder)}" for option, folders in options for folder in dict.fromkeys(folders.values())
    )
