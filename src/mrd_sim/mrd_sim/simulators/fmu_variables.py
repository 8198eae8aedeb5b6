"""Which variables of an FMU are motion, current, force and parameters, and in which units."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mrd_base import InputError
from mrd_runs.importing.units import UNITS, find_unit, is_unit

SIGNALS = ("time", "position", "velocity", "acceleration", "current")
"""What can be fed to an FMU, in the order of `mrd_sim.simulators.simulator.Signals`."""

_NAMES = {
    "time": ("time",),
    "position": ("position", "displacement", "travel", "stroke", "pos", "disp", "x", "s"),
    "velocity": ("velocity", "speed", "vel", "v", "xd", "dx", "xdot", "der_x", "v_rel"),
    "acceleration": ("acceleration", "acc", "a", "xdd", "ddx"),
    "current": ("current", "coil_current", "coilcurrent", "i", "cur", "amps"),
    "force": ("force", "damper_force", "damping_force", "f", "fd", "f_mr", "f_d"),
}
"""Names that stand for a quantity, in lower case, the plainest first."""

_UNITS_IN_NAMES = re.compile(r"_(m|mm|mps|m_s|mm_s|mps2|a|ma|n|kn)$", re.IGNORECASE)
"""A unit at the end of a name."""

_NO_UNITS = ("1", "-", "dimensionless")

_NUMBERS = {"2.0": ("Real",), "3.0": ("Float64",)}
"""Types of floating-point variables by version of the standard."""


@dataclass(frozen=True)
class FmuVariables:
    """Variables of an FMU.

    Attributes
    ----------
    inputs : tuple of (str, int, float)
        Quantity of `SIGNALS`, value reference, and factor from SI to the variable's unit.
    starts : tuple of float
        Value of each of these inputs at the start, in the variable's unit.
    mapping : mapping
        Name of the variable of each quantity, the force among them.
    units : mapping
        Unit of each of these variables; empty where neither the FMU nor the name states one.
    kept : tuple of str
        Inputs that keep their start value.
    output : int
        Value reference of the force.
    factor : float
        From the unit of the output to N.
    parameters : mapping
        Value reference, value, bounds (None for none) and unit of each number that may be set, by name.
    """

    inputs: tuple[tuple[str, int, float], ...]
    starts: tuple[float, ...]
    mapping: Mapping[str, str]
    units: Mapping[str, str]
    kept: tuple[str, ...]
    output: int
    factor: float
    parameters: Mapping[str, tuple[int, float, float | None, float | None, str]]


def find_variables(description: Any, inputs: Mapping[str, str], output: str) -> FmuVariables:
    """Find motion, current, force and parameters among the variables of an FMU.

    Parameters
    ----------
    description : fmpy.model_description.ModelDescription
    inputs : mapping
        Variable of each quantity where its name does not tell, by quantity.
    output : str
        Variable of the force; empty where its name tells.

    Raises
    ------
    InputError
        When a variable does not exist, is no floating-point number, or it is not clear what an input is.
    """
    variables = [v for v in description.modelVariables if v.type in _NUMBERS[description.fmiVersion] and not v.dimensions]
    ins = {v.name: v for v in variables if v.causality == "input"}
    outs = {v.name: v for v in variables if v.causality == "output"}
    chosen = _chosen_inputs(ins, inputs)
    if "position" not in chosen and "velocity" not in chosen:
        raise InputError(
            f"no input is a position or a velocity (inputs: {_listed(ins)}); name them with --inputs position=VARIABLE,..."
        )
    inputs_of_any_type = [v for v in description.modelVariables if v.causality == "input"]
    left = [v for v in inputs_of_any_type if v.name not in chosen.values()]
    if unknown := [v.name for v in left if v.start is None]:
        raise InputError(
            f"the input {unknown[0]} is none of {', '.join(SIGNALS)} by its name, and has no start value to keep; name "
            f"what it is with --inputs QUANTITY={unknown[0]}"
        )
    force = _chosen_output(outs, output)
    return FmuVariables(
        tuple((quantity, ins[name].valueReference, 1.0 / _factor(quantity, ins[name])) for quantity, name in chosen.items()),
        tuple(float(ins[name].start or 0.0) for name in chosen.values()),
        {**chosen, "force": force.name},
        {
            quantity: _unit_of(quantity, v)
            for quantity, v in [*((q, ins[name]) for q, name in chosen.items()), ("force", force)]
        },
        tuple(v.name for v in left),
        force.valueReference,
        _factor("force", force),
        {
            v.name: (v.valueReference, float(v.start), _number(v.min), _number(v.max), _unit(v))
            for v in variables
            if v.causality == "parameter" and v.variability in ("fixed", "tunable") and v.start is not None
        },
    )


def _chosen_inputs(ins: Mapping[str, Any], named: Mapping[str, str]) -> dict[str, str]:
    """Return the input of each quantity: those that are named, then those whose name or unit tells. A quantity that is named
    without a variable has none.
    """
    for quantity, name in named.items():
        if quantity not in SIGNALS:
            raise InputError(f"--inputs: unknown quantity {quantity} (known: {', '.join(SIGNALS)})")
        if name and name not in ins:
            raise InputError(f"--inputs: no input {name} (inputs: {_listed(ins)})")
    chosen = dict(named)
    for quantity in SIGNALS:
        if quantity in chosen:
            continue
        free = [name for name in ins if name not in chosen.values()]
        if name := _found(quantity, {name: ins[name] for name in free}):
            chosen[quantity] = name
    return {quantity: chosen[quantity] for quantity in SIGNALS if chosen.get(quantity)}


def _chosen_output(outs: Mapping[str, Any], named: str) -> Any:
    if named:
        if named not in outs:
            raise InputError(f"--output-variable: no output {named} (outputs: {_listed(outs)})")
        return outs[named]
    name = _found("force", outs) or (next(iter(outs)) if len(outs) == 1 else "")
    if not name:
        raise InputError(f"no output is a force by its name (outputs: {_listed(outs)}); name it with --output-variable NAME")
    return outs[name]


def _found(quantity: str, variables: Mapping[str, Any]) -> str:
    """Return the variable whose name or unit tells that it has a quantity; empty where none does."""
    fitting = [name for name, variable in variables.items() if not _is_of_another(quantity, _unit(variable))]
    return _by_name(quantity, fitting) or _by_unit(quantity, variables)


def _is_of_another(quantity: str, unit: str) -> bool:
    """Return whether a unit is one of other quantities only: an input T in K is no time."""
    return bool(unit) and is_unit(unit) and find_unit(quantity, unit) is None


def _by_name(quantity: str, names: Sequence[str]) -> str:
    """Return the name that stands for a quantity most plainly; empty where none does, or two as plainly."""
    if quantity == "time" and "t" in names:  # T is a temperature
        return "t"
    for word in _NAMES[quantity]:
        found = [name for name in names if _plain(name) == word]
        if found:
            return found[0] if len(found) == 1 else ""
    words = [word for word in _NAMES[quantity] if len(word) > 3]
    found = [name for name in names if any(word in re.split(r"[\W_\d]+", name.lower()) for word in words)]
    return found[0] if len(found) == 1 else ""


def _plain(name: str) -> str:
    """Return the last part of a name without brackets and a unit: ``damper.x_m`` is x."""
    last = re.split(r"[.\[\]/]", name.rstrip("]"))[-1].lower()
    return re.sub(r"_(si|in|out)$", "", _UNITS_IN_NAMES.sub("", last))


def _by_unit(quantity: str, variables: Mapping[str, Any]) -> str:
    """Return the only variable with a unit of a quantity; empty where none or several have one."""
    found = [name for name, variable in variables.items() if _unit(variable) and find_unit(quantity, _unit(variable))]
    return found[0] if len(found) == 1 and quantity != "time" else ""


def _unit(variable: Any) -> str:
    """Return the unit that a variable or its type states; empty where they state none."""
    stated = variable.unit or (variable.declaredType.unit if variable.declaredType else None) or ""
    return "" if stated in _NO_UNITS else str(stated)


def _unit_of(quantity: str, variable: Any) -> str:
    """Return the unit in which a variable has a quantity: the stated one, or else the one in its name; empty without any."""
    stated = _unit(variable)
    if not stated:
        in_name = _UNITS_IN_NAMES.search(variable.name)
        return (find_unit(quantity, in_name[1]) if in_name else None) or ""
    unit = find_unit(quantity, stated)
    if unit is None:
        known = ", ".join(list(UNITS[quantity])[:6])
        raise InputError(f"variable {variable.name} is in {stated}, expected a {quantity} ({known}, ...)")
    return unit


def _factor(quantity: str, variable: Any) -> float:
    """Return the factor from the unit of a variable to SI; 1 where it has none."""
    unit = _unit_of(quantity, variable)
    return UNITS[quantity][unit] if unit else 1.0


def _number(text: str | None) -> float | None:
    return None if text is None else float(text)


def _listed(variables: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} in {_unit(v)}" if _unit(v) else name for name, v in variables.items()) or "none"
