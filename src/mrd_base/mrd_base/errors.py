"""The errors that all packages raise for unusable input."""


class InputError(ValueError):
    """Unusable input, described in one line: which file, field or sample, what was found, what was expected, what to do.

    Tools print the line and exit with status 2; nodes refuse the request with it.
    """


class FaultError(InputError):
    """Recordings that can be read but are faulty, so that every result would be wrong. Tools exit with status 3."""
