"""File formats that `read_run` reads and `import_run` imports. A new one is a file here and a line in `FORMATS`."""

from pathlib import Path

from mrd_base import InputError
from mrd_base.tool import command
from mrd_runs.formats.bag_file import BAG
from mrd_runs.formats.csv_file import CSV, has_own_header
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


def is_own(path: Path) -> bool:
    """Whether a path is a recording in one of `FORMATS`: a bag, or a CSV file with the columns of a run."""
    if path.is_dir():
        return (path / "metadata.yaml").exists() or any(entry.suffix.lower() in BAG.suffixes for entry in path.iterdir())
    suffix = path.suffix.lower()
    return suffix in BAG.suffixes or (suffix in CSV.suffixes and path.is_file() and has_own_header(path))


__all__ = ["BAG", "CSV", "FORMATS", "FileFormat", "Recording", "file_format", "is_own"]
