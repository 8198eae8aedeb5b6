"""Who holds control: one operator at a time; all others watch."""

import time
from collections.abc import Callable

from mrd_base import InputError

ABSENCE = 60.0
"""s after which control is free again, once the last page of its holder is no longer waited for."""


class NoControlError(InputError):
    """Somebody asks for what needs control, and does not hold it."""


class ControlRight:
    """The right to command the bench from the page. Stopping needs no right.

    It keeps operators from surprising each other. What the bench may do at all is up to the supervisor's lease.

    Parameters
    ----------
    clock : callable
        Time in s.

    Attributes
    ----------
    holder, name : str
        Session of the holder, and how the page names it; empty while nobody holds control.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._seen = 0.0
        self.holder = self.name = ""

    def seen(self, session: str) -> None:
        """Note that a page of a session is open."""
        if session == self.holder:
            self._seen = self._clock()

    def _expire(self) -> None:
        if self.holder and self._clock() - self._seen > ABSENCE:
            self.holder = self.name = ""

    def holds(self, session: str) -> bool:
        """Return whether a session holds control."""
        self._expire()
        return self.holder == session and bool(session)

    def take(self, session: str, name: str) -> None:
        """Give control to a session.

        Raises
        ------
        InputError
            While somebody else holds it.
        """
        self._expire()
        if self.holder not in ("", session):
            raise InputError(
                f"{self.name} holds control; ask them to release it, or wait until their page has been closed for 80 s"
            )
        self.holder, self.name, self._seen = session, name, self._clock()

    def release(self, session: str) -> None:
        """Give control back."""
        if self.holds(session):
            self.holder = self.name = ""

    def require(self, session: str) -> None:
        """Raise `NoControlError` unless a session holds control."""
        if not self.holds(session):
            who = f"{self.name} holds control" if self.holder else "nobody holds control"
            raise NoControlError(f"you are watching ({who}); press Take control first")
