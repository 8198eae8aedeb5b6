"""Facts about a recording: the message ``run_info``, with which every bag starts, and the calibration."""

import importlib.metadata
import json
import os
import platform
from datetime import UTC, datetime
from typing import Any

from mrd_base import InputError
from mrd_base.config import parse_yaml
from mrd_runs.bag import Bag

_PACKAGES = ("mrd_runs", "numpy", "rosbags", "mcap")


def format_run_info(**facts: Any) -> str:
    """Return the JSON text of a ``run_info`` message: the facts, the start date and the versions of the software."""
    versions = {"python": platform.python_version(), "ros": os.environ.get("ROS_DISTRO", "none")}
    for package in _PACKAGES:
        versions[package] = importlib.metadata.version(package)
    started = datetime.now(UTC).isoformat(timespec="seconds")
    return json.dumps({"schema": 1, "started": started, "versions": versions, **facts}, allow_nan=False)


def describe_calibration(message: Any) -> dict[str, Any]:
    """Return a Calibration message as plain values: an entry for each measured quantity, and the device."""
    rows = zip(message.quantity, message.unit, message.channel, message.gain, message.zero, strict=False)
    calibration: dict[str, Any] = {
        quantity: {"unit": unit, "channel": channel, "gain": float(gain), "zero_V": float(zero)}
        for quantity, unit, channel, gain, zero in rows
    }
    return calibration | {
        "device": message.device,
        "rate_hz": float(message.rate),
        "hardware_rate_hz": float(message.hardware_rate),
    }


def read_run_info(bag: Bag) -> dict[str, Any]:
    """Return the facts in the last ``run_info`` and the last ``calibration`` message of a bag."""
    info: dict[str, Any] = {}
    message = _last_message(bag, "run_info")
    if message is not None:
        content = json.loads(message.data)
        info |= content if isinstance(content, dict) else {}
    experiment = info.get("experiment")
    if experiment:
        try:
            info["experiment_name"] = parse_yaml(str(experiment), "experiment").get("name", "")
        except InputError:
            info["experiment_name"] = ""
    calibration = _last_message(bag, "calibration")
    if calibration is not None:
        info["calibration"] = describe_calibration(calibration)
    return info


def _last_message(bag: Bag, name: str) -> Any:
    """Return the last message of the topic whose name ends with ``name``; None without one."""
    for topic, entry in bag.topics.items():
        if topic.rsplit("/", 1)[-1] == name and entry.messages:
            return bag.types.deserialize_cdr(entry.messages[-1], entry.message_type)
    return None
