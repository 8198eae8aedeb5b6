"""A user's own effects, one a file."""

import importlib.util
import re
import string
import sys
from pathlib import Path
from typing import Any

import numpy as np

from mrd_base import InputError
from mrd_sim.effects.effect import FAULTS, NEEDS, PLACES, STAGES, Effect
from mrd_sim.series_elements import MOST_PARAMETERS

LONGEST_MESSAGE = 300
"""Characters of another library's message that fit into one line of ours."""


def read_effects(folder: str | Path) -> dict[Path, Effect]:
    """Import every ``*.py`` of a folder that assigns ``EFFECT``, and try the effect.

    Returns
    -------
    dict
        Effect by file.

    Raises
    ------
    InputError
        For a folder without effects, for a file that fails when it is imported, and for an effect that fails when it is
        used or is not neutral at its defaults.
    """
    files = files_that_assign("EFFECT", folder)
    if not files:
        raise InputError(f"{folder}: no effects, expected *.py files that assign EFFECT")
    return {file: _read(file) for file in files}


def files_that_assign(name: str, folder: str | Path) -> list[Path]:
    """Return the ``*.py`` files of a folder that assign a name; `InputError` for a folder that cannot be read."""
    try:
        files = [file for file in sorted(Path(folder).iterdir()) if file.suffix == ".py"]
        return [file for file in files if re.search(rf"^{name}\b", file.read_text(encoding="utf-8"), re.MULTILINE)]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{folder}: cannot be read ({in_one_line(error)})") from None


def _read(file: Path) -> Effect:
    effect = import_from("EFFECT", file)
    if not isinstance(effect, Effect):
        raise InputError(f"{file}: EFFECT is {type(effect).__name__}, expected mrd_sim.effects.Effect")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", effect.id):
        raise InputError(f"{file}: id is {effect.id!r}, expected lower-case letters, digits and _")
    if effect.stage not in STAGES:
        raise InputError(f"{file}: stage is {effect.stage!r}, expected one of {', '.join(STAGES)}")
    for field, known in (("shows", PLACES), ("needs", NEEDS), ("imitated_by", FAULTS)):
        for entry in getattr(effect, field):
            if entry not in known:
                raise InputError(f"{file}: {field} holds {entry!r}, expected any of {', '.join(known)}")
    _check_parameters(file, effect)
    _check_phrase(file, effect)
    _check_function(file, effect)
    return effect


def import_from(attribute: str, file: Path) -> Any:
    """Import a user's file and return what it assigns to a name; `InputError` when it cannot be imported."""
    name = f"mrd_{attribute.lower()}_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file may raise
        raise InputError(f"{file}: cannot be imported ({in_one_line(error)})") from None
    return getattr(module, attribute)


def _check_parameters(file: Path, effect: Effect) -> None:
    for p in effect.parameters:
        value = effect.typical.get(p.name, p.default)
        if not p.lower <= p.default <= p.upper or not p.lower <= value <= p.upper:
            values = f"default {p.default:g}, typical {value:g}"
            raise InputError(f"{file}: {p.name} has {values}, expected both within its bounds, {p.lower:g} to {p.upper:g}")
    if not 1 <= len(effect.parameters) <= MOST_PARAMETERS:
        raise InputError(f"{file}: has {len(effect.parameters)} parameters, expected one to {MOST_PARAMETERS}")


def _check_phrase(file: Path, effect: Effect) -> None:
    names = [p.name for p in effect.parameters]
    try:
        used = [field for _, field, _, _ in string.Formatter().parse(effect.phrase) if field is not None]
    except ValueError as error:
        raise InputError(f"{file}: phrase {effect.phrase!r} cannot be filled in ({error})") from None
    if not set(used) <= set(names):
        raise InputError(f"{file}: phrase {effect.phrase!r} names {', '.join(used)}, expected among {', '.join(names)}")


def _check_function(file: Path, effect: Effect) -> None:
    """Refuse a function that is not compiled, that fails on a few samples, or that acts at the defaults."""
    functions: list[Any] = [given for given in (effect.kernel, effect.elongation, effect.coefficients) if given is not None]
    if len(functions) != 1:
        raise InputError(f"{file}: has {len(functions)} of kernel, elongation and coefficients, expected one")
    (function,) = functions
    if not hasattr(function, "py_func"):
        raise InputError(f"{file}: {function.__name__} is not compiled, expected numba's @njit")
    defaults = np.array([parameter.default for parameter in effect.parameters])
    try:
        if effect.coefficients is not None:
            rows = np.ones((4, 3))
            function(defaults, np.arange(3), np.linspace(250.0, 350.0, 4), rows)
            changed = not np.allclose(rows, 1.0, rtol=1e-9)
        elif effect.kernel is None:
            changed = function(defaults, 0.0, 1e-3, 100.0, 0.01) != 0.0
        else:
            before = np.linspace([-0.01, 0.1, 1.0, 0.5, 100.0], [0.01, 0.2, 2.0, 1.0, 300.0], 4).T
            signals = before.copy()
            function(defaults, np.zeros(effect.states), np.array([0.0, 1e-3, 1e-3, 2e-3]), *signals)
            changed = not np.allclose(signals, before, rtol=1e-9, atol=1e-12)
    except Exception as error:  # numba's among them, of many lines
        raise InputError(f"{file}: the effect fails ({in_one_line(error)})") from None
    if changed:
        raise InputError(f"{file}: the effect acts at its parameters' defaults, expected neutral ones")


def in_one_line(error: Exception) -> str:
    """Return an error in one line, without the colours that numba adds."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split()
    text = f"{type(error).__name__}: {' '.join(plain)}"
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE]}…"
