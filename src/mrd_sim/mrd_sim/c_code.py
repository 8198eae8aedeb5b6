"""A damper model with its parameters as one self-contained C file.

The C functions are translated from the Python source of those that the simulator itself runs: the model's kernel, the
current laws, the coil lag and whatever they call. So the equations are written once, in Python, and C follows them.
"""

import re
import textwrap
from collections.abc import Mapping
from importlib import resources
from string import Template

from mrd_base import InputError
from mrd_sim import current
from mrd_sim.c_translation import CUnit, c_comment, c_number
from mrd_sim.models import DamperModel


def c_source(model: DamperModel, values: Mapping[str, float], prefix: str = "mrd") -> str:
    """Translate a damper model into C99.

    Parameters
    ----------
    model : DamperModel
    values : mapping
        Parameters by name in SI; those not given keep the model's default.
    prefix : str
        Beginning of the names that other C files see, so that several dampers fit into one program.

    Returns
    -------
    str
        A file that needs nothing but the C library. ``<prefix>_init`` makes a damper at rest with these parameters.
        ``<prefix>_step`` advances it to the next sample and returns the force that `DamperModel.force` has there along
        `make_path`.

    Raises
    ------
    InputError
        For an unknown parameter, a value out of bounds, a prefix that is no C name, a model with effects, or code that
        cannot be translated.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        raise InputError(f"prefix {prefix!r} is no C name, expected letters, digits and _")
    if model.effects:
        effects = ", ".join(effect.id for effect in model.effects)
        raise InputError(f"model {model.id} with effects ({effects}) has no translation to C, expected one without effects")
    theta = model.vector(values)
    names = [coefficient.name for coefficient in model.coefficients]
    unit = CUnit(names, {f"{prefix}_{name}" for name in ("init", "step", "state", "parameter", "parameters")})
    functions = (current.lagged_current, current.evaluate_coefficients, model.kernel)
    lag, laws, kernel = (unit.function(function) for function in functions)
    return Template(template("damper.c")).substitute(
        p=prefix,
        P=prefix.upper(),
        title=c_comment(model.title),
        equation=textwrap.fill(c_comment(model.equation), 100, initial_indent=" *   ", subsequent_indent=" *   "),
        source=textwrap.fill(c_comment(model.source), 100, initial_indent=" * Source: ", subsequent_indent=" *   "),
        example=f"{prefix}_{model.names[0]}".upper(),
        indices="\n".join(
            f"    {f'{prefix}_{p.name}'.upper()},  /* {c_comment(f'{p.unit}: {p.meaning}' if p.unit else p.meaning)} */"
            for p in model.parameters
        ),
        table="\n".join(
            f'    {{"{p.name}", "{p.unit}", {c_number(value)}, {c_number(p.lower)}, {c_number(p.upper)}}},'
            for p, value in zip(model.parameters, theta, strict=True)
        ),
        states=2 + model.states,
        columns=textwrap.fill(", ".join(unit.columns.values()), 100, initial_indent="    ", subsequent_indent="    "),
        codes=", ".join(map(str, model.law_codes)),
        law_columns=", ".join(str(index) for row in model.law_columns for index in row),
        floors=", ".join(map(c_number, model.floors)),
        functions=unit.text,
        lag=lag.name,
        laws=laws.name,
        kernel=kernel.name,
    )


def template(name: str) -> str:
    """Return a C template of the package."""
    return resources.files("mrd_sim").joinpath("c", name).read_text(encoding="utf-8")
