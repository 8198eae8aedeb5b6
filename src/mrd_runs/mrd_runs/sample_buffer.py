"""A run from the samples that are received on a topic, decoded as those in a bag are."""

from collections import deque

import numpy as np

from mrd_base import InputError
from mrd_runs.blocks import decode_blocks, sample_columns
from mrd_runs.definitions import typestore
from mrd_runs.run import Run
from mrd_runs.validation import make_run


class SampleBuffer:
    """Keeps the latest serialised BenchSamples messages and makes a run of them.

    Parameters
    ----------
    max_blocks : int
        Number of messages kept.
    """

    def __init__(self, max_blocks: int) -> None:
        self._messages: deque[bytes] = deque(maxlen=max_blocks)

    def __len__(self) -> int:
        return len(self._messages)

    def append(self, message: bytes) -> None:
        """Keep a message."""
        self._messages.append(message)

    def run(self, name: str) -> Run:
        """Return the latest recording: the samples since their sequence numbers last started again.

        Raises
        ------
        InputError
            When no or too few samples were received.
        """
        if not self._messages:
            raise InputError("no samples were heard; start the DAQ or a replay, or name recorded runs")
        blocks = decode_blocks(list(self._messages), typestore())
        restarts = np.flatnonzero(np.diff(blocks.sequence) <= 0) + 1
        columns, timing = sample_columns(blocks.starting_at(int(restarts[-1]) if restarts.size else 0), name)
        return make_run(name, columns, timing | {"source": "live samples", "format": "live"})
