"""A damper with its parameters: force along a whole recording, or block by block."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import parse_yaml
from mrd_runs.signals.motion import smooth_motion
from mrd_runs.signals.smoothed_run import Excess
from mrd_sim.models import find_model
from mrd_sim.path import Path, make_path

Array = NDArray[np.float64]


def parse_values(text: str, where: str) -> dict[str, float]:
    """Read parameters from YAML text, ``name: value`` in SI; ``where`` names the text in errors.

    Raises
    ------
    InputError
        When it is no mapping of names to numbers.
    """
    values = parse_yaml(text, where) if text.strip() else {}
    return {str(name): _number(value, f"{where}: {name}") for name, value in values.items()}


def parse_effects(text: str, where: str) -> dict[str, dict[str, float]]:
    """Read effects from YAML text, ``{effect: {parameter: value}}`` in SI; ``where`` names the text in errors.

    Raises
    ------
    InputError
        When it is no mapping of names to such mappings. `Damper` checks the names.
    """
    effects = parse_yaml(text, where) if text.strip() else {}
    for effect, values in effects.items():
        if not isinstance(values, dict):
            raise InputError(f"{where}: {effect} is {values!r}, expected its parameters, {{NAME: VALUE}}")
    return {
        str(effect): {str(name): _number(value, f"{where}: {effect}.{name}") for name, value in values.items()}
        for effect, values in effects.items()
    }


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} is {value!r}, expected a number")
    return float(value)


class Damper:
    """A damper model with its parameters and its present state.

    Parameters
    ----------
    model : str
        Id of the model.
    parameters : mapping, optional
        Values by name; those not given keep the model's default, but `coil_lag` is 0: what was not asked for does not act.
    laws : str or mapping, optional
        Current laws, see `mrd_sim.models.DamperModel.with_laws`.
    effects : mapping, optional
        Effects that act with the model (`mrd_sim.effects`): for each id the values of its parameters. Those not given are
        neutral.
    stands_for : str
        Name of a simulator of the user's own for which the model stands, see `mrd_sim.models.DamperModel`.
    plain : mapping, optional
        Its parameters by name with which it reproduces that simulator without effects.
    simulator_values : mapping, optional
        Parameters of that simulator that were set, by name.

    Raises
    ------
    InputError
        For an unknown model, law, effect or parameter, or a value out of bounds.
    """

    def __init__(
        self,
        model: str,
        parameters: Mapping[str, float] | None = None,
        laws: str | Mapping[str, str] | None = None,
        effects: Mapping[str, Mapping[str, float]] | None = None,
        stands_for: str = "",
        plain: Mapping[str, float] | None = None,
        simulator_values: Mapping[str, float] | None = None,
    ) -> None:
        effects = effects or {}
        self.model = replace(find_model(model, laws, list(effects)), stands_for=stands_for)
        self.plain, self.simulator_values = dict(plain or {}), dict(simulator_values or {})
        effect_values = {f"{effect}.{name}": value for effect, values in effects.items() for name, value in values.items()}
        self.theta = self.model.vector({"coil_lag": 0.0, **(parameters or {}), **effect_values})
        self._state: Array | None = None

    @property
    def description(self) -> str:
        """Model and effects by their ids."""
        name = self.model.stands_for or self.model.id
        return " with ".join(filter(None, (name, ", ".join(effect.id for effect in self.model.effects))))

    def force(
        self, time: Array, position: Array, current: Array, simulator: Array | None = None, temperature: Array | None = None
    ) -> Array:
        """Return the measured force in N along a recorded motion from rest, which is smoothed as in identification.

        Parameters
        ----------
        time, position, current : ndarray (n,)
            s, m, A.
        simulator : ndarray (n,), optional
            Force in N of the simulator for which the model stands, which is corrected.
        temperature : ndarray (n,), optional
            Temperature of the damper in K, for effects that depend on it.

        Raises
        ------
        InputError
            For series of different length, fewer than ten samples, or the force of a simulator or a temperature that is
            missing.
        """
        time, position, current = (np.asarray(series, np.float64) for series in (time, position, current))
        if not len(time) == len(position) == len(current):
            lengths = f"{len(time)} times, {len(position)} positions, {len(current)} currents"
            raise InputError(f"{lengths}, expected as many of each")
        motion = smooth_motion(time, position)
        path = make_path(time, motion.position, motion.velocity, motion.acceleration, current)
        if temperature is not None:
            path = replace(path, temperature=np.interp(np.cumsum(path.dt), time - time[0], temperature))
        if self.model.stands_for:
            path = self._with_excess(path, time, simulator)
        return self.model.force(self.theta, path)

    def _with_excess(self, path: Path, time: Array, simulator: Array | None) -> Path:
        """Return a path with what the simulator has beyond the model that stands for it."""
        if simulator is None or len(simulator) != len(time):
            raise InputError(
                f"the force of the simulator {self.model.stands_for} is missing, which this damper corrects; expected one "
                "value for each sample"
            )
        without = self.model.alone
        excess = np.asarray(simulator, np.float64) - without.force(without.vector(self.plain), path)
        return replace(path, excess=Excess(np.interp(np.cumsum(path.dt), time - time[0], excess)))

    def advance(
        self,
        dt: float,
        position: Array,
        velocity: Array,
        acceleration: Array,
        current: Array,
        temperature: Array | None = None,
    ) -> Array:
        """Return the measured force in N over the next block of equally spaced samples.

        Parameters
        ----------
        dt : float
            s between samples. They have to be so close that no reversal between two of them matters.
        position, velocity, acceleration, current : ndarray (m,)
            SI units.
        temperature : ndarray (m,), optional
            K, for effects that depend on it.
        """
        return self.forces(dt, position, velocity, acceleration, current, temperature)[1]

    def forces(
        self,
        dt: float,
        position: Array,
        velocity: Array,
        acceleration: Array,
        current: Array,
        temperature: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return the force on the rod and the measured one, which effects of sensing change; arguments as of `advance`."""
        if self.model.stands_for:
            raise InputError(f"the damper corrects the simulator {self.model.stands_for}: use force, or export it")
        steps = np.full(len(position), dt)
        if self._state is None:
            steps[0] = 0.0
        path = Path(steps, position, velocity, acceleration, current, np.arange(len(position)), temperature=temperature)
        if self._state is None:
            self._state = self.model.initial_state(path)
        return self.model.forces(self.theta, path, self._state)
