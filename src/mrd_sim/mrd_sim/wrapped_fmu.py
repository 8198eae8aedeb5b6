"""The FMU of a simulator of the user's own with effects around it, as one FMU.

It has the variables of the user's FMU, and carries that FMU in its resources. Effects before the damper change the motion
and the current that the inner FMU gets; effects behind it change its force. ``wrapper.c`` describes how.
"""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any
from xml.etree import ElementTree

from mrd_base import InputError
from mrd_sim.c_code import c_source, template
from mrd_sim.c_translation import c_number
from mrd_sim.fmu import ENTRY_FILES, INPUTS, add_parameters, add_variable, guid_of, name_sources, packed, written
from mrd_sim.models import DamperModel
from mrd_sim.simulators.adjusted import AdjustedSimulator
from mrd_sim.simulators.process import ProcessSimulator
from mrd_sim.simulators.simulator import Simulator

FOLDER = "resources/inner/"
"""Folder in the archive that holds the files of the inner FMU."""

DERIVED = ("velocity", "acceleration")
"""Quantities that follow from the others where the inner FMU does not get them."""

_ABILITIES = {
    2: ("canRunAsynchronuously", "canInterpolateInputs", "canSerializeFMUstate", "providesDirectionalDerivative"),
    3: (
        "canSerializeFMUState",
        "providesDirectionalDerivatives",
        "providesAdjointDerivatives",
        "providesPerElementDependencies",
        "providesIntermediateUpdate",
        "mightReturnEarlyFromDoStep",
        "canReturnEarlyAfterIntermediateUpdate",
        "hasEventMode",
        "providesEvaluateDiscreteStates",
    ),
}
"""Abilities that the wrapper does not have, though the inner FMU may."""


@dataclass(frozen=True)
class WrappedFmu:
    """An FMU around one of the user's.

    Attributes
    ----------
    content : bytes
        Of the .fmu file.
    version : str
        Of the standard, such as ``FMI 2.0``: that of the user's FMU.
    notes : tuple of str
        What is to be known of it.
    """

    content: bytes
    version: str
    notes: tuple[str, ...]


def wrapped_simulator(
    simulator: Simulator, model: DamperModel, values: Mapping[str, float], plain: Mapping[str, float]
) -> WrappedFmu:
    """Return an FMU that carries a user's FMU, and has the effects of a model that stands for it around it.

    Parameters
    ----------
    simulator : Simulator
        The user's FMU, as opened, with the values of its parameters.
    model : DamperModel
        Model that stands for it, with effects.
    values, plain : mapping
        Parameters by name in SI with the effects, and those with which the model reproduces the simulator without.

    Raises
    ------
    InputError
        For a simulator that is no FMU; as of `mrd_sim.c_code.c_source`; without a C compiler.
    """
    settings = simulator.values
    while isinstance(simulator, AdjustedSimulator):
        simulator = simulator.simulator
    if not isinstance(simulator, ProcessSimulator) or "standard" not in simulator.facts:
        raise InputError(
            f"--simulator: {simulator.name} is not an FMU, and only an FMU can be put into one; take a block instead"
        )
    content = _wrapped(simulator.file, simulator.facts, model, values, plain, settings)
    return WrappedFmu(content, simulator.facts["standard"], _notes(simulator, model, settings))


def _notes(simulator: ProcessSimulator, model: DamperModel, settings: Mapping[str, float]) -> tuple[str, ...]:
    """Return what is to be known of an FMU around a simulator's."""
    facts, notes = simulator.facts, []
    if settings:
        listed = ", ".join(f"{name} = {value:g}" for name, value in settings.items())
        notes.append(f"Parameters of {simulator.name} start from the values that were set: {listed}.")
    if added := _own_inputs(facts):
        notes.append(f"Inputs of its own, which {simulator.name} lacks and effects need: {', '.join(added)}. Connect them.")
    if derived := [name for name in DERIVED if name not in facts["inputs"]]:
        notes.append(f"{simulator.name} has no {' and no '.join(derived)}; effects get the difference from step to step.")
    if model.series_elements:
        named = " and ".join(effect.id for effect in model.series_elements)
        give = "give way" if len(model.series_elements) > 1 else "gives way"
        notes.append(
            f"{named} {give} under the force with which {simulator.name} answers: it is asked several times in a step."
            if facts["feedthrough"]
            else f"{named} {give} under the force of the model {model.id}, which stands for {simulator.name}, and of what "
            "this had beyond the model a few steps before, because it answers only after a step."
        )
    return tuple(notes)


def _wrapped(
    file: Path,
    facts: Mapping[str, Any],
    model: DamperModel,
    values: Mapping[str, float],
    plain: Mapping[str, float],
    settings: Mapping[str, float],
) -> bytes:
    """Return the content of the .fmu file; ``facts`` are what the process of the simulator says of it."""
    version = int(facts["standard"].split()[-1][0])
    with zipfile.ZipFile(file) as archive:
        inner = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    root = ElementTree.fromstring(inner["modelDescription.xml"])
    slave = _only_co_simulation(root, version)
    variables = root.find("ModelVariables")
    assert variables is not None  # the process has read it
    identifier, guid = slave.get("modelIdentifier", ""), root.get("guid" if version == 2 else "instantiationToken", "")
    references = [int(variable.get("valueReference", "0")) for variable in variables]
    own = _own_inputs(facts)
    first_own = max(references, default=-1) + 1
    first = first_own + len(own)
    theta = model.vector(values)
    damper = c_source(model, values, plain=plain)
    wired = {quantity: rest for quantity, *rest in facts["wiring"]}
    wired |= {name: [first_own + number, 1.0, 0.0] for number, name in enumerate(own)}
    kinds = {name: "OF_INNER" if name in facts["inputs"] else "OWN" if name in own else "DERIVED" for name in INPUTS}
    quantities = [wired.get(name, [0, 1.0, 0.0]) for name in INPUTS]
    by_name = {variable.get("name"): variable for variable in variables}
    set_references = [by_name[name].get("valueReference", "0") for name in settings]
    force, factor = facts["output"]
    filled = {
        "at_once": str(int(facts["feedthrough"])),
        "in_series": str(int(bool(model.series_elements))),
        "first_effect": str(len(model.alone.parameters)),
        "origins": ", ".join(kinds.values()),
        "references": ", ".join(str(reference) for reference, _, _ in quantities),
        "factors": ", ".join(c_number(factor) for _, factor, _ in quantities),
        "starts": ", ".join(c_number(start / factor) for _, factor, start in quantities),
        "force_reference": str(force),
        "first_reference": str(first),
        "force_factor": c_number(factor),
        "settings": str(len(settings)),
        "set_references": ", ".join(set_references) or "0",
        "set_values": ", ".join(map(c_number, settings.values())) or "0.0",
    }
    own_guid = guid_of(f"{guid}{damper}{filled}", version)
    inner_file = f"inner{version}.c"
    fillings: dict[str, dict[str, str]] = {
        "wrapper.c": {**filled, "inner": inner_file},
        inner_file: {"identifier": identifier, "inner_guid": _c_text(guid)},
        ENTRY_FILES[version]: {"guid": own_guid, "slave": "wrapper.c"},
    }
    sources = {"damper.c": damper, **{name: template(name) for name in ("library.c", "parameter.c")}}
    sources |= {name: Template(template(name)).substitute(filling) for name, filling in fillings.items()}

    slave.set("modelIdentifier", f"{identifier}_corrected")
    root.set("guid" if version == 2 else "instantiationToken", own_guid)
    root.set("modelName", f"{root.get('modelName', identifier)} corrected")
    root.set("generationTool", f"mrd_sim, around one of {root.get('generationTool') or 'another tool'}")
    for name, value in settings.items():
        number = by_name[name].find("Real") if version == 2 else by_name[name]
        assert number is not None
        number.set("start", repr(value))
    taken = set(by_name)
    for name in own:
        unit, meaning = INPUTS[name]
        free = _free_name(name, taken)
        add_variable(variables, wired[name][0], free, "input", "continuous", meaning, version, unit=unit, start="0")
    begin = len(model.alone.parameters)
    add_parameters(variables, first, model, theta.tolist(), version, begin)
    _add_units(root, [parameter.unit for parameter in model.parameters[begin:]] + [INPUTS[name][0] for name in own])
    _free_dependencies(root, force, 1 + [v.get("name") for v in variables].index(facts["mapping"]["force"]), version)
    others = {f"{FOLDER}{name}": content for name, content in inner.items()}
    return packed(written(root), f"{identifier}_corrected", sources, version, others)


def _own_inputs(facts: Mapping[str, Any]) -> list[str]:
    """Return the inputs of the wrapper that the inner FMU does not have, and that do not follow from the others."""
    return [name for name in INPUTS if name not in facts["inputs"] and name not in DERIVED]


def _only_co_simulation(root: ElementTree.Element, version: int) -> ElementTree.Element:
    """Reduce a description to co-simulation with the abilities that the wrapper has; return the element of it."""
    for name in ("ModelExchange", "ScheduledExecution"):
        for element in root.findall(name):
            root.remove(element)
    slave = root.find("CoSimulation")
    assert slave is not None  # the process has stepped it
    for element in list(slave):
        slave.remove(element)
    for ability in _ABILITIES[version]:
        slave.attrib.pop(ability, None)
    for order in ("maxOutputDerivativeOrder", "recommendedIntermediateInputSmoothness"):
        slave.attrib.pop(order, None)
    if version == 2:
        name_sources(slave)
    return slave


def _add_units(root: ElementTree.Element, used: Sequence[str]) -> None:
    """Add the units that a description does not define yet."""
    units = root.find("UnitDefinitions")
    if units is None:
        units = ElementTree.Element("UnitDefinitions")
        root.insert(1 + [child.tag for child in root].index("CoSimulation"), units)
    known = {unit.get("name") for unit in units}
    for unit in sorted(set(used) - {""} - known):
        ElementTree.SubElement(units, "Unit", name=unit)
    if not len(units):
        root.remove(units)


def _free_dependencies(root: ElementTree.Element, reference: int, index: int, version: int) -> None:
    """Let the force depend on all inputs, as effects may let it."""
    structure = root.find("ModelStructure")
    place = ("index", str(index)) if version == 2 else ("valueReference", str(reference))
    for unknown in structure.iter() if structure is not None else ():
        if unknown.get(place[0]) == place[1]:
            unknown.attrib.pop("dependencies", None)
            unknown.attrib.pop("dependenciesKind", None)


def _free_name(name: str, taken: set[str | None]) -> str:
    while name in taken:
        name += "_"
    return name


def _c_text(text: str) -> str:
    """Return a text as it stands between the quotes of C."""
    return text.replace("\\", "\\\\").replace('"', '\\"')
