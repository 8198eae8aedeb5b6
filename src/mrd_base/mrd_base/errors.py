"""The one error that means: what was given cannot be used."""


class InputError(ValueError):
    """Unusable input, said in one line: which file, field or sample, what was found, what was expected, what to do.

    Tools print the line and leave with status 2; nodes refuse the request with it.
    """
