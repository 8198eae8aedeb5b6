"""The errors that all packages raise for unusable input."""

_LONGEST = 1000  # characters


class InputError(ValueError):
    """Unusable input, described in one line: which file, field or sample, what was found, what was expected, what to do.

    Tools print the line and exit with status 2; nodes refuse the request with it. What was found may be anything: characters
    that do not belong into a line are replaced, and a long line is cut.
    """

    def __init__(self, message: object = "") -> None:
        line = "".join(character if character.isprintable() else "?" for character in str(message))
        super().__init__(line if len(line) <= _LONGEST else f"{line[: _LONGEST - 4]} ...")


class FaultError(InputError):
    """Recordings that can be read but are faulty, so that every result would be wrong. Tools exit with status 3."""
