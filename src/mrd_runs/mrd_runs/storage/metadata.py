"""The file ``metadata.yaml`` of a bag."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from mrd_base import InputError
from mrd_base.tool import command
from mrd_runs.text import one_line

NAME = "metadata.yaml"
# Key of the bag from which a bag was recovered that is not complete.
RECOVERED_FROM = "recovered_from"
_LARGEST = 2**22  # bytes; the file has about a kilobyte for each topic


@dataclass(frozen=True)
class Metadata:
    """What ``metadata.yaml`` says of a bag.

    Attributes
    ----------
    files : tuple of str
        Names of the storage files.
    message_count : int
        Number of messages in all files.
    compresses_messages : bool
        Whether each message is compressed by itself.
    recovered : bool
        Whether the bag was recovered from one that had lost something.
    """

    files: tuple[str, ...]
    message_count: int
    compresses_messages: bool
    recovered: bool


def read_metadata(folder: Path) -> Metadata | None:
    """Read the metadata of a bag folder; return None where there is none.

    Raises
    ------
    InputError
        When the file is not that of a bag.
    """
    path = folder / NAME
    if not path.exists():
        return None
    try:
        with path.open("rb") as stream:
            text = stream.read(_LARGEST + 1)
        if len(text) > _LARGEST:
            raise InputError(f"{path}: is longer than {_LARGEST} bytes; expected the metadata of a bag")
        # The base loader makes texts only, and expands no merge keys, which may nest exponentially.
        content: Any = yaml.load(text, yaml.BaseLoader)["rosbag2_bagfile_information"]
        # Some writers give paths relative to the parent of the bag; the files stand in the bag all the same.
        files = tuple(Path(name).name for name in content["relative_file_paths"])
        mode = str(content.get("compression_mode", "")).lower()
        recovered = RECOVERED_FROM in (content.get("custom_data") or {})
        return Metadata(files, int(content["message_count"]), mode == "message", recovered)
    except (yaml.YAMLError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        recover = command("mrd_runs", "recover")
        raise InputError(f"{path}: is not the metadata of a bag ({one_line(error)}); `{recover}` makes it anew") from None
