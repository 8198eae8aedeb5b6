"""The audit log: who asked for what, when, and with what result."""

import json
import os
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any


class AuditLog:
    """A file with one JSON object a line, to which lines are only appended.

    Parameters
    ----------
    path : Path
        The file; its folder is made.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        self.path = path

    def write(self, who: str, action: str, detail: str = "", result: str = "") -> None:
        """Append an action; the line is complete even if the process is killed right afterwards."""
        entry: dict[str, Any] = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "who": who, "action": action}
        entry |= {name: text for name, text in (("detail", detail), ("result", result)) if text}
        with self._lock:
            os.write(self._descriptor, (json.dumps(entry, ensure_ascii=False) + "\n").encode())

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)
