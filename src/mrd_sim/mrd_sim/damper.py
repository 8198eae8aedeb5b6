"""A damper that is simulated block by block."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import parse_yaml
from mrd_sim.models import find_model
from mrd_sim.path import Path

Array = NDArray[np.float64]


def parse_values(text: str, where: str) -> dict[str, float]:
    """Parameters from YAML text, ``name: value`` in SI; ``where`` names it in errors.

    Raises
    ------
    InputError
        When it is no mapping of names to numbers.
    """
    values = parse_yaml(text, where) if text.strip() else {}
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{where}: {name} is {value!r}, expected a number")
    return {str(name): float(value) for name, value in values.items()}


class Damper:
    """A damper model with parameters and the state that it has come to.

    Parameters
    ----------
    model : str
        Id of the model.
    parameters : mapping, optional
        Values by name; those not given keep the model's default.
    laws : str or mapping, optional
        Current laws, see `mrd_sim.models.DamperModel.with_laws`.

    Raises
    ------
    InputError
        For an unknown model, law or parameter, or a value out of bounds.
    """

    def __init__(
        self, model: str, parameters: Mapping[str, float] | None = None, laws: str | Mapping[str, str] | None = None
    ) -> None:
        self.model = find_model(model, laws)
        self.theta = self.model.vector(parameters or {})
        self._state: Array | None = None

    def advance(self, dt: float, position: Array, velocity: Array, acceleration: Array, current: Array) -> Array:
        """Force in N over the next block of equally spaced samples.

        Parameters
        ----------
        dt : float
            s between samples, short enough for a reversal to be resolved by the samples themselves.
        position, velocity, acceleration, current : ndarray (m,)
            SI units.
        """
        steps = np.full(len(position), dt)
        if self._state is None:
            steps[0] = 0.0
        path = Path(steps, position, velocity, acceleration, current, np.arange(len(position)))
        if self._state is None:
            self._state = self.model.initial_state(path)
        return self.model.force(self.theta, path, self._state)
