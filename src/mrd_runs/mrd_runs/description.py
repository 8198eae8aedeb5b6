"""What a recording says of itself: the first message of every bag, and the check when it is closed."""

import importlib.metadata
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mrd_base import InputError
from mrd_runs.bag import read_bag
from mrd_runs.blocks import decode_blocks

_PACKAGES = ("mrd_runs", "numpy", "rosbags", "mcap")


def run_info(**facts: Any) -> str:
    """JSON of the ``run_info`` message: ``facts``, the start date, the versions of what records."""
    versions = {"python": platform.python_version(), "ros": os.environ.get("ROS_DISTRO", "none")}
    for package in _PACKAGES:
        versions[package] = importlib.metadata.version(package)
    started = datetime.now(UTC).isoformat(timespec="seconds")
    return json.dumps({"schema": 1, "started": started, "versions": versions, **facts}, allow_nan=False)


def describe_calibration(message: Any) -> dict[str, Any]:
    """Calibration message as plain values: by quantity, and the device."""
    columns = zip(message.quantity, message.unit, message.channel, message.gain, message.zero, strict=False)
    described: dict[str, Any] = {
        quantity: {"unit": unit, "channel": channel, "gain": float(gain), "zero_V": float(zero)}
        for quantity, unit, channel, gain, zero in columns
    }
    return described | {
        "device": message.device,
        "rate_hz": float(message.rate),
        "hardware_rate_hz": float(message.hardware_rate),
    }


@dataclass(frozen=True)
class Recorded:
    """What a closed bag really holds of the samples.

    Attributes
    ----------
    samples, lost : int
        Present; missing by their sequence numbers.
    duration : float
        s, from the first to the last sample.
    problem : str
        Why the recording is not complete, in one line; empty when it is.
    """

    samples: int
    lost: int
    duration: float
    problem: str = ""


def check_recording(path: Path, topic: str, counts: Mapping[str, int]) -> Recorded:
    """Read a closed bag back and count.

    Parameters
    ----------
    path : Path
        The bag.
    topic : str
        Name of the topic of the samples.
    counts : mapping of str to int
        Messages handed to the writer, by topic.
    """
    try:
        bag = read_bag(path)
        blocks = decode_blocks(bag.topics[topic].messages, bag.types)
    except InputError as error:
        return Recorded(0, 0, 0.0, str(error))
    samples = int(blocks.count.sum())
    missing = blocks.sequence[1:] - (blocks.sequence + blocks.count)[:-1]
    lost = int(missing[missing > 0].sum())
    short = [
        f"{counts[name] - len(entry.messages)} of {name}"
        for name, entry in bag.topics.items()
        if len(entry.messages) != counts.get(name, 0)
    ]
    problem = ""
    if short:
        problem = f"{path}: messages are missing in the file: {', '.join(short)}"
    elif samples == 0:
        problem = f"{path}: no sample arrived while it recorded; is the daq running?"
    elif lost:
        problem = f"{path}: {lost} of {samples + lost} samples are missing by their sequence numbers"
    elif (missing < 0).any():
        problem = f"{path}: the daq counted its samples anew while it recorded; its time has a break there"
    duration = 0.0
    if samples:
        length = (blocks.count[-1] - 1) * blocks.period[-1]
        duration = float(1e-9 * (blocks.stamp[-1] - blocks.stamp[0]) + length)
    return Recorded(samples, lost, duration, problem)
