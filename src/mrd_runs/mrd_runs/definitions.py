"""The message definitions that a bag carries, as rosbags types; no ROS is needed."""

import os
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mrd_base import InputError

SAMPLES_TYPE = "mrd_interfaces/msg/BenchSamples"


def interface_folder() -> Path:
    """Folder with the ``.msg`` files of mrd_interfaces: of the environment entered, else beside this package."""
    prefixes = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    beside = [parent / "mrd_interfaces" for parent in Path(__file__).resolve().parents]
    candidates = [prefix / "share/mrd_interfaces" for prefix in prefixes]
    # A source tree (src/mrd_interfaces/msg), an install tree of separate prefixes, a merged one.
    for folder in beside:
        candidates += [folder, folder / "share/mrd_interfaces", folder.parent / "share/mrd_interfaces"]
    for candidate in candidates:
        if (candidate / "msg/BenchSamples.msg").is_file():
            return candidate / "msg"
    raise InputError(
        "the message definitions of mrd_interfaces are not found; enter the bench's environment with `. ./env.sh`"
    )


def empty_typestore() -> Typestore:
    """A typestore with the standard messages of ROS 2 Jazzy only."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def typestore() -> Typestore:
    """The typestore with the standard messages and those of mrd_interfaces."""
    store = empty_typestore()
    for file in sorted(interface_folder().glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"mrd_interfaces/msg/{file.stem}"))
    return store


def type_name(message_type: Any) -> str:
    """Full name of a ROS message class, as bags have it."""
    package, kind, _ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"
