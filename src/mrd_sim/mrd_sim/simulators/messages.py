"""Messages between the bench and the process of a simulator: a line of JSON, then an array of numbers."""

import json
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def write_message(stream: IO[bytes], header: Mapping[str, Any], numbers: Array) -> None:
    """Write a message.

    Parameters
    ----------
    stream : binary stream
    header : mapping
        What can be said in JSON.
    numbers : ndarray
    """
    content = np.ascontiguousarray(numbers, np.float64)
    stream.write(json.dumps({**header, "shape": content.shape}).encode() + b"\n")
    if content.size:
        stream.write(content.tobytes())
    stream.flush()


def read_message(stream: IO[bytes]) -> tuple[dict[str, Any], Array] | None:
    """Read a message; None where the stream ends.

    Raises
    ------
    ValueError
        When the stream ends within a message.
    """
    line = stream.readline()
    if not line:
        return None
    header: dict[str, Any] = json.loads(line)
    numbers = np.empty(header["shape"])
    if not numbers.size:
        return header, numbers
    content = stream.read(numbers.nbytes)
    if len(content) < numbers.nbytes:
        raise ValueError("the stream ended within a message")
    return header, np.frombuffer(content).reshape(numbers.shape)
