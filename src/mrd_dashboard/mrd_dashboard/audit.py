"""The audit log: who asked for what, when, and with what result."""

import json
import os
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

REPEATED_AFTER = 60.0
"""s in which refused requests of one address are logged once: else anybody could fill the disk."""


class AuditLog:
    """A file with one JSON object a line, to which lines are only appended.

    Parameters
    ----------
    path : Path
        The file; its folder is made.
    clock : callable
        Time in s, by which refusals are counted as repeated.

    Attributes
    ----------
    path : Path
    problem : str
        Why the latest line could not be written, or "". A full disk must not keep anybody from stopping the bench.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        self._clock = clock
        self._refused: dict[tuple[str, int], float] = {}
        self.path = path
        self.problem = ""

    def write(self, who: str, action: str, detail: str = "", result: str = "") -> None:
        """Append an action; the line is complete even if the process is killed right afterwards."""
        entry: dict[str, Any] = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "who": who, "action": action}
        entry |= {name: text for name, text in (("detail", detail), ("result", result)) if text}
        try:
            with self._lock:
                os.write(self._descriptor, (json.dumps(entry, ensure_ascii=False) + "\n").encode(errors="replace"))
            self.problem = ""
        except OSError as error:
            self.problem = f"{self.path}: {error.strerror}; what is done is not logged"

    def write_refusal(self, address: str, status: int, path: str, reason: str) -> None:
        """Append a request that did not reach the page, unless one like it was logged a moment ago."""
        now = self._clock()
        self._refused = {key: last for key, last in self._refused.items() if now < last + REPEATED_AFTER}
        if (address, status) not in self._refused:
            self._refused[address, status] = now
            self.write(address, "request", path[:200], f"refused: {reason}")

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)
