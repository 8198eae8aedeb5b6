"""The catalogue of damper models: one file and one line each."""

from mrd_base import InputError
from mrd_sim.models import bingham, bouc_wen, linear_viscous, modified_bouc_wen, polynomial
from mrd_sim.models.model import DamperModel, Parameter, Quantity

MODELS: dict[str, DamperModel] = {
    module.MODEL.id: module.MODEL
    for module in (
        linear_viscous,
        bingham,
        polynomial,
        bouc_wen,
        modified_bouc_wen,
    )
}


def find_model(name: str) -> DamperModel:
    """Model by its id.

    Raises
    ------
    InputError
        When there is none; lists those there are.
    """
    try:
        return MODELS[name]
    except KeyError:
        raise InputError(f"unknown model {name} (known: {', '.join(MODELS)})") from None


__all__ = ["MODELS", "DamperModel", "Parameter", "Quantity", "find_model"]
