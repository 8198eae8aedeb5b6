"""A user's own damper models, one a file."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim.dual_type import LANES, as_duals
from mrd_sim.effects.loading import files_that_assign, import_from, in_one_line
from mrd_sim.models.model import DamperModel
from mrd_sim.path import make_path

Array = NDArray[np.float64]

TINY = 1e-9
"""Part of the largest force by which two ways to the same force may differ."""


def read_models(folder: str | Path) -> dict[Path, DamperModel]:
    """Import every ``*.py`` of a folder that assigns ``MODEL``, and try the model.

    Returns
    -------
    dict
        Model by file.

    Raises
    ------
    InputError
        For a folder without models, for a file that fails when it is imported, and for a model without a property that every
        model has, or that it claims to have. The line says which property.
    """
    files = files_that_assign("MODEL", folder)
    if not files:
        raise InputError(f"{folder}: no damper models, expected *.py files that assign MODEL")
    return {file: _read(file) for file in files}


def _read(file: Path) -> DamperModel:
    model = import_from("MODEL", file)
    if not isinstance(model, DamperModel):
        raise InputError(f"{file}: MODEL is {type(model).__name__}, expected mrd_sim.models.DamperModel")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", model.id):
        raise InputError(f"{file}: id is {model.id!r}, expected lower-case letters, digits and _")
    for p in model.parameters:
        if not (p.lower < p.upper or (p.is_constant and not p.free)) or not p.lower <= p.default <= p.upper:
            raise InputError(
                f"{file}: {p.name} has the default {p.default:g}, expected one within its bounds, {p.lower:g} to {p.upper:g}"
            )
    if not hasattr(model.kernel, "py_func"):
        raise InputError(f"{file}: {model.kernel.__name__} is not compiled, expected numba's @njit")
    try:
        wrong = missing_property(model)
    except Exception as error:  # numba's among them, of many lines
        raise InputError(f"{file}: the model fails ({in_one_line(error)})") from None
    if wrong:
        raise InputError(f"{file}: {wrong}")
    return model


def missing_property(model: DamperModel) -> str:
    """Return the property of damper models that a model lacks, in a line that says what to do; empty where it has all.

    It is tried on two tones, one after the other with growing current, at the default parameters and at the bounds.
    """
    time = np.arange(1500) / 500.0
    w, u = 2 * np.pi * 1.0, 2 * np.pi * 3.0
    x = 8e-3 * np.sin(w * time) + 2e-3 * np.sin(u * time)
    v = 8e-3 * w * np.cos(w * time) + 2e-3 * u * np.cos(u * time)
    a = -8e-3 * w**2 * np.sin(w * time) - 2e-3 * u**2 * np.sin(u * time)
    path = make_path(time, x, v, a, np.full(len(time), 0.3))
    sets = {
        "default": model.defaults,
        "lower": np.array([p.lower for p in model.parameters]),
        "upper": np.array([p.upper for p in model.parameters]),
    }
    for name, theta in sets.items():
        force = model.force(theta, path)
        if not np.isfinite(force).all():
            return f"the force is not finite at the parameters' {name} values; change the bounds or the equation"
        for first in range(0, len(theta), LANES):
            moved = as_duals(theta)
            for lane, place in enumerate(range(first, min(first + LANES, len(theta)))):
                moved.derivatives[place, lane] = 1.0
            found = as_duals(model.force(moved, path))
            if not np.allclose(found.real, force, rtol=0, atol=TINY * (1 + np.abs(force).max())):
                return "the force differs with a derivative; compare numbers by their .real"
            for parameter, derivative in zip(model.parameters[first : first + LANES], found.derivatives.T, strict=False):
                if not np.isfinite(derivative).all():
                    return f"the derivative to {parameter.name} is not finite at the {name} values; use mrd_sim.dual"
    force = model.force(model.defaults, path)
    return _claims(model, force, (time, x, v, a))


def _claims(model: DamperModel, force: Array, motion: tuple[Array, ...]) -> str:
    """Return which of the properties that a model claims it lacks at its defaults; its ``force`` there is known."""
    time, x, v, a = motion
    current = np.full(len(time), 0.3)
    turned = model.force(model.defaults, make_path(time, -x, -v, -a, current))
    offset = sum(values for name, values in model.at_current(model.defaults, 0.3).items() if name == "offset")
    if model.odd and not np.allclose(force - offset, offset - turned, rtol=0, atol=TINY * (1 + np.abs(force).max())):
        return "turning the motion round does not turn the force round; write odd=False if that is meant"
    cycle = slice(len(time) // 3 * 2, None)  # the last of three cycles: what the first one stores does not count
    if model.dissipative and np.mean((force - offset)[cycle] * v[cycle]) < 0:
        return "a closed cycle yields energy at the defaults; write dissipative=False if that is meant"
    return ""
