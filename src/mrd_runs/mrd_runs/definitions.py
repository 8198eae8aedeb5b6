"""Message definitions that a bag contains, as rosbags types; no ROS is needed."""

import os
import re
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mrd_base import InputError

SAMPLES_TYPE = "mrd_interfaces/msg/BenchSamples"


def interface_folder() -> Path:
    """Return the folder with the ``.msg`` files of mrd_interfaces, in the active environment or beside this package."""
    prefixes = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    candidates = [prefix / "share/mrd_interfaces" for prefix in prefixes]
    # Beside this package in a source tree (src/mrd_interfaces/msg), in separate install prefixes, or in a merged prefix.
    for folder in (parent / "mrd_interfaces" for parent in Path(__file__).resolve().parents):
        candidates += [folder, folder / "share/mrd_interfaces", folder.parent / "share/mrd_interfaces"]
    for candidate in candidates:
        if (candidate / "msg/BenchSamples.msg").is_file():
            return candidate / "msg"
    raise InputError(
        "the message definitions of mrd_interfaces are not found; enter the bench's environment with `. ./env.sh`"
    )


def empty_typestore() -> Typestore:
    """Return a typestore with the standard messages of ROS 2 Jazzy only."""
    return get_typestore(Stores.ROS2_JAZZY)


def typestore() -> Typestore:
    """Return a typestore with the standard messages of ROS 2 Jazzy and those of mrd_interfaces."""
    store = empty_typestore()
    for file in sorted(interface_folder().glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"mrd_interfaces/msg/{file.stem}"))
    return store


def definition(store: Typestore, message_type: str) -> str:
    """Return the text that defines a message type in a bag. Those of mrd_interfaces keep the comments with the units."""
    text, _ = store.generate_msgdef(message_type, ros_version=2)
    package, _, name = message_type.split("/")
    if package != "mrd_interfaces":
        return text
    # The types that it uses follow after a line of equals signs.
    _, *used = re.split(r"^(?==)", text, maxsplit=1, flags=re.MULTILINE)
    return "".join([(interface_folder() / f"{name}.msg").read_text(encoding="utf-8"), *used])
