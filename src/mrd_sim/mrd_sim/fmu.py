"""A damper model with its parameters as a co-simulation FMU (Functional Mock-up Interface 2.0.4)."""

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
"""Unit and meaning of the FMU's inputs; `fmi2.c` has the same order."""

SIMULATOR_FORCE = {"simulator_force": ("N", "of the simulator whose force is corrected")}
"""The further input of the FMU of a model that stands for a simulator of the user's own."""

_PLATFORMS = {
    ("Linux", "x86_64"): "linux64",
    ("Windows", "AMD64"): "win64",
    ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "darwin64",
}
_SUFFIXES = {"Windows": ".dll", "Darwin": ".dylib"}


def fmu_archive(model: DamperModel, values: Mapping[str, float], plain: Mapping[str, float] | None = None) -> bytes:
    """Return the content of an .fmu file: description, C sources and their binary for this platform.

    Parameters
    ----------
    model : DamperModel
    values : mapping
        Parameters by name in SI; those not given keep the model's default.
    plain : mapping, optional
        See `mrd_sim.c_code.c_source`; the FMU then has the input ``simulator_force`` as well.

    Raises
    ------
    InputError
        For an unknown parameter or a value out of bounds; without a C compiler (``$CC``, else ``cc``).

    Notes
    -----
    Inputs are the motion and the coil's current, in SI. The output is the force at the same communication point. The
    parameters are tunable. ``fmi2.c`` describes what the binary does with them.
    """
    damper = c_source(model, values, plain=plain)
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, damper)}}}"
    simulator = {"simulator": "SIMULATOR, ", "simulator_now": ", s->now[SIMULATOR]"} if model.stands_for else {}
    wrapper = Template(template("fmi2.c")).substitute({"guid": guid, "simulator": "", "simulator_now": "", **simulator})
    sources = {"damper.c": damper, "fmi2.c": wrapper}
    system, machine = platform.system(), platform.machine()
    folder = _PLATFORMS.get((system, machine), f"{machine}-{system}".lower())
    binary = f"binaries/{folder}/{model.id}{_SUFFIXES.get(system, '.so')}"
    files = {
        "modelDescription.xml": model_description(model, values, guid),
        binary: _compiled(sources),
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as stream:
        for name, content in files.items():
            # A fixed date: the same fit gives the same file.
            stream.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def model_description(model: DamperModel, values: Mapping[str, float], guid: str) -> bytes:
    """Return the content of modelDescription.xml."""
    effects = [f"with {effect.title}: {effect.equation}" for effect in model.effects]
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.id,
        guid=guid,
        generationTool="mrd_sim",
        description="; ".join([f"{model.title}: {model.equation}", *effects]),
        variableNamingConvention="flat",
    )
    slave = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model.id,
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
    )
    ElementTree.SubElement(ElementTree.SubElement(slave, "SourceFiles"), "File", name="fmi2.c")
    units = ElementTree.SubElement(root, "UnitDefinitions")
    inputs = INPUTS | (SIMULATOR_FORCE if model.stands_for else {})
    used = [parameter.unit for parameter in model.parameters] + [unit for unit, _ in inputs.values()] + ["N"]
    for unit in sorted(set(used) - {""}):
        ElementTree.SubElement(units, "Unit", name=unit)
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError")
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stepSize="0.001")
    variables = ElementTree.SubElement(root, "ModelVariables")

    for parameter, value in zip(model.parameters, model.vector(values), strict=True):
        _add_variable(
            variables,
            parameter.name,
            "parameter",
            "tunable",
            parameter.meaning,
            unit=parameter.unit,
            start=repr(float(value)),
            min=repr(parameter.limits[0]),
            max=repr(parameter.limits[1]),
        )
    for name, (unit, meaning) in inputs.items():
        _add_variable(variables, name, "input", "continuous", meaning, unit=unit, start="0")
    _add_variable(variables, "force", "output", "continuous", "of the damper, > 0 resists extension", unit="N")
    structure = ElementTree.SubElement(root, "ModelStructure")
    force, first = str(len(variables)), len(model.parameters) + 1
    known = " ".join(str(first + index) for index in range(len(inputs)))
    ElementTree.SubElement(ElementTree.SubElement(structure, "Outputs"), "Unknown", index=force, dependencies=known)
    ElementTree.SubElement(ElementTree.SubElement(structure, "InitialUnknowns"), "Unknown", index=force)
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _add_variable(
    variables: ElementTree.Element, name: str, causality: str, variability: str, meaning: str, **real: str
) -> None:
    variable = ElementTree.SubElement(
        variables,
        "ScalarVariable",
        name=name,
        valueReference=str(len(variables)),
        causality=causality,
        variability=variability,
        description=meaning,
    )
    ElementTree.SubElement(variable, "Real", {key: value for key, value in real.items() if value})


def _compiled(sources: Mapping[str, str]) -> bytes:
    compiler = shlex.split(os.environ.get("CC", "")) or ["cc"]
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        options = ["-std=c99", "-O2", "-fPIC", "-fvisibility=hidden", "-shared", "-o", "binary", "fmi2.c", "-lm"]
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
