"""Exporting: the samples of a recording, and what was commanded meanwhile, become CSV files."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_runs.bag import Bag, read_bag
from mrd_runs.formats import BAG, file_format
from mrd_runs.text import one_line

Array = NDArray[np.float64]

# Topics that are exported beside the samples, and the columns that their fields become.
_OTHER_TOPICS = ("setpoint", "servo_state")
_COLUMNS = {
    "position": "position_m",
    "velocity": "velocity_mps",
    "acceleration": "acceleration_mps2",
    "coil_current": "current_A",
    "following_error": "following_error_m",
    "bus_voltage": "bus_voltage_V",
    "temperature": "temperature_C",
}


def export_csv(source: Path, target: Path, tell: Callable[[str], object] = ignore) -> dict[Path, int]:
    """Write the samples of a recording as a CSV file, and its setpoints and servo states into files beside it.

    `read_run` reads the samples again bit by bit. The other files have their own rows, on the same time.

    Parameters
    ----------
    source : Path
        A recording in any format.
    target : Path
        The CSV file; those beside it are called ``NAME.setpoint.csv`` and ``NAME.servo_state.csv``.
    tell : callable, optional
        Takes a line about what a CSV file cannot say.

    Returns
    -------
    dict of Path to int
        The files and their numbers of rows.

    Raises
    ------
    InputError
        When the recording is unusable, or a file exists or cannot be written. No file is left behind then.
    """
    kind = file_format(source)
    recording = kind.read(source)
    if "clocks" in recording.info:
        tell(f"{target}: does not say that the clocks of its channels are not known to agree; the bag does")
    tables = {target: recording.columns}
    if kind is BAG:
        bag = read_bag(source, set(_OTHER_TOPICS))
        for name in _OTHER_TOPICS:
            columns = _topic_columns(bag, name, recording.info.get("first_stamp_s", 0.0), source)
            if columns:
                tables[target.with_name(f"{target.stem}.{name}{target.suffix}")] = columns
    for path in tables:
        if path.exists():
            raise InputError(f"{path}: exists already and is not overwritten; give another --output or remove it")
    written: list[Path] = []
    try:
        for path, columns in tables.items():
            written.append(path)
            write_columns(path, columns)
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise
    return {path: len(columns["time_s"]) for path, columns in tables.items()}


def write_columns(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns with all their digits; a file that is not complete has another name.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("w", encoding="utf-8") as stream:
            stream.write(",".join(columns) + "\n")
            for row in np.column_stack(list(columns.values())).tolist():
                stream.write(",".join(map(repr, row)) + "\n")
        part.rename(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def _topic_columns(bag: Bag, name: str, start: float, source: Path) -> dict[str, Array]:
    """Return the numbers in the messages of a topic as columns, with the time since ``start`` in s; none without them."""
    topic = next((topic for topic, entry in bag.topics.items() if topic.rsplit("/", 1)[-1] == name and entry.messages), None)
    if topic is None:
        return {}
    try:
        messages = bag.decode(topic)
        columns = {
            "time_s": [message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec - start for message in messages]
        }
        for field in vars(messages[0]):
            if isinstance(getattr(messages[0], field), bool | int | float):
                columns[_COLUMNS.get(field, field)] = [getattr(message, field) for message in messages]
        return {key: np.array(values, np.float64) for key, values in columns.items()}
    except Exception as error:  # rosbags raises many kinds, and the message may be of another type
        raise InputError(f"{source}: the messages of {one_line(topic)} cannot be read ({one_line(error)})") from None
