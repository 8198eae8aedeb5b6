"""What every emulated mechanical system has."""

from abc import ABC, abstractmethod
from typing import Any

from mrd_base import quantity
from mrd_control.linear import LinearSystem

GRAVITY = 9.80665
"""m/s²."""


class System(ABC):
    """An emulated mechanical system with its parameters; a frozen dataclass."""

    @abstractmethod
    def linear(self) -> LinearSystem:
        """Return its linear part, without the damper."""


def lever_field() -> Any:
    """Declare the lever between the system and its damper."""
    return quantity(1.0, "", "travel of the damper over that between its ends in the system", lower=0.05, upper=5)
