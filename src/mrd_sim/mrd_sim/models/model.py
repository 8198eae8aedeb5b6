"""What a damper model is: quantities, current laws, a kernel."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim.current import affine_rows, lagged_current
from mrd_sim.path import Path

Array = NDArray[np.float64]
Kernel = Callable[[Array, Array, Array, Array, Array, Array, Array], None]


@dataclass(frozen=True)
class Parameter:
    """A number that identification may choose.

    ``log`` asks for a logarithmic scale between the bounds; a parameter that is not ``free`` keeps its default; one with
    ``choices`` takes no other value.
    """

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    meaning: str
    log: bool = False
    free: bool = True
    choices: tuple[float, ...] = ()


@dataclass(frozen=True)
class Quantity:
    """A coefficient of a model's equation, constant or affine in the lagged coil current.

    Parameters
    ----------
    name, symbol, unit, meaning : str
        ``symbol`` as in the equation.
    default, lower, upper : float
        At 0 A.
    per_ampere : (default, lower, upper), optional
        Slope over current; None for a coefficient that does not depend on it.
    log, free, choices
        See `Parameter`.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    default: float
    lower: float
    upper: float
    per_ampere: tuple[float, float, float] | None = None
    log: bool = False
    free: bool = True
    choices: tuple[float, ...] = ()

    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that the quantity is made of: its value at 0 A and, where it has one, its slope."""
        at_zero = Parameter(
            self.name, self.unit, self.default, self.lower, self.upper, self.meaning, self.log, self.free,
            self.choices,
        )
        if self.per_ampere is None:
            return (at_zero,)
        default, lower, upper = self.per_ampere
        unit = f"{self.unit}/A" if self.unit else "1/A"
        slope = Parameter(f"{self.name}_per_A", unit, default, lower, upper, f"{self.meaning}, slope over current")
        return (at_zero, slope)


COIL_LAG = Parameter(
    "coil_lag", "s", 0.004, 0.0, 0.05, "first-order lag from measured to effective current, u' = (I - u) / coil_lag"
)


@dataclass(frozen=True)
class DamperModel:
    """A damper model: force from motion and lagged current.

    Attributes
    ----------
    id, title, equation, source : str
        ``equation`` in the symbols of the quantities.
    quantities : tuple of Quantity
        Columns of the kernel's first argument, in this order.
    kernel : callable
        ``kernel(q, state, dt, position, velocity, acceleration, force)``: compiled; ``q`` (m, quantities) holds the
        coefficients on the vertices, ``state`` is carried from call to call, ``force`` (m,) is filled.
    states : int
        Length of ``state``; all zero is a damper at rest and unloaded.
    constraints : callable, optional
        ``constraints(values)`` of a mapping from parameter names to arrays (candidates,): an array (candidates, c) that is
        ≤ 0 where the candidate is admissible.
    observables : callable, optional
        ``observables(values, current)``: what the data can determine, as {name: (value, unit)}, at one current in A.
    """

    id: str
    title: str
    equation: str
    source: str
    quantities: tuple[Quantity, ...]
    kernel: Kernel
    states: int = 0
    constraints: Callable[[Mapping[str, Array]], Array] | None = None
    observables: Callable[[Mapping[str, float], float], dict[str, tuple[float, str]]] | None = None

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order of a parameter vector."""
        return (*(p for quantity in self.quantities for p in quantity.parameters()), COIL_LAG)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of `parameters`."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def defaults(self) -> Array:
        """Parameter vector of the defaults."""
        return np.array([parameter.default for parameter in self.parameters])

    @cached_property
    def _columns(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Index of each quantity's value at 0 A and of its slope (-1: constant) in a parameter vector."""
        at_zero = [self.names.index(quantity.name) for quantity in self.quantities]
        slope = [index + 1 if q.per_ampere else -1 for index, q in zip(at_zero, self.quantities, strict=True)]
        return np.array(at_zero, dtype=np.intp), np.array(slope, dtype=np.intp)

    def vector(self, values: Mapping[str, float]) -> Array:
        """Parameter vector from names; those not given keep their default.

        Raises
        ------
        InputError
            For a name that the model does not have, or a value out of its bounds.
        """
        theta = self.defaults.copy()
        for name, value in values.items():
            if name not in self.names:
                raise InputError(f"model {self.id}: unknown parameter {name} (known: {', '.join(self.names)})")
            index = self.names.index(name)
            parameter = self.parameters[index]
            if not parameter.lower <= value <= parameter.upper:
                raise InputError(
                    f"model {self.id}: {name} is {value:g} {parameter.unit}, "
                    f"expected {parameter.lower:g} to {parameter.upper:g}"
                )
            if parameter.choices and value not in parameter.choices:
                known = " or ".join(f"{choice:g}" for choice in parameter.choices)
                raise InputError(f"model {self.id}: {name} is {value:g}, expected {known}")
            theta[index] = value
        return theta

    def initial_state(self, path: Path) -> Array:
        """State of a damper at rest and unloaded, its effective current equal to the first measured one."""
        return np.concatenate(([path.current[0], path.current[0]], np.zeros(self.states)))

    def force(self, theta: Array, path: Path, state: Array | None = None) -> Array:
        """Force in N at the samples of a path.

        Parameters
        ----------
        theta : ndarray (parameters,)
        path : Path
        state : ndarray, optional
            As from `initial_state`; changed in place, so that a following path continues where this one ended.
        """
        if state is None:
            state = self.initial_state(path)
        current = lagged_current(theta[-1], state, path.dt, path.current)
        force = np.empty_like(path.position)
        at_zero, slope = self._columns
        self.kernel(
            affine_rows(theta, at_zero, slope, current),
            state[2:],
            path.dt,
            path.position,
            path.velocity,
            path.acceleration,
            force,
        )
        return force[path.samples]
