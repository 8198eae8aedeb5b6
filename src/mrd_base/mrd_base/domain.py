"""A ROS domain of one's own: simulated benches and tests must never hear a real one, nor each other."""

import fcntl
import os
import tempfile
from pathlib import Path

_LAST = 101  # higher domains share their ports with the system's short-lived ones
_claims: list[int] = []


def claim_domain() -> int:
    """Put this process and its children into a domain that no other caller on this machine has, until the process ends.

    Sets ``ROS_DOMAIN_ID`` in the environment; call it before ROS starts.

    Returns
    -------
    int
        The domain, 1 to 101.

    Raises
    ------
    RuntimeError
        When all are taken.
    """
    for offset in range(_LAST):
        domain = 1 + (os.getpid() + offset) % _LAST
        try:
            claim = os.open(Path(tempfile.gettempdir(), f"mrd_domain_{domain}.lock"), os.O_CREAT | os.O_RDWR, 0o666)
        except OSError:  # another user's
            continue
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(claim)
            continue
        _claims.append(claim)
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")  # env.sh has its own way to that
        return domain
    raise RuntimeError(f"all ROS domains from 1 to {_LAST} are taken by other simulated benches and tests")
