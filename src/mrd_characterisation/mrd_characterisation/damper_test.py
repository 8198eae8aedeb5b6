"""Which damper was tested, when, where and by whom: what a sheet and an acceptance state beside the numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_runs import Run

LONGEST_SERIAL = 100
"""Characters of a serial number; file systems bear 255 bytes of a name."""


@dataclass(frozen=True)
class DamperTest:
    """A test of one damper.

    Attributes
    ----------
    serial : str
        Serial number or name of the damper.
    date : datetime or None
        When it was recorded; None where the recordings do not tell.
    rig, operator : str
        Empty where they are not known.
    temperature : tuple of float or None
        Lowest and highest temperature of the damper in K; None where it was not recorded.
    """

    serial: str
    date: datetime | None = None
    rig: str = ""
    operator: str = ""
    temperature: tuple[float, float] | None = field(default=None)

    @property
    def day(self) -> str:
        """Date as text."""
        return f"{self.date:%Y-%m-%d}" if self.date else "not recorded"


def damper_test(
    runs: Sequence[Run],
    *,
    serial: str | None = None,
    date: str | None = None,
    rig: str | None = None,
    operator: str | None = None,
) -> DamperTest:
    """Say which test recordings are of: as given, else as the recordings say.

    Parameters
    ----------
    runs : sequence of Run
        Of one damper.
    serial : str, optional
        Default: that in the recordings, else the name of the folder in which they are.
    date : str, optional
        ISO 8601.
    rig, operator : str, optional

    Raises
    ------
    InputError
        For a serial number that cannot be the name of a folder, and for a text that is no date.
    """
    warm = [run.temperature for run in runs if run.temperature is not None]
    temperature = (float(min(map(np.min, warm))), float(max(map(np.max, warm)))) if warm else None
    return DamperTest(
        checked_serial(serial) if serial is not None else _recorded_serial(runs),
        _date(date, "--date") if date is not None else recorded_date(runs),
        rig if rig is not None else _fact(runs, "rig"),
        operator if operator is not None else _fact(runs, "operator"),
        temperature,
    )


def checked_serial(serial: str, option: str = "--serial") -> str:
    """Return a serial number, which an option gave, that can be the name of a folder.

    Raises
    ------
    InputError
        For a path, an empty text, or one that is too long.
    """
    if not serial.strip() or serial in (".", "..") or any(c in "/\\:" or not c.isprintable() for c in serial):
        raise InputError(f"{option} is {serial!r}, expected the serial number of a damper, not a path: without / \\ and :")
    if len(serial) > LONGEST_SERIAL:
        raise InputError(f"{option} has {len(serial)} characters, expected at most {LONGEST_SERIAL}")
    return serial


def _recorded_serial(runs: Sequence[Run]) -> str:
    if recorded := _fact(runs, "serial"):
        return checked_serial(recorded)
    folders = {Path(str(run.info["source"])).resolve().parent.name for run in runs if run.info.get("source")}
    return folders.pop() if len(folders) == 1 else runs[0].name


def _fact(runs: Sequence[Run], name: str) -> str:
    """Return what the recordings say under a name; empty where they say nothing, or not the same."""
    told = {str(run.info[name]) for run in runs if run.info.get(name)}
    return told.pop() if len(told) == 1 else ""


def recorded_date(runs: Sequence[Run]) -> datetime | None:
    """Return when the first of the recordings was begun; None where they do not say it.

    Raises
    ------
    InputError
        For a text that is no date.
    """
    begun = [_date(str(run.info["started"]), f"{run.name}: started") for run in runs if run.info.get("started")]
    return min(begun, default=None)


def _date(text: str, where: str) -> datetime:
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        raise InputError(
            f"{where}: {text!r} is not a date, expected a date such as 2024-05-31 or 2024-05-31T14:00"
        ) from None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
