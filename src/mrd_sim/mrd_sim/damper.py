"""A damper with parameters: force along a whole recording, or block by block."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import parse_yaml
from mrd_runs.motion import smooth_motion
from mrd_sim.models import find_model
from mrd_sim.path import Path, make_path

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

    def force(self, time: Array, position: Array, current: Array) -> Array:
        """Force in N along a recorded motion, smoothed and differentiated as in identification, from rest.

        Parameters
        ----------
        time, position, current : ndarray (n,)
            s, m, A.

        Raises
        ------
        InputError
            For series of different length, or fewer than ten samples.
        """
        time, position, current = (np.asarray(series, np.float64) for series in (time, position, current))
        if not len(time) == len(position) == len(current):
            found = f"{len(time)} times, {len(position)} positions, {len(current)} currents"
            raise InputError(f"{found}, expected as many of each")
        moved = smooth_motion(time, position)
        path = make_path(time, moved.position, moved.velocity, moved.acceleration, current)
        return self.model.force(self.theta, path)

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
