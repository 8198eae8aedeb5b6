"""The catalogue of control laws: one file and one line each."""

from importlib import import_module

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_control.laws.law import Law, Signals

LAWS: dict[str, Law] = {
    name: import_module(f"mrd_control.laws.{name}").LAW
    for name in (
        "constant_current",
        "skyhook_on_off",
        "skyhook",
        "groundhook",
        "hybrid",
        "acceleration_driven",
        "mixed_skyhook_add",
        "clipped_lqr",
        "clipped_lqg",
        "force_tracking",
    )
}
"""Catalogue, by id. Each entry is the file of its name."""


def find_law(name: str) -> Law:
    """Return a law by its id.

    Raises
    ------
    InputError
        For an unknown law; lists the known ones.
    """
    if name not in LAWS:
        raise InputError(f"unknown law {unknown_key(name, LAWS)}")
    return LAWS[name]


__all__ = ["LAWS", "Law", "Signals", "find_law"]
