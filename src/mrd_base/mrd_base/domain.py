"""An exclusive ROS domain for a process, so that simulated benches and tests neither reach a real bench nor each other.

Two that must share a domain have different namespaces in it.
"""

import fcntl
import os
import tempfile
from pathlib import Path

# Higher domains use ports that Linux also gives to short-lived connections.
_LAST_DOMAIN = 101
# Port of the first domain, and how many each has.
_FIRST_PORT, _PORTS_OF_DOMAIN = 7400, 250


def domains_in_use() -> set[int]:
    """Return the domains that ROS programs of this machine are in, by their UDP ports (DDSI-RTPS 2.5, section 9.6.2)."""
    lines = Path("/proc/net/udp").read_text().splitlines()[1:]
    ports = [int(line.split()[1].rpartition(":")[2], 16) for line in lines]
    return {(port - _FIRST_PORT) // _PORTS_OF_DOMAIN for port in ports if port >= _FIRST_PORT}


def claim_domain() -> int:
    """Put this process and its children into a ROS domain that no other program on this machine has.

    Sets ``ROS_DOMAIN_ID`` in the environment; call it before ROS is started. The domain is free again when the process ends.

    Returns
    -------
    int
        The domain, 1 to 101.

    Raises
    ------
    RuntimeError
        When all domains are in use.
    """
    in_use = domains_in_use()  # a bench that was given its domain has no lock on it
    for offset in range(_LAST_DOMAIN):
        domain = 1 + (os.getpid() + offset) % _LAST_DOMAIN
        if domain in in_use:
            continue
        try:
            lock = os.open(Path(tempfile.gettempdir(), f"mrd_domain_{domain}.lock"), os.O_CREAT | os.O_RDWR, 0o666)
        except OSError:  # the file belongs to another user
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        # The lock's file descriptor stays open, and the domain is taken, until the process ends.
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")  # env.sh configures the middleware instead
        return domain
    raise RuntimeError(f"all ROS domains from 1 to {_LAST_DOMAIN} are used by other simulated benches and tests")


def present_domain() -> str:
    """Return the ROS domain of this process."""
    return os.environ.get("ROS_DOMAIN_ID", "0")


def claim_name(name: str) -> int | None:
    """Keep the name of a node, or a namespace, of the present ROS domain for this process, on this machine.

    ROS takes seconds to find others, so that of two that are started together neither would find the other.

    Returns
    -------
    int or None
        A file descriptor, which keeps the name until it is closed or the process ends; None if the name is taken.
    """
    file = f"mrd_bench_{present_domain()}_{name.strip('/').replace('/', '.')}.lock"
    path = Path(tempfile.gettempdir(), file)
    try:
        lock = os.open(path, os.O_RDONLY)  # to lock a file, nobody needs to own it
    except FileNotFoundError:
        lock = os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        return None
    return lock
