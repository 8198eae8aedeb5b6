"""Errors that end a request to the supervisor early. Each message is one line for the user."""


class RefusedError(Exception):
    """A part of the bench refused a request, or did not respond in time."""


class TrippedError(Exception):
    """An interlock or an emergency stop ended the request."""


class CancelledError(Exception):
    """Somebody asked to end the request."""

    def __str__(self) -> str:
        return "cancelled by stop or through its goal"
