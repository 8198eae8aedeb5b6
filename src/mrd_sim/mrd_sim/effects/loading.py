"""Effects of a user's own, one a file."""

import importlib.util
import re
import string
import sys
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_sim.effects.effect import STAGES, Effect


def read_effects(folder: str | Path) -> dict[Path, Effect]:
    """Import every ``*.py`` of a folder that assigns ``EFFECT``, and try it.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    dict
        Effect by file.

    Raises
    ------
    InputError
        For a folder without effects; a file that fails when it is imported, or whose effect fails when it is used or is not
        neutral at its defaults.
    """
    try:
        files = [file for file in sorted(Path(folder).iterdir()) if file.suffix == ".py"]
        files = [file for file in files if re.search(r"^EFFECT\b", file.read_text(encoding="utf-8"), re.MULTILINE)]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{folder}: cannot be read ({_line(error)})") from None
    if not files:
        raise InputError(f"{folder}: no effects, expected *.py files that assign EFFECT")
    return {file: _read(file) for file in files}


def _read(file: Path) -> Effect:
    """The effect of one file."""
    name = f"mrd_effect_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file may raise
        raise InputError(f"{file}: cannot be imported ({_line(error)})") from None
    effect = module.EFFECT
    if not isinstance(effect, Effect):
        raise InputError(f"{file}: EFFECT is {type(effect).__name__}, expected mrd_sim.effects.Effect")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", effect.id):
        raise InputError(f"{file}: id is {effect.id!r}, expected lower-case letters, digits and _")
    if effect.stage not in STAGES:
        raise InputError(f"{file}: stage is {effect.stage!r}, expected one of {', '.join(STAGES)}")
    if (effect.kernel is None) == (effect.stretch is None):
        raise InputError(f"{file}: expected either kernel or stretch")
    for p in effect.parameters:
        value = effect.typical.get(p.name, p.default)
        if not p.lower <= p.default <= p.upper or not p.lower <= value <= p.upper:
            found = f"default {p.default:g}, typical {value:g}"
            raise InputError(f"{file}: {p.name} has {found}, expected both within its bounds, {p.lower:g} to {p.upper:g}")
    if not 1 <= len(effect.parameters) <= 4:
        raise InputError(f"{file}: has {len(effect.parameters)} parameters, expected one to four")
    names = [p.name for p in effect.parameters]
    try:
        named = [field for _, field, _, _ in string.Formatter().parse(effect.phrase) if field is not None]
    except ValueError as error:
        raise InputError(f"{file}: phrase {effect.phrase!r} cannot be filled in ({error})") from None
    if not set(named) <= set(names):
        raise InputError(f"{file}: phrase {effect.phrase!r} names {', '.join(named)}, expected among {', '.join(names)}")
    _try(file, effect)
    return effect


def _try(file: Path, effect: Effect) -> None:
    """Use an effect on a few samples."""
    p = np.array([parameter.default for parameter in effect.parameters])
    for called in (effect.kernel, effect.stretch):
        if called is not None and not hasattr(called, "py_func"):
            raise InputError(f"{file}: {called.__name__} is not compiled, expected numba's @njit")
    try:
        if effect.stretch is not None:
            changed = effect.stretch(p, 0.0, 1e-3, 100.0, 0.01) != 0.0
        else:
            assert effect.kernel is not None
            before = np.linspace([-0.01, 0.1, 1.0, 0.5, 100.0], [0.01, 0.2, 2.0, 1.0, 300.0], 4).T
            signals = before.copy()
            effect.kernel(p, np.zeros(effect.states), np.array([0.0, 1e-3, 1e-3, 2e-3]), *signals)
            changed = not np.allclose(signals, before, rtol=1e-9, atol=1e-12)
    except Exception as error:  # numba's among them, of many lines
        raise InputError(f"{file}: the effect fails ({_line(error)})") from None
    if changed:
        raise InputError(f"{file}: the effect acts at its parameters' defaults, expected neutral ones")


def _line(error: Exception) -> str:
    """What is wrong, in one line."""
    words = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split()
    text = f"{type(error).__name__}: {' '.join(words)}"
    return text if len(text) <= 300 else f"{text[:300]}…"
