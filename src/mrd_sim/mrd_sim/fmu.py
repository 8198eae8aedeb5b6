"""A damper model with its parameters as a co-simulation FMU (Functional Mock-up Interface 2.0 and 3.0)."""

import io
import os
import platform
import shlex
import subprocess
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from pathlib import Path
from string import Template
from xml.etree import ElementTree

from mrd_base import InputError
from mrd_sim.c_code import c_source, template
from mrd_sim.models import DamperModel

INPUTS = {
    "position": ("m", "of the rod, > 0 extends"),
    "velocity": ("m/s", "of the rod"),
    "acceleration": ("m/s2", "of the rod"),
    "current": ("A", "through the coil"),
}
"""Unit and meaning of the FMU's inputs; `slave.c` has the same order."""

SIMULATOR_FORCE = {"simulator_force": ("N", "of the simulator whose force is corrected")}
"""The further input of the FMU of a model that stands for a simulator of the user's own."""

VERSIONS = (2, 3)
"""Versions of the standard in which an FMU can be written."""

_PLATFORMS = {
    ("Linux", "x86_64"): "linux64",
    ("Windows", "AMD64"): "win64",
    ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "darwin64",
}
_SUFFIXES = {"Windows": ".dll", "Darwin": ".dylib"}
_MACHINES = {"AMD64": "x86_64", "arm64": "aarch64"}

ENTRY_FILES = {2: "fmi2.c", 3: "fmi3.c"}
"""C file with the functions of the interface, which includes the others."""


def fmu_archive(
    model: DamperModel, values: Mapping[str, float], plain: Mapping[str, float] | None = None, version: int = 2
) -> bytes:
    """Return the content of an .fmu file: description, C sources and their binary for this platform.

    Parameters
    ----------
    model : DamperModel
    values : mapping
        Parameters by name in SI; those not given keep the model's default.
    plain : mapping, optional
        See `mrd_sim.c_code.c_source`; the FMU then has the input ``simulator_force`` as well.
    version : {2, 3}
        Of the standard.

    Raises
    ------
    InputError
        For an unknown parameter or a value out of bounds; without a C compiler (``$CC``, else ``cc``).

    Notes
    -----
    Inputs are the motion and the coil's current, in SI. The output is the force at the same communication point. The
    parameters are tunable. ``slave.c`` describes what the binary does with them.
    """
    damper = c_source(model, values, plain=plain)
    guid = guid_of(damper, version)
    simulator = {"simulator": "SIMULATOR, ", "simulator_now": ", s->now[SIMULATOR]"} if model.stands_for else {}
    sources = {
        "damper.c": damper,
        "slave.c": Template(template("slave.c")).substitute({"simulator": "", "simulator_now": "", **simulator}),
        "parameter.c": template("parameter.c"),
        ENTRY_FILES[version]: Template(template(ENTRY_FILES[version])).substitute(guid=guid, slave="slave.c"),
    }
    return packed(model_description(model, values, guid, version), model.id, sources, version)


def guid_of(text: str, version: int) -> str:
    """Return the identifier of an FMU, which its description and its binary share: the same for the same text."""
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, f'{version}{text}')}}}"


def packed(
    description: bytes, identifier: str, sources: Mapping[str, str], version: int, others: Mapping[str, bytes] | None = None
) -> bytes:
    """Return the content of an .fmu file.

    Parameters
    ----------
    description : bytes
        Content of modelDescription.xml.
    identifier : str
        Model identifier, the name of the binary.
    sources : mapping
        C files by name; the file of `ENTRY_FILES` includes the others.
    version : {2, 3}
    others : mapping, optional
        Further files by path.

    Raises
    ------
    InputError
        Without a C compiler, or where it fails.
    """
    binary = f"binaries/{platform_folder(version)}/{identifier}{_SUFFIXES.get(platform.system(), '.so')}"
    files = {
        "modelDescription.xml": description,
        binary: _compiled(sources, ENTRY_FILES[version]),
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        **(others or {}),
    }
    if version == 3:
        files["sources/buildDescription.xml"] = _build_description(identifier)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as stream:
        for name, content in files.items():
            # A fixed date: the same fit gives the same file.
            stream.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def platform_folder(version: int) -> str:
    """Return the name that the standard gives to this platform, as of the folder of a binary."""
    system, machine = platform.system(), platform.machine()
    in_pairs = f"{_MACHINES.get(machine, machine)}-{system}".lower()
    return in_pairs if version == 3 else _PLATFORMS.get((system, machine), in_pairs)


def model_description(model: DamperModel, values: Mapping[str, float], guid: str, version: int = 2) -> bytes:
    """Return the content of modelDescription.xml."""
    effects = [f"with {effect.title}: {effect.equation}" for effect in model.effects]
    is_2 = version == 2
    root = ElementTree.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": model.id,
            "guid" if is_2 else "instantiationToken": guid,
            "generationTool": "mrd_sim",
            "description": "; ".join([f"{model.title}: {model.equation}", *effects]),
            "variableNamingConvention": "flat",
        },
    )
    slave = ElementTree.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": model.id,
            "canHandleVariableCommunicationStepSize": "true",
            **({"canNotUseMemoryManagementFunctions": "true"} if is_2 else {}),
            "canGetAndSetFMUstate" if is_2 else "canGetAndSetFMUState": "true",
        },
    )
    if is_2:
        name_sources(slave)
    units = ElementTree.SubElement(root, "UnitDefinitions")
    inputs = INPUTS | (SIMULATOR_FORCE if model.stands_for else {})
    used = [parameter.unit for parameter in model.parameters] + [unit for unit, _ in inputs.values()] + ["N"]
    for unit in sorted(set(used) - {""}):
        ElementTree.SubElement(units, "Unit", name=unit)
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError")
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stepSize="0.001")
    variables = ElementTree.SubElement(root, "ModelVariables")
    add_parameters(variables, 0, model, model.vector(values).tolist(), version)
    first = len(variables)
    for name, (unit, meaning) in inputs.items():
        add_variable(variables, len(variables), name, "input", "continuous", meaning, version, unit=unit, start="0")
    force = len(variables)
    add_variable(
        variables, force, "force", "output", "continuous", "of the damper, > 0 resists extension", version, unit="N"
    )
    structure = ElementTree.SubElement(root, "ModelStructure")
    if is_2:
        known = " ".join(str(1 + reference) for reference in range(first, force))
        ElementTree.SubElement(
            ElementTree.SubElement(structure, "Outputs"), "Unknown", index=str(1 + force), dependencies=known
        )
        ElementTree.SubElement(ElementTree.SubElement(structure, "InitialUnknowns"), "Unknown", index=str(1 + force))
    else:
        add_variable(variables, force + 1, "time", "independent", "continuous", "", version, unit="s")
        ElementTree.SubElement(units, "Unit", name="s") if "s" not in used else None
        known = " ".join(map(str, range(first, force)))
        ElementTree.SubElement(structure, "Output", valueReference=str(force), dependencies=known)
        ElementTree.SubElement(structure, "InitialUnknown", valueReference=str(force))
    return written(root)


def written(root: ElementTree.Element) -> bytes:
    """Return the text of a description."""
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def name_sources(slave: ElementTree.Element) -> None:
    """Name the C file that a tool compiles, as FMI 2 does it in the description."""
    ElementTree.SubElement(ElementTree.SubElement(slave, "SourceFiles"), "File", name=ENTRY_FILES[2])


def add_parameters(
    variables: ElementTree.Element, first: int, model: DamperModel, values: list[float], version: int, begin: int = 0
) -> None:
    """Add the parameters of a model to the variables of a description.

    Parameters
    ----------
    variables : Element
        ModelVariables.
    first : int
        Value reference of the first one.
    model : DamperModel
    values : list of float
        Of all its parameters, in SI.
    version : {2, 3}
    begin : int
        Number of the first parameter that is added.
    """
    for reference, (parameter, value) in enumerate(list(zip(model.parameters, values, strict=True))[begin:], start=first):
        add_variable(
            variables,
            reference,
            parameter.name,
            "parameter",
            "tunable",
            parameter.meaning,
            version,
            unit=parameter.unit,
            start=repr(float(value)),
            min=repr(parameter.limits[0]),
            max=repr(parameter.limits[1]),
        )


def add_variable(
    variables: ElementTree.Element,
    reference: int,
    name: str,
    causality: str,
    variability: str,
    meaning: str,
    version: int,
    **number: str,
) -> None:
    """Add a floating-point variable to a description; ``number`` is what is said of its value."""
    of_value = {key: value for key, value in number.items() if value}
    variable = ElementTree.SubElement(
        variables,
        "ScalarVariable" if version == 2 else "Float64",
        name=name,
        valueReference=str(reference),
        causality=causality,
        variability=variability,
        description=meaning,
    )
    if version == 2:
        ElementTree.SubElement(variable, "Real", of_value)
    else:
        variable.attrib.update(of_value)


def _build_description(identifier: str) -> bytes:
    """Return the content of buildDescription.xml, which names the C file in FMI 3."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    ElementTree.SubElement(files, "SourceFile", name=ENTRY_FILES[3])
    return written(root)


def _compiled(sources: Mapping[str, str], entry: str) -> bytes:
    compiler = shlex.split(os.environ.get("CC", "")) or ["cc"]
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        options = ["-std=c99", "-O2", "-fPIC", "-fvisibility=hidden", "-shared", "-o", "binary", entry, "-lm"]
        if platform.system() == "Linux":
            options.append("-ldl")  # where dlopen is no part of the C library
        try:
            done = subprocess.run([*compiler, *options], cwd=folder, capture_output=True, text=True, check=False)
        except OSError as error:
            raise InputError(
                f"C compiler {compiler[0]}: cannot be run ({error.strerror}), but an FMU holds a compiled damper; "
                "install one (Debian: gcc) or name it in CC; a .c file needs none"
            ) from None
        if done.returncode:
            reason = next((line for line in done.stderr.splitlines() if "error" in line), f"status {done.returncode}")
            raise InputError(f"C compiler {shlex.join(compiler)}: failed ({reason})")
        return Path(folder, "binary").read_bytes()
