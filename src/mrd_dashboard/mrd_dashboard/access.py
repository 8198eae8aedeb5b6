"""Who may open the page: passwords and tokens, kept as hashes in a file, and the sessions that they open.

Without such a file the page is for whoever sits at this machine, and is not served to others.
"""

import base64
import hashlib
import hmac
import ipaddress
import math
import os
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from mrd_base import InputError, from_mapping, quantity, read_yaml, to_mapping

SESSION_TIME = 12 * 3600.0
"""s after which one has to log in again; a token that expires earlier ends its sessions, too."""
MOST_FAILURES, PAUSE = 5, 30.0
"""Wrong secrets in a row after which an address is refused for a time, and that time in s."""
SHORTEST_PASSWORD = 10
"""Characters of a password."""

# Cost of scrypt (Percival, 2009; RFC 7914): 64 MiB and a tenth of a second for each guess.
_N, _R, _P = 2**16, 8, 1
_MEMORY = 128 * _N * _R * 2


@dataclass(frozen=True)
class Token:
    """A link that lets in without password until it expires.

    Attributes
    ----------
    digest : str
        SHA-256 of the token; the token itself is random, so that no slow hash is needed.
    expires : float
        Unix time in s.
    """

    digest: str = quantity(doc="SHA-256 of the token, hexadecimal")
    expires: float = quantity(unit="s", doc="Unix time at which it expires")


@dataclass(frozen=True)
class Credentials:
    """What lets in: the content of an access file."""

    password: str = quantity("", "", "scrypt hash of the operator's password, as `access` writes it")
    tokens: tuple[Token, ...] = ()

    def valid_until(self, secret: str) -> float:
        """Return the Unix time in s until which a secret lets in: for ever for the password, -inf for a wrong one."""
        digest = hashlib.sha256(secret.encode()).hexdigest()
        # All tokens are compared, each in constant time.
        known = [token.expires for token in self.tokens if hmac.compare_digest(token.digest, digest)]
        if known:
            return max(known)
        return math.inf if self.password and password_matches(self.password, secret) else -math.inf


def hash_password(password: str) -> str:
    """Return the scrypt hash of a password, with its salt.

    Raises
    ------
    InputError
        For a password that is too short.
    """
    if len(password) < SHORTEST_PASSWORD:
        raise InputError(
            f"the password has {len(password)} characters, expected at least {SHORTEST_PASSWORD}; a few words do"
        )
    salt = secrets.token_bytes(16)
    return f"scrypt:{base64.b64encode(salt).decode()}:{base64.b64encode(_scrypt(password, salt)).decode()}"


def password_matches(stored: str, password: str) -> bool:
    """Return whether a password is the one whose hash is stored."""
    _, salt, digest = stored.split(":")
    return hmac.compare_digest(_scrypt(password, base64.b64decode(salt)), base64.b64decode(digest))


def _scrypt(password: str, salt: bytes) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=_N, r=_R, p=_P, maxmem=_MEMORY, dklen=32)


def read_credentials(path: str | Path) -> Credentials:
    """Read an access file.

    Raises
    ------
    InputError
        When it cannot be used, when it lets nobody in, or when other users of this machine can read it.
    """
    path = Path(path).expanduser()
    content = read_yaml(path)
    tokens = content.pop("tokens", [])
    if not isinstance(tokens, list):
        raise InputError(f"{path}: tokens: found {type(tokens).__name__}, expected a list; write it by the tool access")
    credentials = from_mapping(Credentials, content, str(path))
    credentials = replace(
        credentials, tokens=tuple(from_mapping(Token, entry, f"{path}: tokens[{i}]") for i, entry in enumerate(tokens))
    )
    if credentials.password and not _is_hash(credentials.password):
        raise InputError(f"{path}: password: expected a hash of the form scrypt:SALT:HASH; write it by the tool access")
    if not credentials.password and not credentials.tokens:
        raise InputError(f"{path}: has neither password nor tokens, so that nobody could enter; add one by the tool access")
    if os.stat(path).st_mode & 0o077:
        raise InputError(f"{path}: other users of this machine may read it; run: chmod 600 {path}")
    return credentials


def _is_hash(text: str) -> bool:
    parts = text.split(":")
    try:
        return len(parts) == 3 and parts[0] == "scrypt" and all(base64.b64decode(part, validate=True) for part in parts[1:])
    except ValueError:
        return False


def write_credentials(credentials: Credentials, path: Path) -> None:
    """Write an access file that only its owner can read."""
    content = to_mapping(replace(credentials, tokens=()))
    content["tokens"] = [to_mapping(token) for token in credentials.tokens]
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as stream:
        yaml.safe_dump(content, stream, sort_keys=False)
    part.replace(path)


def is_address(host: str) -> bool:
    """Return whether a host is given by its IP address, not by a name."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def is_local(host: str) -> bool:
    """Return whether only this machine reaches an address at which the page is served."""
    return host == "localhost" or (is_address(host) and ipaddress.ip_address(host).is_loopback)


def require_safe_host(host: str, credentials: Credentials | None) -> None:
    """Refuse to serve the page to other machines without password and token.

    Raises
    ------
    InputError
    """
    if credentials is None and not is_local(host):
        raise InputError(
            f"host {host} would give the page, and with it the bench, to everybody on the network; give a password by the "
            "parameter access (`ros2 run mrd_dashboard access FILE` writes such a file), or leave host at 127.0.0.1"
        )


class Sessions:
    """The browsers that have logged in.

    A session carries its end and a signature. The server keeps no list of them, so that nobody who opens many can push out
    that of another.

    Parameters
    ----------
    credentials : Credentials or None
        None lets everybody in.
    clock : callable
        Unix time in s.
    """

    def __init__(self, credentials: Credentials | None, clock: Callable[[], float] = time.time) -> None:
        self._credentials, self._clock = credentials, clock
        self._key = secrets.token_bytes(32)
        # End of each session that was closed before it.
        self._closed: dict[str, float] = {}
        # Number of wrong secrets in a row, and the time of the last one, by address.
        self._failures: dict[str, tuple[int, float]] = {}

    @property
    def needs_login(self) -> bool:
        """Whether one has to log in."""
        return self._credentials is not None

    def open(self, secret: str = "", address: str = "") -> str:
        """Return a new session for a password or a token; without credentials, for anybody, and without end.

        One call at a time: an address has `MOST_FAILURES` guesses in `PAUSE`, and others do not wait for it.

        Raises
        ------
        InputError
            For a wrong or expired secret, and after too many of them from an address.
        """
        now, end = self._clock(), math.inf
        if self._credentials is not None:
            self._failures = {who: known for who, known in self._failures.items() if now < known[1] + PAUSE}
            failures, last = self._failures.get(address, (0, now))
            if failures >= MOST_FAILURES:
                raise InputError(f"too many wrong passwords; wait {last + PAUSE - now:.0f} s and try again")
            valid_until = self._credentials.valid_until(secret)
            if now >= valid_until:
                self._failures[address] = failures + 1, now
                raise InputError(
                    "wrong password, or a token that is wrong or has expired; try again, or ask for a new token"
                )
            self._failures.pop(address, None)
            end = min(now + SESSION_TIME, valid_until)
        content = f"{secrets.token_urlsafe(12)}.{end:.0f}"
        return f"{content}.{self._sign(content)}"

    def _sign(self, content: str) -> str:
        return hmac.digest(self._key, content.encode(), "sha256").hex()

    def is_open(self, session: str) -> bool:
        """Return whether a session was opened here and has not ended."""
        content, _, signature = session.rpartition(".")
        signed = hmac.compare_digest(signature.encode(), self._sign(content).encode())
        return signed and session not in self._closed and self._clock() < _end_of(session)

    def close(self, session: str) -> None:
        """End a session, where one can log in again."""
        if self.needs_login and self.is_open(session):
            now = self._clock()
            self._closed = {closed: end for closed, end in self._closed.items() if now < end} | {session: _end_of(session)}


def _end_of(session: str) -> float:
    """Return the Unix time in s at which a session ends, which was opened here."""
    return float(session.split(".")[1])
