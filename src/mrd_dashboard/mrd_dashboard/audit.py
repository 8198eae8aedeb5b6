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
"""s in which what needs no session is logged once for each address: else anybody could fill the disk."""


class AuditLog:
    """A file with one JSON object a line, to which lines are only appended.

    Parameters
    ----------
    path : Path
        The file; its folder is made.
    clock : callable
        Time in s, by which actions are counted as repeated.

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
        # When such an action was logged, and how many followed, by who, action, and kind.
        self._seldom: dict[tuple[str, str, int], tuple[float, int]] = {}
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

    def write_seldom(self, who: str, action: str, detail: str, result: str, kind: int = 0) -> None:
        """Append an action that needs no session; those like it are only counted for `REPEATED_AFTER`."""
        now = self._clock()
        for key, (logged, more) in list(self._seldom.items()):
            if now >= logged + REPEATED_AFTER:
                self._write_number(key, more)
                del self._seldom[key]
        logged, more = self._seldom.get((who, action, kind), (now, -1))
        self._seldom[who, action, kind] = logged, more + 1
        if more < 0:
            self.write(who, action, detail, result)

    def write_refusal(self, address: str, status: int, path: str, reason: str) -> None:
        """Append a request that did not reach the page, unless one like it was logged a moment ago."""
        self.write_seldom(address, "request", path[:200], f"refused: {reason}", status)

    def _write_number(self, key: tuple[str, str, int], more: int) -> None:
        if more:
            self.write(*key[:2], "", f"{more} more like it within {REPEATED_AFTER:.0f} s")

    def close(self) -> None:
        """Close the file."""
        for key, (_, more) in self._seldom.items():
            self._write_number(key, more)
        os.close(self._descriptor)
