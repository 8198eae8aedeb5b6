"""A number on which a model or an effect depends."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """A number that identification may choose.

    ``log`` asks for a logarithmic scale between the bounds. A parameter that is not ``free`` keeps its default unless it is
    set or freed by name.
    """

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    meaning: str
    log: bool = False
    free: bool = True
