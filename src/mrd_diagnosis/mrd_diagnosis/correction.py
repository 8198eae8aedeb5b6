"""A diagnosis put into the simulator: the corrected damper, as a plant.yaml."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from mrd_base import InputError, node_patterns
from mrd_diagnosis.diagnosis import Verdict
from mrd_sim.damper import Damper
from mrd_sim.models import MODELS
from mrd_sim.plant import read_damper

_NODES = node_patterns("plant")[::-1]
_HEAD = "# The damper below is "


@dataclass(frozen=True)
class Correction:
    """A damper as a diagnosis found it.

    Attributes
    ----------
    model : str
    laws : mapping
        Current law by coefficient.
    parameters : mapping
        Of the model alone, by name, SI.
    effects : mapping
        Parameters of each effect, by id.
    remark : str
        What it is, and how far it can be trusted.
    effects_folder : str
        Where effects of one's own are; may be empty.
    """

    model: str
    laws: Mapping[str, str]
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    remark: str
    effects_folder: str = ""

    def build(self) -> Damper:
        """The damper, at rest and unloaded."""
        return Damper(self.model, self.parameters, self.laws, self.effects)


def correction(
    verdict: Verdict,
    model: str,
    laws: Mapping[str, str],
    parameters: Mapping[str, float],
    effects: Collection[str],
    *,
    anyway: bool = False,
    where: str = "the diagnosis",
    effects_folder: str = "",
) -> Correction:
    """What of a diagnosis goes into the simulator.

    Offsets and gains of single runs do not: they differ from run to run.

    Parameters
    ----------
    verdict, model, laws, parameters, effects
        As in `mrd_diagnosis.diagnosis.Diagnosis`; parameters of effects are named EFFECT.PARAMETER.
    anyway : bool
        Take also what is not proven: the first of several causes, the effect that comes nearest, the parameters alone.
    where : str
        Prefix of error messages.
    effects_folder : str
        Where effects of one's own are; may be empty.

    Raises
    ------
    InputError
        For a fault in the data, and for a verdict that proves nothing unless ``anyway``.
    """
    if verdict == "data_fault":
        raise InputError(f"{where}: the recordings are faulty, so there is nothing to apply; mend them and diagnose again")
    named = ", ".join(effects) or "no effect"
    if verdict == "unknown_effect" and not effects:
        if not anyway:
            raise InputError(
                f"{where}: the verdict is {verdict} and no effect comes near; apply the refitted parameters "
                "alone with --anyway"
            )
        remark = f"{model} with its parameters refitted: what is missing is NOT known"
    elif verdict in ("ambiguous", "unknown_effect"):
        advised = "record what it advises" if verdict == "ambiguous" else "try the forms of the model that it lists"
        if not anyway:
            raise InputError(
                f"{where}: the verdict is {verdict}, so {named} is not proven; {advised}, or apply it with --anyway"
            )
        remark = f"{model} with {named}: {'first of several causes' if verdict == 'ambiguous' else 'nearest'}, NOT proven"
    elif verdict == "no_gap":
        effects, remark = (), f"{model} with its parameters refitted: no effect is missing"
    else:
        remark = f"{model} with {named}, as diagnosed"
    own = {name: value for name, value in parameters.items() if "." not in name}
    of_effects = {
        effect: {
            name.removeprefix(f"{effect}."): value for name, value in parameters.items() if name.startswith(f"{effect}.")
        }
        for effect in effects
    }
    return Correction(model, laws, own, of_effects, remark, effects_folder)


def write_plant(corrected: Correction, plant: str | Path, output: str | Path) -> Path:
    """Write a plant.yaml with another damper: everything else stays as it is, comments included.

    Parameters
    ----------
    corrected : Correction
    plant : path
        The plant.yaml that it was.
    output : path
        Must not exist.

    Raises
    ------
    InputError
        When one file cannot be read or is no plant.yaml, the other exists or cannot be written, or the damper's section is
        written in a way that cannot be edited.
    """
    read_damper(plant)
    expected = corrected.build()
    edited = with_damper(Path(plant).read_text(encoding="utf-8"), corrected, str(plant))
    output = Path(output)
    try:
        with output.open("x", encoding="utf-8") as stream:
            stream.write(f"{_HEAD}{corrected.remark}.\n{edited}")
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
        raise InputError(f"{plant}: its section damper cannot be edited; write it as config/plant.yaml does")
    return output


def with_damper(text: str, corrected: Correction, where: str) -> str:
    """Text of a plant.yaml, from ``where``, with model, parameters, laws and effects of its damper replaced."""
    root: Any = yaml.compose(text, yaml.SafeLoader)
    sections = {key.value: value for key, value in root.value}
    node = next((sections[name] for name in _NODES if name in sections), None)
    if node is None:
        raise InputError(f"{where}: found {', '.join(sections)}, none of them the plant's: expected {' or '.join(_NODES)}")
    parameters = next(value for key, value in node.value if key.value == "ros__parameters")
    damper = next((value for key, value in parameters.value if key.value == "damper"), None)
    if damper is None:
        indent = " " * parameters.start_mark.column
        section = "".join(_entry(key, value, f"{indent}  ") for key, value in _entries(corrected).items())
        at = parameters.start_mark.index - len(indent)
        return f"{text[:at]}{indent}damper:\n{section}{text[at:]}"
    indent = " " * damper.start_mark.column
    present = {key.value: (key, value) for key, value in damper.value}
    # From the last to the first, so that what is still to be replaced stays where it was; new keys before all.
    edits = []
    for name, value in _entries(corrected).items():
        if name in present:
            key, old = present[name]
            first, end, comment = _extent(text, key.start_mark.index, old)
            edits.append((first, end, _entry(name, value, indent, comment)))
        elif value:
            first = damper.start_mark.index - len(indent)
            edits.append((first, first, _entry(name, value, indent)))
    for first, end, replacement in sorted(edits, key=lambda edit: edit[:2], reverse=True):
        text = text[:first] + replacement + text[end:]
    return text


def _entries(corrected: Correction) -> dict[str, str]:
    """What the damper's section has to say, by key."""
    # Those that the model has of itself need no saying.
    own = MODELS[corrected.model].laws
    laws = {name: law for name, law in corrected.laws.items() if law != own[name]}
    effects = (f"{effect}: {{{_listed(values, ', ')}}}" for effect, values in corrected.effects.items())
    entries = {
        "model": corrected.model,
        "laws": ",".join(f"{name}={law}" for name, law in laws.items()),
        "effects": "\n".join(effects) + "\n" if corrected.effects else "",
        "parameters": _listed(corrected.parameters, "\n") + "\n",
    }
    if corrected.effects_folder:
        entries["effects_folder"] = str(Path(corrected.effects_folder).resolve())
    return entries


def _listed(values: Mapping[str, float], separator: str) -> str:
    return separator.join(f"{name}: {float(value)!r}" for name, value in values.items())


def _entry(key: str, value: str, indent: str, comment: str = "") -> str:
    """Lines of a key of a block mapping."""
    if not value.endswith("\n"):
        return f"{indent}{key}: {value or chr(34) * 2}{comment}\n"
    return f"{indent}{key}: |{comment}\n" + "".join(f"{indent}  {line}\n" for line in value.splitlines())


def _extent(text: str, start: int, value: yaml.Node) -> tuple[int, int, str]:
    """Where the lines of an entry begin and end, and the comment in its first line."""
    first = text.rfind("\n", 0, start) + 1
    if isinstance(value, yaml.ScalarNode) and value.style in ("|", ">"):
        end_of_first = text.index("\n", value.start_mark.index)
        return first, value.end_mark.index, text[value.start_mark.index : end_of_first].lstrip("|>+-0123456789").rstrip()
    end_of_line = text.find("\n", value.end_mark.index)
    end = len(text) if end_of_line < 0 else end_of_line + 1
    return first, end, text[value.end_mark.index : end].rstrip()
