"""The plant.yaml of the simulated bench with the damper that a diagnosis found."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from mrd_base import InputError, node_patterns
from mrd_identification.correction import Correction
from mrd_sim.effects import EFFECT_FOLDERS
from mrd_sim.models import MODEL_FOLDERS, MODELS
from mrd_sim.plant import read_damper

# Sections of a parameter file that hold the plant; the section that overrides the others comes first.
_SECTIONS = node_patterns("plant")[::-1]


def write_plant(corrected: Correction, plant: str | Path, output: str | Path) -> Path:
    """Write a plant.yaml with another damper; everything else stays as it is, comments included.

    Parameters
    ----------
    corrected : Correction
    plant : path
        Plant file to start from.
    output : path
        Plant file to write; must not exist.

    Raises
    ------
    InputError
        If the damper corrects a simulator of the user's own, if the plant file cannot be read or is none, if the output
        exists or cannot be written, or if the damper's section is written in a way that cannot be edited.
    """
    if corrected.simulator:
        raise InputError(
            f"the diagnosis corrects the simulator {corrected.simulator}, and a plant file has a damper model of the "
            "catalogue; make an FMU or C file of the correction with export"
        )
    read_damper(plant)
    expected = corrected.build()
    edited = with_damper(Path(plant).read_text(encoding="utf-8"), corrected, str(plant))
    output = Path(output)
    try:
        with output.open("x", encoding="utf-8") as stream:
            stream.write(f"# {corrected.remark}\n{edited}")
    except FileExistsError:
        raise InputError(f"{output}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{output}: cannot be written ({error.strerror})") from None
    try:
        written = read_damper(output).build()
    except InputError:
        written = None
    if written is None or written.model.names != expected.model.names or (written.theta != expected.theta).any():
        output.unlink()
        raise InputError(f"{plant}: its section damper cannot be edited; write it in the style of config/plant.yaml")
    return output


def with_damper(text: str, corrected: Correction, where: str) -> str:
    """Return the text of a plant.yaml with model, parameters, laws and effects of its damper replaced.

    ``where`` is the start of error messages.
    """
    root: Any = yaml.compose(text, yaml.SafeLoader)
    sections = {key.value: value for key, value in root.value}
    node = next((sections[name] for name in _SECTIONS if name in sections), None)
    if node is None:
        raise InputError(
            f"{where}: found the sections {', '.join(sections)}, expected {' or '.join(_SECTIONS)} for the plant"
        )
    parameters = next(value for key, value in node.value if key.value == "ros__parameters")
    damper = next((value for key, value in parameters.value if key.value == "damper"), None)
    entries = _damper_entries(corrected)
    if damper is None:
        indent = " " * parameters.start_mark.column
        section = "".join(_entry_lines(key, value, f"{indent}  ") for key, value in entries.items())
        start = parameters.start_mark.index - len(indent)
        return f"{text[:start]}{indent}damper:\n{section}{text[start:]}"
    indent = " " * damper.start_mark.column
    present = {key.value: (key, value) for key, value in damper.value}
    edits = []
    for name, value in entries.items():
        if name in present:
            key, old = present[name]
            start, end, comment = _entry_extent(text, key.start_mark.index, old)
            edits.append((start, end, _entry_lines(name, value, indent, comment)))
        elif value:
            start = damper.start_mark.index - len(indent)
            edits.append((start, start, _entry_lines(name, value, indent)))
    # From the last edit to the first, so that the positions of the earlier edits stay valid.
    for start, end, replacement in sorted(edits, key=lambda edit: edit[:2], reverse=True):
        text = text[:start] + replacement + text[end:]
    return text


def _damper_entries(corrected: Correction) -> dict[str, str]:
    """Return the entries of the damper's section by key."""
    # Laws that the model has by default are left out.
    default = MODELS[corrected.model].laws
    laws = {name: law for name, law in corrected.laws.items() if law != default[name]}
    effects = (f"{effect}: {{{_assignments(values, ', ')}}}" for effect, values in corrected.effects.items())
    entries = {
        "model": corrected.model,
        "laws": ",".join(f"{name}={law}" for name, law in laws.items()),
        "effects": "\n".join(effects) + "\n" if corrected.effects else "",
        "parameters": _assignments(corrected.parameters, "\n") + "\n",
    }
    # The bench loads a model or an effect of the user's own from where it was found.
    if corrected.model in MODEL_FOLDERS:
        entries["models_folder"] = str(Path(MODEL_FOLDERS[corrected.model]).resolve())
    if own := [EFFECT_FOLDERS[effect] for effect in corrected.effects if effect in EFFECT_FOLDERS]:
        entries["effects_folder"] = str(Path(own[0]).resolve())
    return entries


def _assignments(values: Mapping[str, float], separator: str) -> str:
    return separator.join(f"{name}: {float(value)!r}" for name, value in values.items())


def _entry_lines(key: str, value: str, indent: str, comment: str = "") -> str:
    """Return the lines of an entry of a block mapping."""
    if not value.endswith("\n"):
        return f"{indent}{key}: {value or chr(34) * 2}{comment}\n"
    return f"{indent}{key}: |{comment}\n" + "".join(f"{indent}  {line}\n" for line in value.splitlines())


def _entry_extent(text: str, key_start: int, value: yaml.Node) -> tuple[int, int, str]:
    """Return where the lines of an entry start and end, and the comment in its first line."""
    start = text.rfind("\n", 0, key_start) + 1
    if isinstance(value, yaml.ScalarNode) and value.style in ("|", ">"):
        end_of_first = text.index("\n", value.start_mark.index)
        return start, value.end_mark.index, text[value.start_mark.index : end_of_first].lstrip("|>+-0123456789").rstrip()
    end_of_line = text.find("\n", value.end_mark.index)
    end = len(text) if end_of_line < 0 else end_of_line + 1
    return start, end, text[value.end_mark.index : end].rstrip()
