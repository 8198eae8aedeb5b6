"""Check of a closed bag: whether it holds every message that was written and every sample that was sent."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mrd_base import InputError
from mrd_runs.bag import read_bag
from mrd_runs.blocks import Blocks, decode_blocks
from mrd_runs.text import one_line


@dataclass(frozen=True)
class Completeness:
    """Completeness of the samples in a closed bag.

    Attributes
    ----------
    samples, lost : int
        Number of samples in the bag, and number of samples missing by their sequence numbers.
    duration : float
        From the first to the last sample, in s.
    problem : str
        One line about what is incomplete; empty when the recording is complete.
    """

    samples: int
    lost: int
    duration: float
    problem: str = ""


def check_completeness(path: Path, topic: str, written: Mapping[str, int]) -> Completeness:
    """Read a closed bag back and count its messages and samples.

    Parameters
    ----------
    path : Path
        The bag.
    topic : str
        Topic of the samples.
    written : mapping of str to int
        Number of messages written to each topic.
    """
    try:
        bag = read_bag(path)
    except InputError as error:
        return Completeness(0, 0, 0.0, str(error))
    try:
        blocks = decode_blocks(bag.topics[topic].messages, bag.types)
    except Exception as error:  # rosbags raises many kinds
        return Completeness(0, 0, 0.0, f"{path}: the messages of {topic} cannot be read ({one_line(error)})")
    samples = int(blocks.count.sum())
    missing_messages = [
        f"{written[name] - len(entry.messages)} of {name}"
        for name, entry in bag.topics.items()
        if len(entry.messages) != written.get(name, 0)
    ]
    problem = ""
    if missing_messages:
        problem = f"{path}: messages are missing in the file: {', '.join(missing_messages)}"
    elif samples == 0:
        problem = f"{path}: no sample arrived while it recorded; is the daq running?"
    elif blocks.lost:
        problem = f"{path}: {blocks.lost} of {samples + blocks.lost} samples are missing by their sequence numbers"
    elif (blocks.sequence_jumps < 0).any():
        problem = f"{path}: the daq restarted its sample numbers during the recording; its time has a break there"
    return Completeness(samples, blocks.lost, _duration(blocks), problem)


def _duration(blocks: Blocks) -> float:
    if not blocks.count.sum():
        return 0.0
    last_block = (blocks.count[-1] - 1) * blocks.period[-1]
    return float(1e-9 * (blocks.stamp[-1] - blocks.stamp[0]) + last_block)
