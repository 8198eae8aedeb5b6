"""A control law: from what is measured and emulated to the coil current."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_control.catalogue import require_number
from mrd_control.linear import LinearSystem
from mrd_sim.parameter import Parameter

Array = NDArray[np.float64]


class Signals(NamedTuple):
    """What a law sees at a sample, read by `mrd_sim.named.named`; after these the state follows in the array.

    The state is that of the emulated system relative to its base (`LinearSystem.base_accelerates` says which velocities).
    """

    period: Any
    """s between samples."""
    acceleration: Any
    """Of the upper end of the damper, m/s²."""
    upper_velocity: Any
    """Of the upper end of the damper, m/s."""
    lower_velocity: Any
    """Of its lower end."""
    travel: Any
    """Of the damper, m."""
    speed: Any
    """Of the damper, m/s."""
    force: Any
    """Measured, N."""
    lever_ratio: Any
    """Travel of the damper over that between its ends; a force of the damper acts on the masses as much larger."""


STATE = len(Signals._fields)
"""Index of the first entry of the state in the array of signals."""

LAW = types.FunctionType(types.float64(types.float64[::1], types.float64[::1], types.float64[::1], types.float64[:, ::1]))
"""Compiled type of `Law.kernel`."""


@dataclass(frozen=True, eq=False)
class Law:
    """A control law.

    Attributes
    ----------
    id, title, equation, source : str
        ``equation`` in the symbols of docs/control.md.
    parameters : tuple of Parameter
        Gains in SI, with their bounds.
    kernel : callable
        ``kernel(parameters, memory, signals, force_map)``, compiled: the current in A to command; the loop limits it to the
        range of the supply. ``parameters`` are those above and then what ``prepare`` gives; ``memory`` is carried on;
        ``signals`` are `Signals` and then the state; ``force_map`` is that of `mrd_control.force_map`.
    demands_force : bool
        Whether the law asks for a force, and so needs a damper model with an inverse.
    memory : callable
        ``memory(system)``: length of the memory.
    prepare : callable, optional
        ``prepare(values, system, period)``: gains (m,) that follow from the emulated system.
    """

    id: str
    title: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    kernel: Callable[[Any, Any, Any, Any], float]
    demands_force: bool = False
    memory: Callable[[LinearSystem], int] = lambda _system: 0
    prepare: Callable[[Mapping[str, float], LinearSystem, float], Array] | None = None

    def __repr__(self) -> str:
        return f"<Law {self.id}>"

    def values(self, given: Mapping[str, Any]) -> dict[str, float]:
        """Return all parameters by name: those given, and the defaults of the others.

        Raises
        ------
        InputError
            For a name that the law does not have, or a value that is no number or out of its bounds.
        """
        values = {parameter.name: parameter.default for parameter in self.parameters}
        for name, value in given.items():
            if name not in values:
                raise InputError(f"law {self.id}: unknown parameter {unknown_key(name, values)}")
            parameter = next(parameter for parameter in self.parameters if parameter.name == name)
            number = require_number(value, f"law {self.id}: {name}")
            if not parameter.lower <= number <= parameter.upper:
                found = f"{number:g} {parameter.unit}".rstrip()
                raise InputError(f"law {self.id}: {name} is {found}, expected {parameter.lower:g} to {parameter.upper:g}")
            values[name] = number
        return values

    def vector(self, given: Mapping[str, float], system: LinearSystem, period: float) -> Array:
        """Return the parameters as the kernel is given them, for an emulated system and a sampling period in s.

        Raises
        ------
        InputError
            As `values`, and where no gains solve the equations of an optimal law.
        """
        values = self.values(given)
        own = np.array(list(values.values()), np.float64)
        if self.prepare is None:
            return own
        try:
            return np.concatenate([own, np.ravel(self.prepare(values, system, period))])
        except (np.linalg.LinAlgError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(f"law {self.id}: no optimal gains for this system ({reason}); change its weights") from None
