"""A finding says what is wrong with recordings."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["fault", "limitation", "remark"]


@dataclass(frozen=True)
class Finding:
    """A finding of the preflight check about the recordings themselves.

    Attributes
    ----------
    kind : str
        ``clock``, ``gap``, ``lag``, ``clipping``, ``quantisation``, ``aliasing``, ``dead_channel``, ``repeat``, ``rig``,
        ``coverage``, ``filter``, ``hum``.
    severity : {"fault", "limitation", "remark"}
        A fault makes any diagnosis of physics worthless; a limitation narrows what can be concluded.
    text : str
        One line: what was found, what was expected, what to do.
    run, channel : str
        Where; empty for all.
    """

    kind: str
    severity: Severity
    text: str
    run: str = ""
    channel: str = ""

    @property
    def remedy(self) -> str:
        """What to do: the last sentence of the text."""
        return self.text.rpartition(". ")[2]

    @property
    def sentence(self) -> str:
        """The text, with run and channel before it."""
        return ": ".join(filter(None, (self.run, self.channel, self.text)))
