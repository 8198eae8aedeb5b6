"""Facts about a recording: the message ``run_info``, with which every bag starts, and the calibration."""

import importlib.metadata
import json
import os
import platform
from datetime import UTC, datetime
from typing import Any

import yaml

from mrd_base.version import VERSION
from mrd_runs.bag import Bag
from mrd_runs.text import one_line

_LIBRARIES = ("numpy", "rosbags")
# Characters of an experiment in which its name is looked for; the parser takes some seconds for them.
_LONGEST_EXPERIMENT = 2**18


def format_run_info(**facts: Any) -> str:
    """Return the JSON text of a ``run_info`` message: the facts, the start date and the versions of the software."""
    versions = {"mrd_runs": VERSION, "python": platform.python_version(), "ros": os.environ.get("ROS_DISTRO", "none")}
    for package in _LIBRARIES:
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
        info |= _known_kinds(json.loads(message.data))
    if info.get("experiment"):
        info["experiment_name"] = _experiment_name(str(info["experiment"]))
    if ended := _early_end(bag):
        info["ended"] = ended
    calibration = _last_message(bag, "calibration")
    if calibration is not None:
        info["calibration"] = describe_calibration(calibration)
    return info


def _known_kinds(content: Any) -> dict[str, Any]:
    """Return the facts of the kinds that a recorder writes; a stranger's bag may hold anything."""
    if not isinstance(content, dict):
        return {}
    facts: dict[str, Any] = {
        name: value
        for name, value in content.items()
        if isinstance(value, str | int | float) and name not in ("versions", "notes", "calibration")
    }
    versions, notes, calibration = (content.get(name) for name in ("versions", "notes", "calibration"))
    clocks = content.get("clocks")
    if isinstance(clocks, dict):
        facts["clocks"] = {name: one_line(clock) for name, clock in clocks.items() if isinstance(clock, str)}
    if isinstance(versions, dict):
        facts["versions"] = {name: value for name, value in versions.items() if isinstance(value, str)}
    if isinstance(notes, list):
        facts["notes"] = [note for note in notes if isinstance(note, str)]
    if isinstance(calibration, dict):
        facts["calibration"] = {name: entry for name, entry in calibration.items() if _is_calibration(entry)}
    return facts


def _is_calibration(entry: Any) -> bool:
    if not isinstance(entry, dict):
        return isinstance(entry, str | int | float)
    numbers, texts = (entry.get("gain"), entry.get("zero_V")), (entry.get("unit"), entry.get("channel"))
    return all(isinstance(value, int | float) for value in numbers) and all(isinstance(value, str) for value in texts)


def _experiment_name(text: str) -> str:
    """Return the name of an experiment; "" where the text is none."""
    if len(text) > _LONGEST_EXPERIMENT:
        return ""
    try:
        # The base loader makes texts only, and expands no merge keys, which may nest exponentially.
        content = yaml.load(text, yaml.BaseLoader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return ""
    name = content.get("name", "") if isinstance(content, dict) else ""
    return one_line(name) if name and isinstance(name, str) else ""


def _early_end(bag: Bag) -> str:
    """Return on which condition the recorded experiment ended before its last pass; "" where it did not."""
    states = [str(getattr(message, "data", "")) for message in _messages(bag, "experiment_state")]
    # A bag begins with the state that was the latest one then, which may be of an earlier experiment.
    return one_line(states[-1].removeprefix("done: ")) if "running" in states and states[-1].startswith("done: ") else ""


def _last_message(bag: Bag, name: str) -> Any:
    """Return the last message of the topic whose name ends with ``name``; None without one."""
    messages = _messages(bag, name)
    return messages[-1] if messages else None


def _messages(bag: Bag, name: str) -> list[Any]:
    """Return the messages of the topic whose name ends with ``name``."""
    for topic, entry in bag.topics.items():
        if topic.rsplit("/", 1)[-1] == name and entry.messages:
            return [bag.types.deserialize_cdr(message, entry.message_type) for message in entry.messages]
    return []
