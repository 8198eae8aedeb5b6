"""A number that a model or an effect depends on."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """A number that identification may choose.

    ``log`` asks for a logarithmic scale between the bounds; a parameter that is not ``free`` keeps its default unless it is
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
