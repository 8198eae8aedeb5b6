"""What a damper is judged by: a file of limits, or a golden damper by its characterisation or its runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mrd_base import InputError
from mrd_base.json_file import read_json
from mrd_characterisation.characterisation import Characterisation
from mrd_characterisation.characterisation_file import SCHEMA, read_characterisation
from mrd_characterisation.characterise import characterise
from mrd_characterisation.limits import Limit, golden_limits, read_limits
from mrd_runs import read_runs


@dataclass(frozen=True, eq=False)
class Reference:
    """Limits, and where they are from.

    Attributes
    ----------
    limits : tuple of Limit
    text : str
        What they are from, in words.
    golden_sources : tuple of str
        Files of the runs of the golden damper; empty where there is none or they are not known.
    golden : Characterisation or None
        That of the golden damper where it was made of its runs, to draw it.
    """

    limits: tuple[Limit, ...]
    text: str
    golden_sources: tuple[str, ...] = ()
    golden: Characterisation | None = None


def read_reference(paths: Sequence[str], tolerance: float, skip: float = 0.0) -> Reference:
    """Read what a damper is judged by.

    Parameters
    ----------
    paths : sequence of str
        One file of limits (YAML), one characterisation (JSON), or the runs of a golden damper.
    tolerance : float
        Half the width of the bands around a golden damper's values, over these; see `golden_limits`.
    skip : float
        s that are left out at the start of every golden run.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    kinds = {Path(path).suffix.lower() for path in paths}
    if len(paths) > 1 and kinds & {".yaml", ".yml", ".json"}:
        raise InputError(
            f"--reference: found {len(paths)} files, expected one file of limits, one characterisation, or golden runs"
        )
    (path, *_) = paths
    if kinds & {".yaml", ".yml"}:
        return Reference(read_limits(path), f"the limits of {Path(path).name}")
    within = f"within {100 * tolerance:g} %"
    if ".json" in kinds:
        stored = read_characterisation(path)
        # The characterisation that is read has no runs; the file names theirs.
        sources = tuple(run["source"] for run in read_json(path, "mrd_characterisation", "characterisation", SCHEMA)["runs"])
        known = sources if all(sources) else ()
        return Reference(golden_limits(stored.values, tolerance), f"the golden damper of {Path(path).name} {within}", known)
    runs = read_runs(paths, skip)
    golden = characterise(runs, name="golden")
    sources = tuple(str(run.info["source"]) for run in runs)
    return Reference(
        golden_limits(golden.values, tolerance),
        f"the golden damper of {len(runs)} run{'s' * (len(runs) > 1)} {within}",
        sources,
        golden,
    )
