"""File formats that `read_run` reads and `import_run` imports. A new one is a file here and a line in `FORMATS`."""

from pathlib import Path

from mrd_base import InputError
from mrd_base.tool import command
from mrd_runs.formats.bag_file import BAG
from mrd_runs.formats.csv_file import CSV
from mrd_runs.formats.recording import FileFormat, Recording

FORMATS: tuple[FileFormat, ...] = (BAG, CSV)


def file_format(path: Path) -> FileFormat:
    """Return the format of a file or folder, by its name.

    Raises
    ------
    InputError
        When the path does not exist or no format fits.
    """
    expected = ", ".join(entry.description for entry in FORMATS)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; expected {expected}")
    if not (path.is_dir() or path.is_file()):
        raise InputError(f"{path}: is neither a file nor a folder; expected {expected}")
    for entry in FORMATS:
        if entry.folders if path.is_dir() else path.suffix.lower() in entry.suffixes:
            return entry
    import_ = command("mrd_runs", "import")
    raise InputError(f"{path}: unknown kind of file; expected {expected} (`{import_}` makes bags of other recordings)")


__all__ = ["BAG", "CSV", "FORMATS", "FileFormat", "Recording", "file_format"]
