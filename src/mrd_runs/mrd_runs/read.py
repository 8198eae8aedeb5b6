"""`read_run`: a run from whatever holds it."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import parse_yaml
from mrd_runs.bag import Bag, read_bag
from mrd_runs.blocks import Blocks, decode_blocks
from mrd_runs.check import make_run
from mrd_runs.csv_file import read_csv
from mrd_runs.definitions import SAMPLES_TYPE
from mrd_runs.description import describe_calibration
from mrd_runs.run import Run

Array = NDArray[np.float64]

# Topics of an imported CSV that blocks of equally spaced samples cannot carry: the exact value of each sample.
IMPORTED = ("time_s", "velocity_mps", "temperature_C")


def read_run(path: str | Path) -> Run:
    """Read a recording.

    Parameters
    ----------
    path : path
        A bag folder, an ``.mcap`` or ``.db3`` file, or a CSV file with the header ``time_s,position_m,current_A,force_N``
        and optionally ``acceleration_mps2``, ``velocity_mps``, ``temperature_C``.

    Returns
    -------
    Run
        ``info`` holds ``source``, ``format``, ``checksum`` (of the samples, whatever file they are in), ``notes``,
        ``lost`` (samples missing by their sequence numbers),
        ``recovered`` (whether the bag had not been closed), and for a bag what it says of itself: ``experiment``,
        ``experiment_name``, ``calibration``, ``versions``, ``seed``, ``started``, ``jitter_s``.

    Raises
    ------
    InputError
        For anything that is no usable recording, in one line.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; expected a bag folder, an .mcap, .db3 or .csv file")
    if path.is_dir() or path.suffix in {".mcap", ".db3"}:
        return _read_bag_run(path)
    if path.suffix.lower() not in {".csv", ".txt", ""}:
        raise InputError(f"{path}: unknown kind of file; expected a bag folder, an .mcap, .db3 or .csv file")
    columns, notes, lines = read_csv(path)
    info: dict[str, Any] = {"source": str(path), "format": "csv", "checksum": _checksum(columns)}
    info |= {"notes": notes, "lost": 0, "recovered": False}
    return make_run(path.stem, columns, info, where=str(path), place=lambda index: f"line {lines[index]}")


def read_runs(paths: Iterable[str | Path]) -> list[Run]:
    """Read recordings and give each a name of its own.

    Raises
    ------
    InputError
        As `read_run`; also when two paths hold the same recording.
    """
    runs: list[Run] = []
    for path in paths:
        run = read_run(path)
        for other in runs:
            if other.info["checksum"] == run.info["checksum"]:
                raise InputError(f"{path}: is the same recording as {other.info['source']}; give each recording once")
        taken = {other.name for other in runs}
        if run.name in taken:
            base = f"{Path(path).resolve().parent.name}/{run.name}"
            run = replace(run, name=next(name for name in _candidates(base) if name not in taken))
        runs.append(run)
    return runs


def _candidates(base: str) -> Iterable[str]:
    yield base
    number = 2
    while True:
        yield f"{base}-{number}"
        number += 1


def _checksum(columns: Mapping[str, Array]) -> str:
    """Of what was measured, so that a CSV file and the bag made of it are the same recording."""
    digest = hashlib.sha256()
    for name in ("time_s", "position_m", "current_A", "force_N"):
        values = np.ascontiguousarray(columns[name], np.float64)
        # Time counts from the first sample, as in a Run.
        digest.update((values - values[:1] if name == "time_s" else values).tobytes())
    return digest.hexdigest()


def samples_topic(bag: Bag, where: str) -> str:
    """Name of the topic that holds the samples.

    Raises
    ------
    InputError
        When there is none, or more than one.
    """
    found = [name for name, topic in bag.topics.items() if topic.message_type == SAMPLES_TYPE]
    if not found:
        present = ", ".join(f"{name} ({topic.message_type})" for name, topic in sorted(bag.topics.items())) or "none"
        raise InputError(f"{where}: holds no topic of type {SAMPLES_TYPE}; topics in it: {present}")
    preferred = [name for name in found if name.rsplit("/", 1)[-1] == "samples"]
    if len(preferred or found) > 1:
        raise InputError(f"{where}: holds several topics of samples ({', '.join(found)}); expected one")
    return (preferred or found)[0]


def _read_bag_run(path: Path) -> Run:
    where = str(path)
    bag = read_bag(path, {"samples", "run_info", "calibration", *IMPORTED})
    topic = samples_topic(bag, where)
    if topic.rsplit("/", 1)[-1] != "samples":  # recorded under another name
        bag = read_bag(path)
    try:
        blocks = decode_blocks(bag.topics[topic].messages, bag.types)
    # A damaged message or a definition of other fields: rosbags raises whatever the bytes lead to.
    except Exception as error:
        raise InputError(f"{where}: the messages of {topic} cannot be read ({' '.join(str(error).split())})") from None
    try:
        info = _self_description(bag)
    except Exception as error:
        problem = " ".join(str(error).split())
        raise InputError(f"{where}: run_info or calibration cannot be read ({problem})") from None
    columns, timing = assemble(blocks, where)
    for name in IMPORTED:
        exact = _imported(bag, name)
        if exact is not None and len(exact) == len(columns["time_s"]):
            columns[name] = exact
    notes = list(info.get("notes", ()))
    if bag.recovered:
        notes.append(f"the bag was not closed: {len(columns['time_s'])} samples recovered")
    if timing["lost"]:
        notes.append(f"{timing['lost']} samples are missing by their sequence numbers")
    info |= timing | {"source": where, "format": bag.file.suffix.lstrip("."), "checksum": _checksum(columns)}
    info |= {"topic": topic, "recovered": bag.recovered, "notes": notes}
    return make_run(path.stem if path.is_file() else path.resolve().name, columns, info, where=where)


def assemble(blocks: Blocks, where: str) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns of the samples for `make_run`, on the clock of the DAQ, and what the stamps say of it.

    Parameters
    ----------
    blocks : Blocks
        In the order of recording.
    where : str
        Prefix of error messages.

    Returns
    -------
    columns : dict of str to ndarray (n,)
    timing : dict
        ``lost`` samples by their numbers, ``jitter_s`` of the stamps about the sample clock, ``first_stamp_s``.
    """
    columns = {
        "position_m": blocks.series["position"],
        "current_A": blocks.series["coil_current"],
        "force_N": blocks.series["force"],
        "acceleration_mps2": blocks.series["acceleration"],
    }
    # A bench without accelerometer says so with NaN.
    if np.isnan(columns["acceleration_mps2"]).all():
        del columns["acceleration_mps2"]
    if len(blocks.stamp) == 0:
        return {"time_s": np.empty(0), **columns}, {"lost": 0, "jitter_s": 0.0}
    usable = np.isfinite(blocks.period) & (blocks.period > 0)
    if not usable.all():
        index = int(np.argmin(usable))
        raise InputError(f"{where}: block {index} has the sample period {blocks.period[index]} s, expected a positive one")
    missing = blocks.sequence[1:] - (blocks.sequence + blocks.count)[:-1]
    since = 1e-9 * (blocks.stamp - blocks.stamp[0])
    # One stretch is as long as one clock counts on: the DAQ was not restarted, its rate not changed. Within it, sample
    # numbers tell the time; between stretches the stamps do.
    cuts = np.flatnonzero((missing < 0) | (np.abs(np.diff(blocks.period)) > 1e-9 * blocks.period[0])) + 1
    time, jitter = [], 0.0
    for first, last in zip([0, *cuts], [*cuts, len(since)], strict=True):
        # Dividing by a whole rate gives 0.007, multiplying by the period 0.007000000000000001.
        rate = 1 / blocks.period[first]
        rate = round(rate) if abs(rate - round(rate)) < 1e-6 * rate else rate
        count = blocks.count[first:last]
        numbers = blocks.sequence[first:last] - blocks.sequence[first]
        jitter = max(jitter, float(np.std(since[first:last] - numbers / rate)))
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        time.append(since[first] + (np.repeat(numbers, count) + within) / rate)
    timing = {"lost": int(missing[missing > 0].sum()), "jitter_s": jitter, "first_stamp_s": float(blocks.stamp[0] * 1e-9)}
    return {"time_s": np.concatenate(time), **columns}, timing


def _last(bag: Bag, name: str) -> Any:
    """Last message of the topic with this last part of its name."""
    for topic, entry in bag.topics.items():
        if topic.rsplit("/", 1)[-1] == name and entry.messages:
            return bag.types.deserialize_cdr(entry.messages[-1], entry.message_type)
    return None


def _imported(bag: Bag, name: str) -> Array | None:
    for topic, entry in bag.topics.items():
        if topic.endswith(f"/imported/{name}") and entry.messages:
            return np.concatenate([np.asarray(message.data, np.float64) for message in bag.decode(topic)])
    return None


def _self_description(bag: Bag) -> dict[str, Any]:
    """What the bag says of itself, in the last run_info and the last calibration."""
    info: dict[str, Any] = {}
    message = _last(bag, "run_info")
    if message is not None:
        content = json.loads(message.data)
        info |= content if isinstance(content, dict) else {}
    experiment = info.get("experiment")
    if experiment:
        try:
            info["experiment_name"] = parse_yaml(str(experiment), "experiment").get("name", "")
        except InputError:
            info["experiment_name"] = ""
    calibration = _last(bag, "calibration")
    if calibration is not None:
        info["calibration"] = describe_calibration(calibration)
    return info
