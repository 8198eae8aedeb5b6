"""Correction of the simulator: the damper that a diagnosis found, written into a plant.yaml."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mrd_base import InputError, node_patterns
from mrd_diagnosis.diagnosis import Verdict
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.quantities import format_share
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECT_FOLDERS
from mrd_sim.models import MODEL_FOLDERS, MODELS
from mrd_sim.plant import read_damper

# Sections of a parameter file that hold the plant; the section that overrides the others comes first.
_SECTIONS = node_patterns("plant")[::-1]


@dataclass(frozen=True)
class Correction:
    """A damper as a diagnosis found it.

    Attributes
    ----------
    model : str
        Id of the damper model.
    laws : mapping
        Current law by coefficient.
    parameters : mapping
        Parameters of the model without effects, by name, in SI units.
    effects : mapping
        Parameters of each effect, by the id of the effect.
    remark : str
        A sentence that says what the damper is, and whether the diagnosis proves it.
    """

    model: str
    laws: Mapping[str, str]
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    remark: str

    def build(self) -> Damper:
        """Build the damper, at rest and unloaded."""
        return Damper(self.model, self.parameters, self.laws, self.effects)


def correction_of_report(report: Mapping[str, Any], where: str, **options: Any) -> Correction:
    """Return the correction of a gap report's content, see `correction`, of which ``options`` are keyword arguments.

    Raises
    ------
    InputError
        As `correction` does.
    """
    if simulator := report.get("simulator"):
        raise InputError(
            f"{where}: corrects the simulator {simulator['name']}, and a plant file has a damper model of the catalogue; "
            "make an FMU or C file of the correction with export"
        )
    refitted = report["corrected"] or {"parameters": {}, "effects": []}  # null where the recordings are faulty
    # Without effects, and where the recordings are faulty, there is no share.
    closed = report["gap"]["closed_fraction"]["value"] if report["gap"] else None
    return correction(
        report["verdict"],
        report["model"],
        report["laws"],
        refitted["parameters"],
        refitted["effects"],
        causes={cause["effect"]: cause["probability"] for cause in report["causes"]} if "causes" in report else None,
        closed_fraction=math.nan if closed is None else closed,
        is_change=bool(report["runs"]["reference"]),
        where=where,
        **options,
    )


def correction(
    verdict: Verdict,
    model: str,
    laws: Mapping[str, str],
    parameters: Mapping[str, float],
    effects: Collection[str],
    *,
    causes: Mapping[str, float | None] | None = None,
    closed_fraction: float = math.nan,
    is_change: bool = False,
    anyway: bool = False,
    where: str = "the diagnosis",
    remedy: str = ", or apply the result with --anyway",
) -> Correction:
    """Decide what of a diagnosis belongs into the simulator.

    The refitted parameters and the proven effects do. Offsets and gains of single runs do not: they differ from run to run.

    Parameters
    ----------
    verdict, model, laws, parameters, effects
        As in `mrd_diagnosis.diagnosis.Diagnosis`; parameters of effects are named EFFECT.PARAMETER.
    causes : mapping, optional
        Probability of each named cause, by the id of its effect; without it, all effects are taken for proven. Otherwise
        those are that are named and more probable than not.
    closed_fraction : float
        Share of the gap that the effects close, for the remark on a partly explained gap; nan where it is not known.
    is_change : bool
        Whether the diagnosis explains a change since reference runs; the parameters are of the damper before it.
    anyway : bool
        Apply also what is not proven: the first of several possible causes, the nearest effect, or the parameters alone.
    where, remedy : str
        Start of error messages, and end of the one about what is not proven.

    Raises
    ------
    InputError
        If the recordings are faulty, or if the verdict does not prove an effect and ``anyway`` is not set.
    """
    doubtful = [] if causes is None else unproven_effects(effects, causes)
    remark = _remark(verdict, model, effects, doubtful, closed_fraction, is_change, anyway, where, remedy)
    if verdict == "no_gap":
        effects = ()
    parameters_of_effects = {
        effect: {
            name.removeprefix(f"{effect}."): value for name, value in parameters.items() if name.startswith(f"{effect}.")
        }
        for effect in effects
    }
    parameters_of_model = {name: value for name, value in parameters.items() if "." not in name}
    return Correction(model, laws, parameters_of_model, parameters_of_effects, remark)


def unproven_effects(effects: Collection[str], causes: Mapping[str, float | None]) -> list[str]:
    """Return the effects of a corrected simulator that are no named causes more probable than not, by their probability."""
    return [effect for effect in effects if not (causes.get(effect) or 0.0) >= THRESHOLDS.named_support]


def _remark(
    verdict: Verdict,
    model: str,
    effects: Collection[str],
    doubtful: Collection[str],
    closed_fraction: float,
    is_change: bool,
    anyway: bool,
    where: str,
    remedy: str,
) -> str:
    """Return what the corrected damper is, and whether it is proven; refuse what is not proven unless ``anyway``."""
    if verdict == "data_fault":
        raise InputError(
            f"{where}: the recordings are faulty, so there is nothing to apply; correct them and diagnose again"
        )
    named = ", ".join(effects)
    gap = "change" if is_change else "gap"
    parameters = "parameters refitted to the runs from before" if is_change else "refitted parameters"
    refitted = f"The damper is {model} with {parameters}"
    with_effects = f"{refitted} and the effect{'s' if len(effects) > 1 else ''} {named}"
    if verdict == "no_gap":
        return f"{refitted}: the diagnosis found no missing effect."
    if verdict in ("explained", "partly_explained") and doubtful:
        if not anyway:
            raise InputError(
                f"{where}: the probability of {', '.join(doubtful)} is below {100 * THRESHOLDS.named_support:g} %, so it is "
                f"not proven; record more runs and diagnose again{remedy}"
            )
        return f"{with_effects}: this comes nearest to the {gap} and is NOT proven."
    if verdict == "explained":
        return f"{with_effects}: this explains the {gap}."
    if verdict == "partly_explained":
        closed = float(np.clip(closed_fraction, 0.0, 1.0))
        if math.isnan(closed):
            return f"{with_effects}: this explains a part of the {gap}; the rest stays open."
        return f"{with_effects}: this explains {format_share(closed)} of the {gap}; {format_share(1.0 - closed)} stays open."
    unproven, advice = f"{named} is not proven", "try the other damper models that it lists"
    if verdict == "ambiguous":
        advice = "record the experiment that it advises"
        remark = f"{with_effects}: this is the first of several possible causes and NOT proven."
    elif effects:
        remark = f"{with_effects}: this comes nearest to the {gap} and is NOT proven."
    else:
        unproven = f"no effect is known that explains the {gap}"
        remark = f"{refitted}: an effect is missing that is NOT known."
    if not anyway:
        raise InputError(f"{where}: the verdict is {verdict}, so {unproven}; {advice}{remedy}")
    return remark


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
        If the plant file cannot be read or is none, if the output exists or cannot be written, or if the damper's section is
        written in a way that cannot be edited.
    """
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
