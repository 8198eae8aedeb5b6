"""A run from the samples that are heard on a topic, decoded as those in a bag are."""

from collections import deque

import numpy as np

from mrd_base import InputError
from mrd_runs.blocks import Blocks, decode_blocks
from mrd_runs.check import make_run
from mrd_runs.definitions import typestore
from mrd_runs.read import assemble
from mrd_runs.run import Run


class HeardSamples:
    """Keeps the serialised BenchSamples that it is given, at most ``most`` blocks, and makes a run of them.

    A sequence that starts again is another recording, live or replayed: only the latest is kept for the run.
    """

    def __init__(self, most: int) -> None:
        self._messages: deque[bytes] = deque(maxlen=most)

    def __len__(self) -> int:
        return len(self._messages)

    def append(self, message: bytes) -> None:
        """Keep one block."""
        self._messages.append(message)

    def run(self, name: str) -> Run:
        """The latest recording heard.

        Raises
        ------
        InputError
            When nothing or too little was heard.
        """
        if not self._messages:
            raise InputError("no samples were heard; start the DAQ or a replay, or name recorded runs")
        blocks = _latest_recording(decode_blocks(list(self._messages), typestore()))
        columns, timing = assemble(blocks, name)
        return make_run(name, columns, timing | {"source": "live samples", "format": "live"})


def _latest_recording(blocks: Blocks) -> Blocks:
    """The blocks since the sequence last started again."""
    restarts = np.flatnonzero(np.diff(blocks.sequence) <= 0) + 1
    first = int(restarts[-1]) if restarts.size else 0
    skipped = int(blocks.count[:first].sum())
    return Blocks(
        blocks.stamp[first:],
        blocks.period[first:],
        blocks.sequence[first:],
        blocks.count[first:],
        {name: values[skipped:] for name, values in blocks.series.items()},
    )
