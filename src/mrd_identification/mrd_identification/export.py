"""Fitted models for use in other software: as a Python callable, a C file or an FMU."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mrd_base import InputError
from mrd_identification.correction import correction_of_report
from mrd_identification.fit_file import read_fit
from mrd_sim.c_code import c_source
from mrd_sim.damper import Damper
from mrd_sim.fmu import fmu_archive
from mrd_sim.plant import read_damper
from mrd_sim.simulators.adjusted import AdjustedSimulator
from mrd_sim.simulators.simulator import Simulator
from mrd_sim.wrapped_fmu import wrapped_simulator


def load_damper(file: str | Path, *, anyway: bool = False) -> Damper:
    """Return the damper that a file describes: ``load_damper("fit.json").force(time, position, current)``.

    Parameters
    ----------
    file : path
        A fit.json of `identify`, a gap_report.json of `diagnose`, whose corrected simulator is meant, or a plant.yaml, for
        instance of `apply`.
    anyway : bool
        Take the corrected simulator of a diagnosis that does not prove it.

    Raises
    ------
    InputError
        When the file cannot be read, is none of these or of another version, names a model or effect that does not exist,
        or is a diagnosis that proves nothing.
    """
    if Path(file).suffix in (".yaml", ".yml"):
        plant = read_damper(file)
        try:
            return plant.build()
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    report = _gap_report(file)
    if report is not None:
        found = correction_of_report(report, str(file), anyway=anyway)
        try:
            return found.build()
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    stored = read_fit(file)
    try:
        return Damper(stored.model, stored.values, stored.laws, {effect: {} for effect in stored.effects})
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def _gap_report(file: str | Path) -> dict[str, Any] | None:
    """Return the content of a file if it is a report of a diagnosis; whether it is a readable fit is told by `read_fit`."""
    try:
        content = json.loads(Path(file).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    is_report = isinstance(content, dict) and str(content.get("schema")).startswith("mrd-gap/")
    return content if is_report else None


def source_of_simulator(file: str | Path) -> str:
    """Return the simulator that a gap report corrects, with options as on a command line; empty where it corrects none."""
    simulator = (_gap_report(file) or {}).get("simulator") or {}
    return str(simulator.get("source", ""))


@dataclass(frozen=True)
class Exported:
    """The damper that was exported, and what its file is.

    Attributes
    ----------
    damper : Damper
    kind : str
        Kind of the file in words, such as its standard and what it carries.
    notes : tuple of str
        Limits of the file that its user must know.
    """

    damper: Damper
    kind: str
    notes: tuple[str, ...] = ()


def export_damper(
    file: str | Path,
    output: str | Path,
    prefix: str = "mrd",
    without_effects: bool = False,
    anyway: bool = False,
    simulator: Simulator | None = None,
    fmi: int | None = None,
) -> Exported:
    """Write the damper of a file as a C file or an FMU; an existing file is never overwritten.

    Parameters
    ----------
    file : path
        As of `load_damper`.
    output : path
        Path of the new file: ``.c`` (see `mrd_sim.c_code.c_source`) or ``.fmu`` (see `mrd_sim.fmu.fmu_archive`).
    prefix : str
        Prefix of the names in the C file.
    without_effects : bool
        Leave out the effects that act with the model.
    anyway : bool
        As of `load_damper`.
    simulator : Simulator, optional
        The user's FMU that a diagnosis corrects, opened: the new FMU carries it (see `mrd_sim.wrapped_fmu`). Without it, the
        new one gets the force of the simulator as an input.
    fmi : {2, 3}, optional
        Version of the standard for an FMU. Without it, that of ``simulator``, or 2.

    Raises
    ------
    InputError
        As `load_damper`; also for another ending, an existing file, a prefix that is not a C name, an FMU without a C
        compiler, a simulator that is not the one of the diagnosis or cannot be carried, and a user's own model or effect
        that has no translation to C.
    """
    output = Path(output)
    if output.suffix not in (".c", ".fmu"):
        raise InputError(f"{output}: expected a name that ends in .c (C99 source) or .fmu (FMI co-simulation)")
    if output.exists():
        raise InputError(f"{output}: exists already; choose another name")
    damper = load_damper(file, anyway=anyway)
    values = dict(zip(damper.model.names, map(float, damper.theta), strict=True))
    if without_effects and damper.model.stands_for:
        raise InputError(
            f"{file}: is a correction of the simulator {damper.model.stands_for}; without effects nothing is left to "
            f"export, so use {damper.model.stands_for} itself"
        )
    if without_effects:
        values = {name: value for name, value in values.items() if "." not in name}
        damper = Damper(damper.model.id, values, damper.model.laws)
    if output.suffix == ".c":
        if simulator is not None or fmi is not None:
            raise InputError(f"{output}: a C file; --simulator and --fmi belong to an FMU")
        content = c_source(damper.model, values, prefix, damper.plain).encode()
        exported = Exported(damper, "C99 source")
    elif simulator is not None:
        simulator = corrected_simulator(simulator, damper)
        wrapped = wrapped_simulator(simulator, damper.model, values, damper.plain)
        if fmi is not None and not wrapped.version.startswith(f"FMI {fmi}"):
            raise InputError(f"--fmi is {fmi}: an FMU around {simulator.name} is of its version, {wrapped.version}")
        content = wrapped.content
        exported = Exported(damper, f"{wrapped.version}, with {simulator.name} inside", wrapped.notes)
    else:
        content = fmu_archive(damper.model, values, damper.plain, fmi or 2)
        block = f", to be put behind {damper.model.stands_for}" if damper.model.stands_for else ""
        exported = Exported(damper, f"FMI {fmi or 2}.0{block}")
    try:
        with output.open("xb") as stream:
            stream.write(content)
    except FileExistsError:
        raise InputError(f"{output}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{output}: cannot be written ({error.strerror})") from None
    return exported


def corrected_simulator(simulator: Simulator, damper: Damper) -> Simulator:
    """Return the simulator that a damper corrects, with the parameters with which it was diagnosed.

    Values that the user has set himself stay.

    Raises
    ------
    InputError
        For another simulator, one that lacks such a parameter, or a damper that corrects none.
    """
    corrects = damper.model.stands_for
    if not corrects:
        raise InputError(f"--simulator: {damper.description} corrects no simulator; leave it out")
    if simulator.name != corrects:
        raise InputError(f"--simulator is {simulator.name}, expected {corrects}, which the diagnosis corrects")
    values = {name: value for name, value in damper.simulator_values.items() if name not in simulator.values}
    if not values:
        return simulator
    listed = ", ".join(f"{name} is {value:g}" for name, value in values.items())
    return AdjustedSimulator(simulator, values, (f"In {simulator.name}, {listed}, as in the diagnosis.",))
