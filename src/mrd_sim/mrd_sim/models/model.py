"""A damper model: coefficients with their current laws, a kernel, and the effects that act with it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.scales import REFERENCE, Scales
from mrd_sim.current import LAWS, evaluate_coefficients, lagged_current, slope_factors
from mrd_sim.dual_type import LANES, Duals, columns_of, empty_duals, like
from mrd_sim.effects.effect import Effect, Stage
from mrd_sim.lanes import CANDIDATES, force_in_lanes, runs_in_lanes
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.parameter import Parameter
from mrd_sim.path import Path
from mrd_sim.series_elements import (
    MOST_IN_SERIES,
    MOST_PARAMETERS,
    addresses,
    derivatives_in_series,
    elongations_under,
    force_in_series,
)

Array = NDArray[np.float64]
Kernel = Callable[[Any, Any, Any, Any, Any, Any, Any], None]

NO_FLOOR = -1e300
"""Stands for the least value of a coefficient that has none: a finite number, as C code needs one."""

ALL = slice(None)
"""All samples of a path."""

BLOCK = 512
"""Vertices of which the coefficients with their derivatives are kept at a time: as many as a processor's cache holds."""

MID_STROKE = Parameter(
    "mid_stroke", "m", 0.0, 0.0, 0.0, "reading of the position at mid-stroke, where x is 0", free=False, place="mid_stroke"
)
COIL_LAG = Parameter(
    "coil_lag",
    "s",
    0.004,
    0.0,
    0.05,
    "first-order lag from measured to effective current, u' = (I - u) / coil_lag",
    absolute="electrical",
)


@dataclass(frozen=True, repr=False)
class DamperModel:
    """A damper model: force from motion and lagged current.

    Attributes
    ----------
    id, title, equation, source : str
        ``equation`` in the symbols of the coefficients.
    coefficients : tuple of Coefficient
        In the order of the columns of the kernel's first argument.
    kernel : callable
        ``kernel(q, state, dt, x, v, a, force)``, compiled, for real numbers and for numbers with derivatives
        (`mrd_sim.dual`). ``q`` (m, coefficients) holds the coefficients on the vertices, to be read by
        `mrd_sim.named.named_row`; ``state`` is carried from call to call; ``force`` (m,) is filled. ``dt[0] == 0`` begins a
        path.
    states : int
        Length of ``state``. All zero is a damper at rest and unloaded.
    order : int
        Order of convergence over the step; 0 where the force is exact along a polyline.
    dissipative : bool
        Whether no closed cycle at constant current can yield energy, for any values within the bounds.
    odd : bool
        Whether turning the motion round turns the force round, apart from the offset, for any values within the bounds.
    observables : callable, optional
        ``observables(values)``: what recordings can determine, as {name: (value, unit)}, from the coefficients by name at
        one current.
    effects : tuple of Effect
        Effects that act with the model, see `with_effects`.
    scales : Scales
        Scales of the damper for which the ranges of `parameters` hold; the coefficients state those of the reference damper.
    stands_for : str
        Name of a simulator of the user's own for which the model stands: its force is that of the model and the excess of
        the path (`mrd_sim.path.Path`). Empty where the model is the simulator itself.
    """

    id: str
    title: str
    equation: str
    source: str
    coefficients: tuple[Coefficient, ...]
    kernel: Kernel
    states: int = 0
    order: int = 0
    dissipative: bool = True
    odd: bool = True
    observables: Callable[[Mapping[str, float]], dict[str, tuple[float, str]]] | None = None
    effects: tuple[Effect, ...] = ()
    scales: Scales = REFERENCE
    stands_for: str = ""

    def __repr__(self) -> str:
        return f"<DamperModel {' with '.join([self.id, *(effect.id for effect in self.effects)])}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the ids: compiled kernels cannot be pickled, and another process has the same catalogue."""
        from mrd_sim.models import restored

        return restored, (self.id, self.laws, tuple(effect.id for effect in self.effects), self.scales, self.stands_for)

    def with_laws(self, laws: str | Mapping[str, str]) -> "DamperModel":
        """Return the model with other current laws.

        Parameters
        ----------
        laws : str or mapping
            Id of a law for every coefficient that depends on current, or ids by name of the coefficient.

        Raises
        ------
        InputError
            For an unknown law or coefficient, or one that does not depend on current.
        """
        dependent = [coefficient.name for coefficient in self.coefficients if coefficient.per_ampere]
        chosen = dict.fromkeys(dependent, laws) if isinstance(laws, str) else dict(laws)
        for name, law in chosen.items():
            if name not in dependent:
                raise InputError(
                    f"model {self.id}: no current law for {name} (coefficients that have one: {', '.join(dependent)})"
                )
            if law not in LAWS:
                raise InputError(f"model {self.id}: unknown current law {law} for {name} (known: {', '.join(LAWS)})")
        return replace(self, coefficients=tuple(replace(c, law=chosen.get(c.name, c.law)) for c in self.coefficients))

    def scaled(self, scales: Scales) -> "DamperModel":
        """Return the model with the ranges and start values of a damper of these scales; its effects stay as they are."""
        return replace(self, scales=scales)

    def with_effects(self, effects: Sequence[Effect]) -> "DamperModel":
        """Return the model with effects, their parameters after its own, named EFFECT.PARAMETER.

        The stages follow the order in which cause becomes reading (`mrd_sim.effects.STAGES`). Drive effects change the
        motion that the damper sees; magnetic effects change its current; elements in series share its motion. Effects of
        fluid and structure change its force or add to it. Sensing makes the measured force of it.

        Raises
        ------
        InputError
            For more elements in series with the damper than can be solved for.
        """
        extended = replace(self, effects=tuple(effects))
        if len(extended.series_elements) > MOST_IN_SERIES:
            series = ", ".join(effect.id for effect in extended.series_elements)
            raise InputError(f"effects {series}: all in series with the damper, expected at most {MOST_IN_SERIES} of these")
        return extended

    @cached_property
    def alone(self) -> "DamperModel":
        """The model without effects, standing for no simulator."""
        return replace(self, effects=(), stands_for="")

    @cached_property
    def laws(self) -> dict[str, str]:
        """Current law of every coefficient that may depend on current, by its name."""
        return {coefficient.name: coefficient.law for coefficient in self.coefficients if coefficient.per_ampere}

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order of a parameter vector."""
        return (
            *self._model_parameters,
            *(replace(p, name=f"{effect.id}.{p.name}") for effect in self.effects for p in effect.parameters),
        )

    @cached_property
    def _model_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the model without effects; mid-stroke and the coil lag are the last."""
        return tuple(parameter.scaled(self.scales) for parameter in self._declared)

    @cached_property
    def _declared(self) -> tuple[Parameter, ...]:
        """The same parameters with the ranges of the reference damper."""
        return (*(p for coefficient in self.coefficients for p in coefficient.parameters()), MID_STROKE, COIL_LAG)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of `parameters`."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def defaults(self) -> Array:
        """Parameter vector of the defaults."""
        return np.array([parameter.default for parameter in self.parameters])

    @cached_property
    def law_codes(self) -> NDArray[np.intp]:
        """Number of each coefficient's current law."""
        return np.array([coefficient.code for coefficient in self.coefficients], dtype=np.intp)

    @cached_property
    def law_columns(self) -> NDArray[np.intp]:
        """Indices of each coefficient's parameters in a parameter vector, (coefficients, 3); -1 for those its law lacks."""
        columns = np.full((len(self.coefficients), 3), -1, dtype=np.intp)
        first = 0
        for row, coefficient in zip(columns, self.coefficients, strict=True):
            count = len(coefficient.parameters())
            row[:count] = np.arange(first, first + count)
            first += count
        return columns

    @cached_property
    def floors(self) -> Array:
        """Least value of each coefficient on the vertices, the same for dampers of all scales."""
        return np.array(
            [
                NO_FLOOR if coefficient.multiplies else self._declared[column].limits[0]
                for coefficient, column in zip(self.coefficients, self.law_columns[:, 0], strict=True)
            ]
        )

    @cached_property
    def linear(self) -> NDArray[np.intp]:
        """Indices of the parameters in which the force is linear; none where effects act."""
        if self.effects:
            return np.array([], dtype=np.intp)
        indices = [
            index
            for coefficient, row in zip(self.coefficients, self.law_columns, strict=True)
            if coefficient.multiplies
            for index in row[: 3 if coefficient.code == 2 else 2]
            if index >= 0
        ]
        return np.array(indices, dtype=np.intp)

    def vector(self, values: Mapping[str, float]) -> Array:
        """Return the parameter vector with these values by name; those not given keep their default.

        Raises
        ------
        InputError
            For a name that the model does not have, or a value beyond its limits (`mrd_sim.parameter.Parameter.limits`).
        """
        theta = self.defaults.copy()
        for name, value in values.items():
            if name not in self.names:
                raise InputError(f"model {self.id}: unknown parameter {name} (known: {', '.join(self.names)})")
            index = self.names.index(name)
            parameter = self.parameters[index]
            lower, upper = parameter.limits
            if not lower <= value <= upper:
                given = f"{value:g} {parameter.unit}".rstrip()
                raise InputError(f"model {self.id}: {name} is {given}, expected {lower:.3g} to {upper:.3g}")
            theta[index] = value
        return theta

    def at_current(self, theta: Array, current: float) -> dict[str, float]:
        """Return the coefficients by name at one current in A."""
        row = self._coefficients_along(theta, np.array([current]))[0]
        return {coefficient.name: float(value) for coefficient, value in zip(self.coefficients, row, strict=True)}

    def initial_state(self, path: Path) -> Array:
        """Return the state of a damper at rest and unloaded, its effective current equal to the first measured one.

        The state holds effective and measured current, the model's states, the effects' states, and then the elongations of
        the elements in series and the force.
        """
        effects = [effect.begin(path) if effect.begin else np.zeros(effect.states) for effect in self.effects]
        currents = [path.current[0], path.current[0]]
        return np.concatenate([currents, np.zeros(self.states), *effects, np.zeros(len(self.series_elements) + 1)])

    def next_state(self, state: Array, path: Path) -> Array:
        """Return the state at the start of a path recorded after another: that at rest, but for what outlasts a run.

        Parameters
        ----------
        state : ndarray
            State at the end of the run before, with derivatives where it carries them; not changed.
        path : Path
            The path to come.
        """
        following = like(state, self.initial_state(path))
        for effect, part in zip(self.effects, self.effect_states, strict=True):
            if effect.outlasts_run:
                following[part] = state[part]
        return following

    @cached_property
    def remembers_current(self) -> bool:
        """Whether effects remember a current that has flowed before a run."""
        return any(effect.stage == "magnetics" and effect.outlasts_run for effect in self.effects)

    def without_effects(self, theta: Array) -> Array:
        """Return parameters (parameters,) with which the effects change nothing."""
        own = len(self._model_parameters)
        neutral = np.array([parameter.default for parameter in self.parameters[own:]])
        plain = theta.copy()
        plain[own:] = like(theta, neutral)
        return plain

    def force(self, theta: Array, path: Path, state: Array | None = None, samples: slice = ALL) -> Array:
        """Return the measured force in N at the samples of a path.

        Parameters
        ----------
        theta : ndarray (parameters,)
            Floats, or dual numbers (`mrd_sim.dual_type.Duals`) where it carries derivatives; so is the force.
        path : Path
        state : ndarray, optional
            As from `initial_state`, of the type of ``theta``. Changed in place, so that a following path continues where
            this one ended.
        samples : slice
            Samples of the path whose force is returned.

        Raises
        ------
        InputError
            For an effect that needs the temperature, along a path without one.
        """
        return self.forces(theta, path, state, samples)[1]

    def forces(self, theta: Array, path: Path, state: Array | None = None, samples: slice = ALL) -> tuple[Array, Array]:
        """Return the force in N on the rod, and the measured force after the effects of sensing; arguments as of `force`."""
        if self.needs_temperature and path.temperature is None:
            name = path.smoothed.run.name if path.smoothed else "the motion"
            effects = ", ".join(effect.id for effect in self.effects if effect.coefficients is not None)
            raise InputError(f"{name} has no temperature of the damper, which {effects} needs; record it, or try without")
        path, state, (x, v, a, current, force) = self._damper_alone(theta, path, state)
        self._act(("fluid", "structure"), theta, path, (x, v, a, current, force), state)
        on_rod = force[path.samples[samples]]
        if not any(effect.stage == "sensing" for effect in self.effects):
            return on_rod, on_rod
        self._act(("sensing",), theta, path, (x, v, a, current, force), state)
        return on_rod, force[path.samples[samples]]

    def force_of_damper(self, theta: Array, path: Path, state: Array | None = None) -> Array:
        """Return the force (m,) in N of the damper itself, before effects behind it, on the vertices of `integrated`.

        Arguments as of `force`.
        """
        return self._damper_alone(theta, path, state)[2][-1]

    def motion_of_damper(
        self, theta: Array, path: Path, force: Array, state: Array | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Return what the effects before the damper leave of motion and current, at the samples of a path.

        Effects of drive and magnetics change the signals; elements in series take a part of the motion.

        Parameters
        ----------
        theta : ndarray (parameters,)
        path : Path
        force : ndarray (m,)
            Force in N under which elements in series give way, on the vertices of `integrated`.
        state : ndarray, optional
            As of `force`; changed in place.

        Returns
        -------
        position, velocity, acceleration, current : ndarray (n,)
            m, m/s, m/s², A. The acceleration is that of the rod, which models get behind elements in series, too. The
            current is the one before the model's own lag.
        """
        path, state, (x, v, a, current, _) = self._before_damper(theta, path, state)
        chosen, middle = path.samples, self._mid_stroke(theta)
        if not self.series_elements:
            return x[chosen] + middle, v[chosen], a[chosen], current[chosen]
        parameters, elongations = self._parameters_in_series(theta), state[-len(self.series_elements) - 1 : -1]
        elongation = elongations_under(self._functions(1), parameters, elongations, path.dt, x, v, force)
        speed = np.divide(np.diff(elongation, prepend=elongation[:1]), path.dt, out=np.zeros(len(x)), where=path.dt > 0.0)
        return x[chosen] - elongation[chosen] + middle, v[chosen] - speed[chosen], a[chosen], current[chosen]

    def integrated(self, path: Path) -> Path:
        """Return the path with the vertices along which the model is integrated."""
        return path.fine if self.follows_force else path

    def _before_damper(self, theta: Array, path: Path, state: Array | None) -> tuple[Path, Array, tuple[Array, ...]]:
        """Return the path that is integrated, the state, and the signals behind the effects of drive and magnetics."""
        state = like(theta, self.initial_state(path) if state is None else state)
        path = self.integrated(path)
        x, v, a, current, force = (
            like(theta, series)
            for series in (self._place(theta, path), path.velocity, path.acceleration, path.current, np.zeros(len(path.dt)))
        )
        if self.effects and theta.dtype == float:  # effects change the signals in place
            x, v, a, current = (series.copy() for series in (x, v, a, current))
        self._act(("drive", "magnetics"), theta, path, (x, v, a, current, force), state)
        return path, state, (x, v, a, current, force)

    def _damper_alone(self, theta: Array, path: Path, state: Array | None) -> tuple[Path, Array, tuple[Array, ...]]:
        """Return the path that is integrated, the state, and the signals with the force of damper and elements in series."""
        path, state, (x, v, a, current, force) = self._before_damper(theta, path, state)
        current = self._lagged(theta, state, path.dt, current)
        excess = self._excess(theta, path)
        if excess is not None and self.series_elements:
            force = excess
        inner = state[2 : 2 + self.states]
        parameters = self._parameters_in_series(theta)
        in_blocks = bool(self.series_elements) or isinstance(theta, Duals)
        for block in _blocks(path.dt) if in_blocks else [ALL]:
            arguments = inner, path.dt[block], x[block], v[block], a[block], force[block]
            rows = self._coefficients_along(theta, current[block])
            if path.temperature is not None:
                self._change_coefficients(theta, path.temperature[block], rows)
            if self.series_elements:
                self._run_in_series(parameters, state[-len(self.series_elements) - 1 :], rows, *arguments)
            else:
                self.kernel(rows, *arguments)
        if excess is not None and not self.series_elements:
            columns_of(force)[...] += columns_of(excess)
        return path, state, (x, v, a, current, force)

    def _excess(self, theta: Array, path: Path) -> Array | None:
        """Return what a simulator has beyond the model along a path (m,), in numbers of the type of ``theta``."""
        if not self.stands_for or path.excess is None:
            return None
        excess = like(theta, path.excess.force.copy())
        for name, (value, slope) in path.excess.slopes.items():
            moved = columns_of(theta)[self.names.index(name)].copy()
            columns_of(excess)[...] += np.multiply.outer(slope, moved - np.eye(1, moved.size).reshape(moved.shape) * value)
        return excess

    @cached_property
    def needs_temperature(self) -> bool:
        """Whether effects act by the temperature of the path."""
        return any(effect.coefficients is not None for effect in self.effects)

    @cached_property
    def _parts(self) -> NDArray[np.intp]:
        """Part of the force to which each coefficient belongs, (coefficients,)."""
        return np.array([coefficient.part_code for coefficient in self.coefficients], dtype=np.intp)

    def _change_coefficients(self, theta: Array, temperature: Array, rows: Array) -> None:
        """Let effects change the coefficients (m, coefficients) in place, by the temperature (m,) in K."""
        for effect in self.effects:
            if effect.coefficients is not None:
                (parameters,) = self._effect_parameters([effect])
                effect.coefficients(theta[parameters], self._parts, temperature, rows)

    def _mid_stroke(self, theta: Array) -> float:
        """Return the reading of the position at mid-stroke in m, a constant without derivatives."""
        return float(theta.real[len(self._model_parameters) - 2])

    def _place(self, theta: Array, path: Path) -> Array:
        """Return the position (m,) in m from mid-stroke."""
        middle = self._mid_stroke(theta)
        return path.position - middle if middle else path.position

    def _lagged(self, theta: Array, state: Array, dt: Array, current: Array) -> Array:
        """Return the effective current in A behind the coil lag of the model."""
        place = len(self._model_parameters) - 1
        if not theta[place : place + 1].view(np.float64).any() and len(current):
            state[:2] = current[-1]
            return current
        effective = np.empty_like(current)
        lagged_current(theta[place : place + 1], state, dt, current, effective)
        return effective

    def _parameters_in_series(self, theta: Array) -> Array:
        """Return the parameters (elements, `MOST_PARAMETERS`) of the elements in series."""
        parts = self._effect_parameters(self.series_elements)
        parameters = like(theta, np.zeros((len(parts), MOST_PARAMETERS)))
        for row, part in zip(parameters, parts, strict=True):
            row[: part.stop - part.start] = theta[part]
        return parameters

    def _run_in_series(self, parameters: Array, elongations: Array, rows: Array, *others: Array) -> None:
        """Fill the force of the damper and the elements in series with it: values first, then their derivatives.

        The force holds what is added to the damper's.
        """
        solved = np.empty((len(rows), 2 + self.states))
        if not isinstance(parameters, Duals):
            force_in_series(self._functions(1), parameters, elongations, rows.T, *others, solved)
            return
        values = [np.ascontiguousarray(argument.real) for argument in (elongations, rows.T, *others)]
        force_in_series(self._functions(1), parameters.real, *values, solved)
        others[-1].real[:] = values[-1]
        derivatives_in_series(self._functions(LANES), parameters, elongations, rows, *others, solved)

    @cached_property
    def follows_force(self) -> bool:
        """Whether effects need vertices between samples where the force changes fast."""
        return any(effect.follows_force for effect in self.effects)

    @cached_property
    def series_elements(self) -> tuple[Effect, ...]:
        """Effects that are elements in series with the damper; with any, its force is the root of an equation."""
        return tuple(effect for effect in self.effects if effect.elongation is not None)

    def _functions(self, lanes: int) -> NDArray[np.intp]:
        """Return the addresses of the kernel and of the elongations of the elements in series."""
        if lanes not in self._addresses:
            elongations = [effect.elongation for effect in self.series_elements]
            self._addresses[lanes] = addresses(self.kernel, elongations, lanes)
        return self._addresses[lanes]

    @cached_property
    def _addresses(self) -> dict[int, NDArray[np.intp]]:
        return {}

    @cached_property
    def effect_states(self) -> tuple[slice, ...]:
        """Slice of each effect's state in the model's state."""
        edges = np.cumsum([2 + self.states, *(effect.states for effect in self.effects)]).tolist()
        return tuple(slice(first, last) for first, last in pairwise(edges))

    def _effect_parameters(self, effects: Sequence[Effect]) -> list[slice]:
        """Return the slices of the parameters of effects in a parameter vector."""
        edges = np.cumsum([len(self._model_parameters), *(len(effect.parameters) for effect in self.effects)]).tolist()
        return [slice(edges[i], edges[i + 1]) for i in (self.effects.index(effect) for effect in effects)]

    def _act(self, stages: Sequence[Stage], theta: Array, path: Path, signals: tuple[Array, ...], state: Array) -> None:
        """Let the effects of some stages change the signals in place.

        What outlasts runs or counts from the first sample, such as heat or a hum, does not act in a lead-in; but remanence
        does, because a lead-in has the current of the first sample or another that magnetises.
        """
        for stage in stages:
            for effect, states in zip(self.effects, self.effect_states, strict=True):
                if effect.stage == stage and effect.kernel is not None:
                    (parameters,) = self._effect_parameters([effect])
                    if path.lead and stage != "magnetics" and (effect.outlasts_run or effect.begin):
                        acting = (path.recorded.dt, *(series[path.lead :] for series in signals))
                    else:
                        acting = path.dt, *signals
                    effect.kernel(theta[parameters], state[states], *acting)

    def forces_of(self, thetas: Array, path: Path, samples: slice = ALL) -> Array:
        """Return the measured force (candidates, samples) in N of candidates (candidates, parameters) from rest.

        Several at a time where the model `mrd_sim.lanes.runs_in_lanes`.
        """
        if not self.runs_in_lanes or len(thetas) < 2:
            return np.stack([self.force(theta, path, samples=samples) for theta in thetas])
        filled = np.concatenate([thetas, np.repeat(thetas[-1:], -len(thetas) % CANDIDATES, axis=0)])
        laws = self.law_codes, self.law_columns, self.floors
        chosen = path.samples[samples]
        groups = filled.reshape(-1, CANDIDATES, filled.shape[1])
        # Mid-stroke is a constant, the same for all candidates.
        path = replace(path, position=self._place(thetas[0], path))
        forces = [force_in_lanes(self.kernel, self.states, group, laws, path, chosen) for group in groups]
        return (forces[0] if len(forces) == 1 else np.concatenate(forces))[: len(thetas)]

    @cached_property
    def runs_in_lanes(self) -> bool:
        """Whether candidates are evaluated several at a time."""
        return not (self.effects or self.stands_for) and runs_in_lanes(self.kernel)

    def regressors(self, thetas: Array, path: Path, samples: slice = ALL) -> list[tuple[Array, Array]]:
        """Return the force's linear part and the rest of candidates: ``force = columns @ theta[linear] + rest``.

        Parameters
        ----------
        thetas : ndarray (candidates, parameters)
            Their linear parameters do not matter.
        path : Path
        samples : slice
            Samples of the path that are wanted.

        Returns
        -------
        columns : ndarray (samples, linear)
        rest : ndarray (samples,)
            Part of the force in N that no linear parameter multiplies.
        """
        without = thetas.copy()
        without[:, self.linear] = 0.0
        chosen = path.samples[samples]
        rests = self.forces_of(without, path, samples) if self._has_rest else np.zeros((len(thetas), len(chosen)))
        position = self._place(thetas[0], path)
        multiplied = {"x": position[chosen], "v": path.velocity[chosen], "1": np.ones(len(chosen))}
        bases: dict[int, Array] = {}
        for j, coefficient in enumerate(self.coefficients):
            if coefficient.multiplies == "term":
                alone = without.copy()
                alone[:, self.law_columns[j, 0]] = 1.0
                bases[j] = self.forces_of(alone, path, samples) - rests
            elif coefficient.multiplies:
                bases[j] = np.broadcast_to(multiplied[coefficient.multiplies], rests.shape)
        found = []
        for candidate, (theta, rest) in enumerate(zip(thetas, rests, strict=True)):
            current = self._lagged(theta, self.initial_state(path), path.dt, path.current)[chosen]
            columns = np.empty((len(chosen), len(self.linear)), order="F")
            filled = 0
            for j, of_candidates in bases.items():
                base, code = of_candidates[candidate], self.coefficients[j].code
                columns[:, filled] = base
                filled += 1
                if code:
                    third = theta[self.law_columns[j, 2]] if self.law_columns[j, 2] >= 0 else 0.0
                    np.multiply(base, slope_factors(code, third, current), out=columns[:, filled])
                    filled += 1
                if code == 2:
                    np.multiply(base, current**2, out=columns[:, filled])
                    filled += 1
            found.append((columns, rest))
        return found

    @cached_property
    def _has_rest(self) -> bool:
        """Whether any force is left where all linear coefficients are zero, as a random motion shows."""
        if self.stands_for:
            return True
        rng = np.random.default_rng(0)
        dt, x, v, a, current = rng.uniform(-0.1, 0.1, (5, 100))
        path = Path(np.abs(dt), np.cumsum(x), v, a, current, np.arange(100))
        row = np.array([0.0 if c.multiplies else rng.uniform(c.lower, c.upper) for c in self.coefficients])
        return bool(self._run(np.asfortranarray(np.tile(row, (100, 1))), path).any())

    def _coefficients_along(self, theta: Array, current: Array) -> Array:
        """Coefficients (m, coefficients) along the effective current."""
        shape = len(current), len(self.coefficients)
        rows = empty_duals(shape) if isinstance(theta, Duals) else np.empty(shape, order="F")
        evaluate_coefficients(theta, self.law_codes, self.law_columns, self.floors, current, rows)
        return rows

    def _run(self, rows: Array, path: Path) -> Array:
        """Force of the kernel alone, from rest."""
        force = np.empty(len(rows), rows.dtype)
        self.kernel(rows, np.zeros(self.states, rows.dtype), path.dt, path.position, path.velocity, path.acceleration, force)
        return force


def _blocks(dt: Array) -> list[slice]:
    """Return the blocks of vertices, of which none but the first begins a path; see `BLOCK`."""
    edges = [0, *np.flatnonzero(dt)[BLOCK - 1 :: BLOCK].tolist(), len(dt)]
    return [slice(first, last) for first, last in pairwise(edges)]
