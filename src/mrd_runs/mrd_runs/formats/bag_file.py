"""Recordings in bags: the topic of the samples, the facts about the recording, and columns of an imported file."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.tool import command
from mrd_runs.bag import Bag, read_bag
from mrd_runs.blocks import decode_blocks, sample_columns
from mrd_runs.definitions import SAMPLES_TYPE
from mrd_runs.formats.recording import FileFormat, Recording
from mrd_runs.run_info import read_run_info
from mrd_runs.text import one_line

Array = NDArray[np.float64]

# Columns of an imported file that blocks of equally spaced samples cannot represent. Its bag has their exact values on the
# topics ``imported/NAME``.
IMPORTED_COLUMNS = ("time_s", "velocity_mps", "temperature_C")


def read_bag_file(path: Path) -> Recording:
    """Read a bag folder, an ``.mcap`` or a ``.db3`` file."""
    bag = read_bag(path, {"samples", "run_info", "calibration", "experiment_state", *IMPORTED_COLUMNS})
    topic = samples_topic(bag, str(path))
    if topic.rsplit("/", 1)[-1] != "samples":  # recorded under another name, so its messages have not been read yet
        bag = read_bag(path)
    # rosbags raises various errors for a damaged message or for a definition with other fields.
    try:
        blocks = decode_blocks(bag.topics[topic].messages, bag.types)
    except Exception as error:
        raise InputError(f"{path}: the messages of {one_line(topic)} cannot be read ({one_line(error)})") from None
    try:
        info = read_run_info(bag)
    except Exception as error:
        raise InputError(f"{path}: run_info or calibration cannot be read ({one_line(error)})") from None
    columns, timing = sample_columns(blocks, str(path))
    for name in IMPORTED_COLUMNS:
        values = _imported_column(bag, name, path)
        if values is not None and len(values) == len(columns["time_s"]):
            columns[name] = values
    notes = list(info.get("notes", ()))
    if bag.recovered:
        notes.append(f"the bag was not closed: {len(columns['time_s'])} samples recovered")
    if timing["lost"]:
        notes.append(f"{timing['lost']} samples are missing by their sequence numbers")
    if unread := timing.pop("unread_temperatures", 0):
        notes.append(f"the temperature is left out: the thermometer could not be read at {unread} samples")
    info |= timing | {"format": bag.file.suffix.lstrip("."), "topic": topic, "recovered": bag.recovered, "notes": notes}
    return Recording(columns, info)


BAG = FileFormat((".mcap", ".db3"), "a bag folder, an .mcap or .db3 file", read_bag_file, folders=True)


def samples_topic(bag: Bag, where: str) -> str:
    """Return the name of the topic of the samples: the one named ``samples``, or else the only one of their type.

    Raises
    ------
    InputError
        When there is none, or more than one.
    """
    candidates = [name for name, topic in bag.topics.items() if topic.message_type == SAMPLES_TYPE]
    if not candidates:
        topics = [f"{name} ({topic.message_type})" for name, topic in sorted(bag.topics.items())]
        present = one_line(", ".join(topics)) if topics else "none"
        raise InputError(
            f"{where}: holds no topic of type {SAMPLES_TYPE}; topics in it: {present} "
            f"(`{command('mrd_runs', 'import')}` reads bags of other benches)"
        )
    named_samples = [name for name in candidates if name.rsplit("/", 1)[-1] == "samples"]
    if len(named_samples or candidates) > 1:
        raise InputError(f"{where}: holds several topics of samples ({one_line(', '.join(candidates))}); expected one")
    return (named_samples or candidates)[0]


def _imported_column(bag: Bag, name: str, path: Path) -> Array | None:
    for topic, entry in bag.topics.items():
        if topic.endswith(f"/imported/{name}") and entry.messages:
            try:
                return np.concatenate([np.asarray(message.data, np.float64) for message in bag.decode(topic)])
            except Exception as error:  # as above
                raise InputError(f"{path}: the messages of {one_line(topic)} cannot be read ({one_line(error)})") from None
    return None
