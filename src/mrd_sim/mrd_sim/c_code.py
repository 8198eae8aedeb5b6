"""A damper model with its parameters and effects as one self-contained C file.

The C functions are translated from the Python source of those that the simulator itself runs: the model's kernel, the
current laws, the coil lag, the effects and whatever they call. So the equations are written once, in Python, and C follows
them. Only the search for the force of a damper with elements in series is written in C as well: without the derivatives that
Newton's method needs.
"""

import re
import textwrap
from collections.abc import Mapping, Sequence
from importlib import resources
from string import Template

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim import current
from mrd_sim.c_translation import CUnit, c_comment, c_number, wrapped
from mrd_sim.effects import Effect, Stage
from mrd_sim.models import DamperModel
from mrd_sim.path import Path
from mrd_sim.series_elements import SHORTEST_STEP

_DAMPER = ("double *",) * 7
_KERNEL = ("double *",) * 8
_ELONGATION = ("double *", "double", "double", "double", "double")
"""C types of the parameters of a damper model's kernel, an effect's kernel and an elongation, whatever their annotations."""


def c_source(
    model: DamperModel, values: Mapping[str, float], prefix: str = "mrd", plain: Mapping[str, float] | None = None
) -> str:
    """Translate a damper model into C99.

    Parameters
    ----------
    model : DamperModel
    values : mapping
        Parameters by name in SI; those not given keep the model's default.
    prefix : str
        Beginning of the names that other C files see, so that several dampers fit into one program.
    plain : mapping, optional
        For a model that stands for a simulator of the user's own (`DamperModel.stands_for`): its parameters by name with
        which it reproduces that simulator without effects. ``<prefix>_step`` then has the simulator's force as its last
        argument, and returns it with the effects.

    Returns
    -------
    str
        A file that needs nothing but the C library. ``<prefix>_init`` makes a damper at rest with these parameters.
        ``<prefix>_step`` advances it to the next sample and returns the force that `DamperModel.force` has there along
        `make_path`: the measured one, with all effects of the model.

    Raises
    ------
    InputError
        For an unknown parameter, a value out of bounds, a prefix that is no C name, an effect that needs the temperature, or
        code that cannot be translated.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        raise InputError(f"prefix {prefix!r} is not a C name, expected letters, digits and _")
    if model.needs_temperature:
        effects = ", ".join(effect.id for effect in model.effects if effect.coefficients is not None)
        raise InputError(f"{effects} needs the temperature, which exported code is not given; export without it")
    theta = model.vector(values)
    names = [coefficient.name for coefficient in model.coefficients]
    unit = CUnit(names, {f"{prefix}_{name}" for name in ("init", "step", "state", "parameter", "parameters")})
    lag, laws = (unit.function(function).name for function in (current.lagged_current, current.evaluate_coefficients))
    kernel = unit.function(model.kernel, _DAMPER).name
    state = _state_at_rest(model)
    before = _acting(model, ("drive", "magnetics"), "current", prefix, unit)
    after = _acting(model, ("fluid", "structure", "sensing"), "effective", prefix, unit)
    series = _series(model, len(state), prefix, unit) if model.series_elements else ""
    alone = f"{kernel}(1, q, s->inner + 2, &p->dt, &p->x, &p->v, &p->a, &p->force);\n    p->force += added;"
    return Template(template("damper.c")).substitute(
        p=prefix,
        P=prefix.upper(),
        title=c_comment(model.title),
        equation=_comment(model.equation, " *   "),
        source=_comment(f"Source: {model.source}"),
        effects="".join(_comment(f"With {effect.title}: {effect.equation}") + "\n" for effect in model.effects),
        example=_identifier(prefix, model.names[0]),
        indices="\n".join(
            f"    {_identifier(prefix, p.name)},  /* {c_comment(f'{p.unit}: {p.meaning}' if p.unit else p.meaning)} */"
            for p in model.parameters
        ),
        table="\n".join(
            f'    {{"{p.name}", "{p.unit}", {c_number(value)}, {c_number(p.limits[0])}, {c_number(p.limits[1])}}},'
            for p, value in zip(model.parameters, theta, strict=True)
        ),
        states=len(state),
        start="".join(f"    s->inner[{index}] = {c_number(state[index])};\n" for index in np.flatnonzero(state)),
        columns=textwrap.fill(", ".join(unit.columns.values()), 100, initial_indent="    ", subsequent_indent="    "),
        codes=", ".join(map(str, model.law_codes)),
        law_columns=", ".join(str(index) for row in model.law_columns for index in row),
        floors=", ".join(map(c_number, model.floors)),
        functions=unit.text,
        series=series,
        before=before,
        lag=lag,
        laws=laws,
        damper="p->force = force_in_series(s, q, added, p->dt, p->x, p->v, p->a);" if series else alone,
        after=after,
        **_simulator_parts(
            model, plain, prefix, lag, laws, kernel, slice(len(state) - len(model.series_elements) - 1, len(state) - 1)
        ),
    )


_SIMULATOR_PARTS = (
    "simulator_argument",
    "plain_state",
    "simulator_comment",
    "simulator_parameter",
    "plain_function",
    "find_excess",
    "keep_excess",
    "through_declaration",
    "through",
)


def _simulator_parts(
    model: DamperModel, plain: Mapping[str, float] | None, prefix: str, lag: str, laws: str, kernel: str, elongations: slice
) -> dict[str, str]:
    """Return the parts of the C file that add the force of a simulator of the user's own; empty ones without it."""
    if not model.stands_for:
        return {**dict.fromkeys(_SIMULATOR_PARTS, ""), "added": "0.0"}
    parameters = ", ".join(c_number(value) for value in model.alone.vector(plain or {}))
    places = {name: str(model.alone.names.index(name)) for name in ("coil_lag", "mid_stroke")}
    return {
        "simulator_argument": ", simulator_force",
        "simulator_parameter": ", double simulator",
        "simulator_comment": " * The last argument is the simulator's force (N) at the sample; returned is this force with "
        "the effects.\n",
        "plain_state": Template(template("through_state.c")).substitute(p=prefix, states=2 + model.states),
        "added": "i + 1 < count ? (1.0 - share) * s->excess + share * excess : excess",
        "keep_excess": "    s->excess = excess;\n",
        "plain_function": Template(template("plain.c")).substitute(
            p=prefix, P=prefix.upper(), parameters=parameters, lag=lag, laws=laws, kernel=kernel, **places
        ),
        "find_excess": template("excess.c"),
        "through_declaration": Template(template("through_declaration.c")).substitute(p=prefix),
        "through": Template(template("through.c")).substitute(
            p=prefix, P=prefix.upper(), first=elongations.start, last=elongations.stop
        ),
    }


def _state_at_rest(model: DamperModel) -> NDArray[np.float64]:
    """Return the state in which a damper begins; refuse one that depends on the path, which C does not know yet."""
    first = np.zeros(1, dtype=np.intp)
    here, there = (Path(np.zeros(1), at, at, at, at, first) for at in (np.zeros(1), np.ones(1)))
    for effect in model.effects:
        if effect.begin is not None and not np.array_equal(effect.begin(here), effect.begin(there)):
            raise InputError(f"effect {effect.id}: a state that begins with the path's motion has no translation to C")
    return model.initial_state(here)


def _acting(model: DamperModel, stages: Sequence[Stage], current: str, prefix: str, unit: CUnit) -> str:
    """Return calls of the effects of some stages; ``current`` is the one of a vertex that is theirs."""
    signals = ("&p->dt", "&p->x", "&p->v", "&p->a", f"&p->{current}", "&p->force")
    calls = [
        (unit.function(effect.kernel, _KERNEL).name, _parameters(prefix, effect), f"s->inner + {states.start}")
        for stage in stages
        for effect, states in zip(model.effects, model.effect_states, strict=True)
        if effect.stage == stage and effect.kernel is not None
    ]
    return "".join(wrapped(f"    {name}(", ["1", *own, *signals], ");") + "\n" for name, *own in calls)


def _series(model: DamperModel, states: int, prefix: str, unit: CUnit) -> str:
    """Return the search for the force of the damper and the elements in series with it."""
    elements = model.series_elements
    return Template(template("series.c")).substitute(
        p=prefix,
        elements=len(elements),
        elongations=states - len(elements) - 1,
        shortest=c_number(SHORTEST_STEP),
        states=2 + model.states,
        elongate="".join(
            wrapped(
                f"        t.elongations[{index}] = {unit.function(element.elongation, _ELONGATION).name}(",
                ["1", _parameters(prefix, element), f"t.elongations[{index}]", "dt", "force", "x"],
                ");",
            )
            + "\n"
            for index, element in enumerate(elements)
        ),
        kernel=unit.function(model.kernel, _DAMPER).name,
    )


def _parameters(prefix: str, effect: Effect) -> str:
    """Return a pointer to an effect's parameters."""
    return f"s->parameters + {_identifier(prefix, f'{effect.id}.{effect.parameters[0].name}')}"


def _identifier(prefix: str, name: str) -> str:
    """Return the C name of a parameter's index."""
    return f"{prefix}_{name}".upper().replace(".", "_")


def _comment(text: str, indent: str = " * ") -> str:
    """Return lines of a comment."""
    return textwrap.fill(c_comment(text), 100, initial_indent=indent, subsequent_indent=" *   ")


def template(name: str) -> str:
    """Return a C template of the package."""
    return resources.files("mrd_sim").joinpath("c", name).read_text(encoding="utf-8")
