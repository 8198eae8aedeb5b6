"""Fitted models for use in other software: as a Python callable, a C file or an FMU."""

from pathlib import Path

from mrd_base import InputError
from mrd_identification.fit_file import read_fit
from mrd_sim.c_code import c_source
from mrd_sim.damper import Damper
from mrd_sim.fmu import fmu_archive


def load_damper(fit: str | Path) -> Damper:
    """Return the damper that a fit.json describes: ``load_damper("fit.json").force(time, position, current)``.

    Raises
    ------
    InputError
        When the file cannot be read, is not a fit.json of this version, or names a model or effect that does not exist.
    """
    stored = read_fit(fit)
    try:
        return Damper(stored.model, stored.values, stored.laws, {effect: {} for effect in stored.effects})
    except InputError as error:
        raise InputError(f"{fit}: {error}") from None


def export_damper(fit: str | Path, output: str | Path, prefix: str = "mrd") -> Damper:
    """Write the damper of a fit.json as a C file or an FMU; an existing file is never overwritten.

    Parameters
    ----------
    fit : path
        Path of the fit.json.
    output : path
        Path of the new file: ``.c`` (see `mrd_sim.c_code.c_source`) or ``.fmu`` (see `mrd_sim.fmu.fmu_archive`).
    prefix : str
        Prefix of the names in the C file.

    Raises
    ------
    InputError
        As `load_damper`; also for another ending, an existing file, a prefix that is not a C name, and an FMU without a C
        compiler.
    """
    output = Path(output)
    if output.suffix not in (".c", ".fmu"):
        raise InputError(f"{output}: expected a name that ends in .c (C99 source) or .fmu (FMI 2.0 co-simulation)")
    damper = load_damper(fit)
    values = dict(zip(damper.model.names, map(float, damper.theta), strict=True))
    source = output.suffix == ".c"
    content = c_source(damper.model, values, prefix).encode() if source else fmu_archive(damper.model, values)
    try:
        with output.open("xb") as stream:
            stream.write(content)
    except FileExistsError:
        raise InputError(f"{output}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{output}: cannot be written ({error.strerror})") from None
    return damper
