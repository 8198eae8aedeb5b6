"""All reports on a test of a damper at once, as a bench writes them when its tests have ended."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mrd_characterisation.acceptance import Acceptance, accept, characterise_for
from mrd_characterisation.acceptance_file import write_acceptance
from mrd_characterisation.characterisation import Characterisation
from mrd_characterisation.characterisation_file import write_characterisation
from mrd_characterisation.characterise import characterise
from mrd_characterisation.damper_test import damper_test
from mrd_characterisation.page import write_page
from mrd_characterisation.reference import Reference
from mrd_characterisation.sheet import make_sheet
from mrd_characterisation.sheet_file import write_sheet
from mrd_runs import Run


@dataclass(frozen=True)
class Reports:
    """What was written.

    Attributes
    ----------
    characterisation : Characterisation
    acceptance : Acceptance or None
        None where nothing was judged.
    paths : tuple of Path
    """

    characterisation: Characterisation
    acceptance: Acceptance | None
    paths: tuple[Path, ...]


def write_reports(
    runs: Sequence[Run], folder: Path, *, serial: str | None = None, reference: Reference | None = None
) -> Reports:
    """Characterise a damper, judge it where there is a reference, and write files, page and sheet.

    Parameters
    ----------
    runs : sequence of Run
    folder : Path
        It is made.
    serial : str, optional
        Serial number of the damper; by default the recorded one, else the name of the folder of the runs.
    reference : Reference, optional
        What the damper is judged by.

    Raises
    ------
    InputError
        When the runs show nothing of the damper.
    """
    test = damper_test(runs, serial=serial)
    if reference is None:
        characterisation, acceptance = characterise(runs, name=test.serial), None
    else:
        characterisation = characterise_for(runs, reference.limits, test.serial)
        acceptance = accept(
            characterisation, reference.limits, test, reference=reference.text, golden_sources=reference.golden_sources
        )
    folder.mkdir(parents=True, exist_ok=True)
    paths = [*write_characterisation(characterisation, folder), write_page([characterisation], folder)]
    paths += [write_acceptance(acceptance, folder)] if acceptance else []
    overlaid = [characterisation, *([reference.golden] if reference and reference.golden else [])]
    paths += write_sheet(make_sheet(overlaid, test, acceptance), folder)
    return Reports(characterisation, acceptance, tuple(paths))
