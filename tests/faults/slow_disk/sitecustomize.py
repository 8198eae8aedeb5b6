"""Python imports this in the nodes of the fault campaign: while a file is there, `fsync` takes a second."""

import os
import time

_fsync = os.fsync


def _slow_fsync(descriptor: int) -> None:
    if os.path.exists(os.environ.get("MRD_SLOW_DISK", "")):
        time.sleep(1.0)
    _fsync(descriptor)


os.fsync = _slow_fsync
