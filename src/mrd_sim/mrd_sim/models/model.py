"""What a damper model is: quantities with their current laws, and a kernel."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_sim.current import LAWS, coefficients, lagged_current, rise
from mrd_sim.effects.effect import Effect, Stage
from mrd_sim.parameter import Parameter
from mrd_sim.path import Path
from mrd_sim.series_elements import MOST, derivatives_in_series, in_series

Array = NDArray[np.float64]
Kernel = Callable[[Any, Any, Any, Any, Any, Any, Any], None]

NO_FLOOR = -1e300

SeriesSolutions = dict[int, tuple[tuple[bytes, bytes], Array, Array]]
"""Solutions of a damper in series with something that gives way, by the identity of the path.

Each holds the parameters and the initial state that it belongs to, the force, and the derivatives over it. One such
dictionary serves one evaluation of derivatives, during which its paths exist.
"""


@dataclass(frozen=True)
class Quantity:
    """A coefficient of a model's equation and how it depends on the lagged coil current.

    Parameters
    ----------
    name, symbol, unit, meaning : str
        ``symbol`` as in the equation.
    default, lower, upper : float
        At 0 A.
    per_ampere : (default, lower, upper), optional
        Slope over current at 0 A; None for a coefficient that does not depend on it.
    log, free
        See `Parameter`.
    multiplies : str
        What it multiplies, where the force is linear in it: position ``x``, velocity ``v``, one ``1``, or ``term``,
        something that only the kernel knows. Empty for a coefficient in which the force is not linear; such a one never
        falls below ``lower``, whatever its law.
    law : str
        Id of its current law (`mrd_sim.current.LAWS`), "constant" without a slope.
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
    multiplies: Literal["", "x", "v", "1", "term"] = ""
    law: str = "affine"

    @property
    def code(self) -> int:
        """Code of its current law."""
        return LAWS[self.law].code if self.per_ampere else 0

    def parameters(self) -> tuple[Parameter, ...]:
        """What its law consists of: value at 0 A, slope there and, where the law has one, a third parameter."""
        at_zero = Parameter(self.name, self.unit, self.default, self.lower, self.upper, self.meaning, self.log, self.free)
        if self.per_ampere is None or self.law == "constant":
            return (at_zero,)
        default, lower, upper = self.per_ampere
        unit = f"{self.unit}/A" if self.unit else "1/A"
        slope = Parameter(
            f"{self.name}_per_A", unit, default, lower, upper, f"{self.meaning}, slope over current at 0 A", free=self.free
        )
        third = LAWS[self.law].third
        if third == "_per_A2":
            most = max(abs(lower), abs(upper))
            bend = Parameter(
                self.name + third, f"{unit}²", 0.0, -most, most, f"{self.meaning}, square term over current", free=self.free
            )
            return (at_zero, slope, bend)
        if third == "_saturation":
            bend = Parameter(
                self.name + third, "A", 1.5, 0.1, 10.0, f"{self.meaning}, current at which it saturates", True, self.free
            )
            return (at_zero, slope, bend)
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
        ``kernel(q, state, dt, x, v, a, force)``: compiled, for real numbers and for numbers with derivatives
        (`mrd_sim.dual`); ``q`` (m, quantities) holds the coefficients on the vertices, ``state`` is carried from call to
        call, ``force`` (m,) is filled. ``dt[0] == 0`` begins a path.
    states : int
        Length of ``state``; all zero is a damper at rest and unloaded.
    order : int
        Order of convergence over the step; 0 where the force is exact along a polyline.
    dissipative : bool
        Whether no closed cycle at constant current can yield energy, wherever in its bounds the model is.
    observables : callable, optional
        ``observables(values)``: what the data can determine, as {name: (value, unit)}, from the coefficients at one current
        by name of the quantity.
    effects : tuple of Effect
        What else acts, see `with_effects`.
    """

    id: str
    title: str
    equation: str
    source: str
    quantities: tuple[Quantity, ...]
    kernel: Kernel
    states: int = 0
    order: int = 0
    dissipative: bool = True
    observables: Callable[[Mapping[str, float]], dict[str, tuple[float, str]]] | None = None
    effects: tuple[Effect, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process finds the model in its own catalogue: compiled kernels do not travel."""
        from mrd_sim.models import find_model

        return find_model, (self.id, self.laws, tuple(effect.id for effect in self.effects))

    def with_laws(self, laws: str | Mapping[str, str]) -> "DamperModel":
        """The model with other current laws.

        Parameters
        ----------
        laws : str or mapping
            Id of a law for every coefficient that depends on current, or ids by name of the coefficient.

        Raises
        ------
        InputError
            For an unknown law or coefficient, or one that does not depend on current.
        """
        dependent = [quantity.name for quantity in self.quantities if quantity.per_ampere]
        chosen = dict.fromkeys(dependent, laws) if isinstance(laws, str) else dict(laws)
        for name, law in chosen.items():
            if name not in dependent:
                raise InputError(
                    f"model {self.id}: no current law for {name} (coefficients that have one: {', '.join(dependent)})"
                )
            if law not in LAWS:
                raise InputError(f"model {self.id}: unknown current law {law} for {name} (known: {', '.join(LAWS)})")
        return replace(self, quantities=tuple(replace(q, law=chosen.get(q.name, q.law)) for q in self.quantities))

    def with_effects(self, effects: Sequence[Effect]) -> "DamperModel":
        """The model with effects around it, their parameters after its own, named EFFECT.PARAMETER.

        The stages follow each other as cause becomes reading (`mrd_sim.effects.STAGES`): drive effects change the motion
        that the damper sees, magnetic ones its current; what is in series with it shares its motion; effects of fluid and
        structure change its force, or add to it; sensing makes of that force the measured one.

        Raises
        ------
        InputError
            For more things in series with the damper than can be solved for.
        """
        found = replace(self, effects=tuple(effects))
        if len(found._series) > MOST:
            series = ", ".join(effect.id for effect in found._series)
            raise InputError(f"effects {series}: all in series with the damper, expected at most {MOST} of these")
        return found

    @cached_property
    def laws(self) -> dict[str, str]:
        """Current law of every coefficient that may depend on current."""
        return {quantity.name: quantity.law for quantity in self.quantities if quantity.per_ampere}

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, in the order of a parameter vector."""
        return (
            *self._own_parameters,
            *(replace(p, name=f"{effect.id}.{p.name}") for effect in self.effects for p in effect.parameters),
        )

    @cached_property
    def _own_parameters(self) -> tuple[Parameter, ...]:
        """Those of the model without effects; the coil lag is the last."""
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
    def _codes(self) -> NDArray[np.intp]:
        """Law of each quantity."""
        return np.array([quantity.code for quantity in self.quantities], dtype=np.intp)

    @cached_property
    def _columns(self) -> NDArray[np.intp]:
        """Where the parameters of each quantity are in a parameter vector, -1 for those that its law does not have."""
        columns = np.full((len(self.quantities), 3), -1, dtype=np.intp)
        first = 0
        for row, quantity in zip(columns, self.quantities, strict=True):
            count = len(quantity.parameters())
            row[:count] = np.arange(first, first + count)
            first += count
        return columns

    @cached_property
    def _floors(self) -> Array:
        """Least value of each quantity on the vertices."""
        return np.array([NO_FLOOR if quantity.multiplies else quantity.lower for quantity in self.quantities])

    @cached_property
    def linear(self) -> NDArray[np.intp]:
        """Indices of the parameters in which the force is linear; none where effects act."""
        if self.effects:
            return np.array([], dtype=np.intp)
        found = [
            index
            for quantity, row in zip(self.quantities, self._columns, strict=True)
            if quantity.multiplies
            for index in row[: 3 if quantity.code == 2 else 2]
            if index >= 0
        ]
        return np.array(found, dtype=np.intp)

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
                found = f"{value:g} {parameter.unit}".rstrip()
                raise InputError(f"model {self.id}: {name} is {found}, expected {parameter.lower:g} to {parameter.upper:g}")
            theta[index] = value
        return theta

    def at_current(self, theta: Array, current: float) -> dict[str, float]:
        """Coefficients by name at one current in A."""
        row = self._coefficients(theta, np.array([current]))[0]
        return {quantity.name: float(value) for quantity, value in zip(self.quantities, row, strict=True)}

    def initial_state(self, path: Path) -> Array:
        """State of a damper at rest and unloaded, its effective current equal to the first measured one."""
        effects = [effect.begin(path) if effect.begin else np.zeros(effect.states) for effect in self.effects]
        own = [[path.current[0], path.current[0]], np.zeros(self.states)]
        return np.concatenate([*own, *effects, np.zeros(len(self._series) + 1)])

    def next_state(self, state: Array, path: Path) -> Array:
        """State at the start of a path recorded after another: as `initial_state`, but for what outlasts a run.

        Parameters
        ----------
        state : ndarray
            As the run before has left it, with derivatives where it carries them; not changed.
        path : Path
            The one to come.
        """
        found = self.initial_state(path).astype(state.dtype)
        edges = self._effect_states
        for effect, first, last in zip(self.effects, edges, edges[1:], strict=False):
            if effect.carries:
                found[first:last] = state[first:last]
        return found

    def force(self, theta: Array, path: Path, state: Array | None = None, solutions: SeriesSolutions | None = None) -> Array:
        """Force in N at the samples of a path.

        Parameters
        ----------
        theta : ndarray (parameters,)
            Real, or complex where it carries derivatives (`mrd_sim.dual`); so is the force then.
        path : Path
        state : ndarray, optional
            As from `initial_state`, of the type of ``theta``; changed in place, so that a following path continues where
            this one ended.
        """
        return self.forces(theta, path, state, solutions)[1]

    def forces(
        self, theta: Array, path: Path, state: Array | None = None, solutions: SeriesSolutions | None = None
    ) -> tuple[Array, Array]:
        """Force in N on the rod and the measured one, after the effects of sensing; arguments as of `force`."""
        if state is None:
            state = self.initial_state(path)
        if self.follows_force:
            path = path.fine
        state = np.asarray(state, theta.dtype)
        start = state.real.tobytes()
        x, v, a, current = path.position, path.velocity, path.acceleration, path.current
        force = np.zeros(len(x), theta.dtype)
        if self.effects:  # they change the signals in place
            x, v, a, current = (series.astype(theta.dtype) for series in (x, v, a, current))
        self._act(("drive", "magnetics"), theta, path.dt, (x, v, a, current, force), state)
        lag = theta[len(self._own_parameters) - 1]
        if lag == 0.0 and len(current):
            current = current.astype(theta.dtype, copy=False)
            state[:2] = current[-1]
        else:
            current = lagged_current(lag, state, path.dt, current)
        rows = self._coefficients(theta, current)
        inner = state[2 : 2 + self.states]
        if self._series:
            stretched = state[-len(self._series) - 1 :]
            self._run_in_series(theta, path, start, (stretched, rows.T, inner, path.dt, x, v, a, force), solutions)
        else:
            self.kernel(rows, inner, path.dt, x, v, a, force)
        self._act(("fluid", "structure"), theta, path.dt, (x, v, a, current, force), state)
        on_rod = force[path.samples]
        if not any(effect.stage == "sensing" for effect in self.effects):
            return on_rod, on_rod
        self._act(("sensing",), theta, path.dt, (x, v, a, current, force), state)
        return on_rod, force[path.samples]

    def _run_in_series(
        self, theta: Array, path: Path, start: bytes, arguments: tuple[Array, ...], solutions: SeriesSolutions | None
    ) -> None:
        """Fill the force of the damper and of what is in series with it; ``start`` is the state at the start of the path.

        The derivatives need the solution of the equations themselves, which is the same for all of them.
        """
        p = np.stack([np.resize(theta[part], 4) for part in self._effect_parameters(self._series)])
        stretches = tuple(effect.stretch for effect in self._series)
        derivatives = np.iscomplexobj(theta)
        key = theta.real.tobytes(), start
        known = solutions.get(id(path)) if solutions is not None and derivatives else None
        if known is None or known[0] != key:
            values = [np.ascontiguousarray(argument.real) for argument in arguments]
            solved = np.empty((len(path.dt), 2 + self.states))
            in_series(self.kernel, stretches, p.real + 0j, *values, solved)
            known = key, values[-1].copy(), solved
            if solutions is not None and not derivatives:
                solutions[id(path)] = known
        if derivatives:
            arguments[-1][:] = known[1]
            derivatives_in_series(self.kernel, stretches, p, *arguments, known[2])

    @cached_property
    def follows_force(self) -> bool:
        """Whether effects need vertices between samples, where the force changes fast."""
        return any(effect.follows_force for effect in self.effects)

    @property
    def has_series_elements(self) -> bool:
        """Whether effects give way in series with the damper, so that its force is the root of an equation."""
        return bool(self._series)

    @cached_property
    def _series(self) -> tuple[Effect, ...]:
        """Effects that give way in series with the damper."""
        return tuple(effect for effect in self.effects if effect.stretch is not None)

    @cached_property
    def _effect_states(self) -> NDArray[np.intp]:
        """Where the states of effects begin in a model's state, and where the last one's end."""
        return np.cumsum([2 + self.states, *(effect.states for effect in self.effects)])

    def _effect_parameters(self, effects: Sequence[Effect]) -> list[slice]:
        """Where the parameters of effects are in a parameter vector."""
        edges = np.cumsum([len(self._own_parameters), *(len(effect.parameters) for effect in self.effects)])
        return [slice(int(edges[i]), int(edges[i + 1])) for i in (self.effects.index(effect) for effect in effects)]

    def _act(self, stages: Sequence[Stage], theta: Array, dt: Array, signals: tuple[Array, ...], state: Array) -> None:
        """Let the effects of some stages change the signals in place."""
        edges = self._effect_states
        for stage in stages:
            for i, effect in enumerate(self.effects):
                if effect.stage == stage and effect.kernel is not None:
                    (p,) = self._effect_parameters([effect])
                    effect.kernel(theta[p], state[edges[i] : edges[i + 1]], dt, *signals)

    def regressors(self, theta: Array, path: Path) -> tuple[Array, Array]:
        """The force's linear part: ``force = columns @ theta[linear] + rest``.

        Parameters
        ----------
        theta : ndarray (parameters,)
            Its linear parameters do not matter.
        path : Path

        Returns
        -------
        columns : ndarray (samples, linear)
        rest : ndarray (samples,)
            Force in N of the parameters in which it is not linear.
        """
        state = self.initial_state(path)
        current = lagged_current(theta[-1], state, path.dt, path.current)
        rows = self._coefficients(theta, current)
        for j, quantity in enumerate(self.quantities):
            if quantity.multiplies:
                rows[:, j] = 0.0
        rest = self._run(rows, path)[path.samples] if self._has_rest else np.zeros(len(path.samples))
        current = current[path.samples]
        known = {"x": path.position, "v": path.velocity, "1": np.ones_like(path.position)}
        columns = np.empty((len(path.samples), len(self.linear)), order="F")
        filled = 0
        for j, quantity in enumerate(self.quantities):
            if not quantity.multiplies:
                continue
            if quantity.multiplies == "term":
                rows[:, j] = 1.0
                base = self._run(rows, path)[path.samples] - rest
                rows[:, j] = 0.0
            else:
                base = known[quantity.multiplies][path.samples]
            columns[:, filled] = base
            filled += 1
            if quantity.code:
                third = theta[self._columns[j, 2]] if self._columns[j, 2] >= 0 else 0.0
                columns[:, filled] = base * rise(quantity.code, third, current)
                filled += 1
            if quantity.code == 2:
                columns[:, filled] = base * current**2
                filled += 1
        return columns, rest

    @cached_property
    def _has_rest(self) -> bool:
        """Whether any force is left where all linear coefficients are zero: tried out on a motion like no other."""
        rng = np.random.default_rng(0)
        dt, x, v, a, current = rng.uniform(-0.1, 0.1, (5, 100))
        path = Path(np.abs(dt), np.cumsum(x), v, a, current, np.arange(100))
        rows = np.array([0.0 if q.multiplies else rng.uniform(q.lower, q.upper) for q in self.quantities])
        return bool(self._run(np.asfortranarray(np.tile(rows, (100, 1))), path).any())

    def _coefficients(self, theta: Array, current: Array) -> Array:
        rows = np.empty((len(current), len(self.quantities)), theta.dtype, order="F")
        coefficients(theta, self._codes, self._columns, self._floors, current, rows)
        return rows

    def _run(self, rows: Array, path: Path) -> Array:
        force = np.empty(len(rows), rows.dtype)
        self.kernel(rows, np.zeros(self.states, rows.dtype), path.dt, path.position, path.velocity, path.acceleration, force)
        return force
