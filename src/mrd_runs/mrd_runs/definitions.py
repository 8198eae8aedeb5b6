"""Message definitions that a bag contains, as rosbags types; no ROS is needed."""

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mrd_base import InputError

_NUMBERS = ("float64", "float32", "uint64", "int64", "uint32", "int32", "uint16", "int16", "uint8", "int8")
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


def as_of_today(messages: Sequence[bytes], message_type: str, recorded: Typestore) -> Sequence[bytes]:
    """Return serialised messages as the bench defines their type today.

    Parameters
    ----------
    messages : sequence of bytes
    message_type : str
    recorded : Typestore
        Types as the bag defines them. Whole numbers that a type has gained since are 0, others nan, and series empty.

    Raises
    ------
    InputError
        When the two definitions differ by more than numbers and series of numbers that were added.
    """
    today = typestore()
    _, before = recorded.fielddefs[message_type]
    _, now = today.fielddefs[message_type]
    if before == now:
        return messages
    gained = {name: kind for name, kind in now if name not in dict(before)}
    values = {name: _unknown(kind, detail) for name, (kind, detail) in gained.items()}
    kept = [name for name, _ in now if name not in gained]
    if any(value is None for value in values.values()) or [name for name, _ in before] != kept:
        raise InputError(
            f"the bag defines {message_type} otherwise than the bench; replay it with the bench that recorded it"
        )
    converted = []
    for cdr in messages:
        message = recorded.deserialize_cdr(cdr, message_type)
        fields = {name: getattr(message, name) for name, _ in before} | values
        converted.append(bytes(today.serialize_cdr(today.types[message_type](**fields), message_type)))
    return converted


def _unknown(kind: Nodetype, detail: Any) -> Any:
    """Return what stands for a number or a series that was not recorded; None for a field of another type."""
    if kind == Nodetype.SEQUENCE and detail[0][0] == Nodetype.BASE and detail[0][1][0] in _NUMBERS:
        return np.empty(0, detail[0][1][0])
    if kind != Nodetype.BASE or detail[0] == "string":
        return None
    return math.nan if detail[0].startswith("float") else 0


def definition(store: Typestore, message_type: str) -> str:
    """Return the text that defines a message type in a bag. Those of mrd_interfaces keep the comments with the units."""
    text, _ = store.generate_msgdef(message_type, ros_version=2)
    package, _, name = message_type.split("/")
    if package != "mrd_interfaces":
        return text
    # The types that it uses follow after a line of equals signs.
    _, *used = re.split(r"^(?==)", text, maxsplit=1, flags=re.MULTILINE)
    return "".join([(interface_folder() / f"{name}.msg").read_text(encoding="utf-8"), *used])
