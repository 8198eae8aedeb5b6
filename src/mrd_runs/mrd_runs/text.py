"""Names and texts of strangers' files as parts of a message."""

_LONGEST = 200  # characters


def printable(text: str) -> str:
    """Return a text without line ends, and with a question mark for each other character that moves a terminal's cursor."""
    line = " ".join(text.split())
    return "".join(character if character.isprintable() else "?" for character in line)


def one_line(text: object) -> str:
    """Return the text of an error or of a stranger's file as a part of a line: printable, and not long."""
    line = printable(str(text)) or type(text).__name__
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} ..."


def named_run(name: str) -> str:
    """Return how a sentence calls a run, such as "run 02_sine" or "run2"."""
    return name if name.lower().startswith("run") else f"run {name}"
