"""A simulator with other values of its parameters than it states."""

import shlex
from collections.abc import Mapping
from dataclasses import replace

from mrd_base import InputError
from mrd_sim.simulators.simulator import Array, Signals, Simulator, SimulatorParameter


class AdjustedSimulator(Simulator):
    """A simulator whose parameters are set.

    Parameters
    ----------
    simulator : Simulator
    values : mapping
        Parameters by name; the others keep the values that the simulator states.
    notes : tuple of str
        What is to be known of the values.

    Attributes
    ----------
    simulator : Simulator
    values : mapping
        All parameters that were set, also in ``simulator``.

    Raises
    ------
    InputError
        For a parameter that the simulator does not have, or a value out of its bounds.
    """

    def __init__(self, simulator: Simulator, values: Mapping[str, float], notes: tuple[str, ...] = ()) -> None:
        for name, value in values.items():
            stated = find_parameter(simulator, name)
            if not stated.lower <= value <= stated.upper:
                raise InputError(
                    f"simulator {simulator.name}: the parameter {name} is {value:g}, expected {stated.lower:g} to "
                    f"{stated.upper:g}"
                )
        self.simulator, self.values = simulator, {**simulator.values, **values}
        self.name = simulator.name
        pairs = [f"{name}={value!r}" for name, value in values.items()]
        self.source = " ".join([simulator.source, *(["--set", *map(shlex.quote, pairs)] if pairs else [])])
        self.parameters: Mapping[str, SimulatorParameter] = {
            name: replace(parameter, value=values.get(name, parameter.value))
            for name, parameter in simulator.parameters.items()
        }
        self.answers_anew = simulator.answers_anew
        self.notes = (*simulator.notes, *notes)
        self.limitations = simulator.limitations

    def force(self, signals: Signals, values: Mapping[str, float] | None = None) -> Array:
        """Return the force (n,) in N; see `Simulator.force`."""
        return self.simulator.force(signals, {**self.values, **(values or {})})

    def reopen(self) -> None:
        """Start what runs for the simulator once more, where it has ended."""
        self.simulator.reopen()

    def close(self) -> None:
        """End what runs for the simulator."""
        self.simulator.close()


def find_parameter(simulator: Simulator, name: str) -> SimulatorParameter:
    """Return a parameter of a simulator.

    Raises
    ------
    InputError
        When it does not have one of this name.
    """
    if name not in simulator.parameters:
        known = ", ".join(simulator.parameters) or "none; a Python file states them as PARAMETERS"
        raise InputError(f"simulator {simulator.name}: has no parameter {name} (parameters: {known})")
    return simulator.parameters[name]
