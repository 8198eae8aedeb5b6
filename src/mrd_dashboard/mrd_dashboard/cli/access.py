"""Write the password or a token that gives access to the operator's page."""

import argparse
import getpass
import hashlib
import secrets
import sys
import time
from dataclasses import replace
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_dashboard.access import Credentials, Token, hash_password, read_credentials, write_credentials


def main() -> None:
    """Entry point of ``ros2 run mrd_dashboard access``."""
    parser = argparse.ArgumentParser(prog="access", description=__doc__)
    parser.add_argument("file", type=Path, metavar="FILE", help="access file, for the parameter access of the page")
    parser.add_argument(
        "--token",
        type=float,
        metavar="HOURS",
        help="add a token that expires after HOURS and print it, instead of a password",
    )
    arguments = parser.parse_args()
    run_tool(lambda: _work(arguments.file, arguments.token))


def _work(file: Path, hours: float | None) -> None:
    known = read_credentials(file) if file.exists() else Credentials()
    if hours is None:
        write_credentials(replace(known, password=hash_password(_ask())), file)
        print(f"{file}: has the new password")
        return
    if not 0 < hours <= 24 * 366:
        raise InputError(f"--token is {hours:g}, expected hours above 0, at most a year")
    now, token = time.time(), secrets.token_urlsafe(24)
    valid = tuple(entry for entry in known.tokens if now < entry.expires)
    entry = Token(hashlib.sha256(token.encode()).hexdigest(), now + 3600 * hours)
    write_credentials(replace(known, tokens=(*valid, entry)), file)
    print(token)


def _ask() -> str:
    """Return a password from the terminal, typed twice, or the first line of stdin."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    password = getpass.getpass("Password: ")
    if password != getpass.getpass("Once more: "):
        raise InputError("the two passwords differ; call the tool again")
    return password


if __name__ == "__main__":
    main()
