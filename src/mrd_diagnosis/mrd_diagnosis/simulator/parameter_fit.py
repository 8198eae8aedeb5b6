"""Refit of the named parameters of a user's simulator, before anybody looks for what it lacks."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mrd_base import InputError
from mrd_diagnosis.simulator.self_check import check_against_force
from mrd_diagnosis.wording.quantities import format_share
from mrd_identification.recording import Recording
from mrd_sim.simulators.adjusted import AdjustedSimulator, find_parameter
from mrd_sim.simulators.simulator import Simulator, SimulatorParameter, signals_of

Array = NDArray[np.float64]

EVALUATIONS = 30
"""Points of the search, each with its derivatives, at most: every answer of a slow simulator counts."""

DIFFERENCE = 1e-3
"""Share of a parameter's size by which it is changed for a derivative; a simulator with a step of its own is not smooth."""

AT_BOUND = 1e-3
"""Share of a parameter's range within which it stands at a bound."""

Bounds = tuple[float, float]


def refit_parameters(
    simulator: Simulator, recordings: Sequence[Recording], free: Mapping[str, Bounds | None]
) -> AdjustedSimulator:
    """Return a simulator with parameters that fit the recordings best, by nonlinear least squares.

    The offset of the force of each run is free, because a load cell has one that no simulator knows.

    Parameters
    ----------
    simulator : Simulator
    recordings : sequence of Recording
    free : mapping
        Lower and upper bound of each free parameter by its name; None for those that the simulator states.

    Raises
    ------
    InputError
        For a parameter that the simulator does not have, bounds that do not hold its value, a parameter that does not
        change the force, or a simulator that fails.
    """
    parameters = [_bounded(find_parameter(simulator, name), bounds, simulator.name) for name, bounds in free.items()]
    start = np.array([parameter.value for parameter in parameters])
    lower, upper = (np.array([getattr(parameter, side) for parameter in parameters]) for side in ("lower", "upper"))
    size = np.array([_size(parameter, simulator.name) for parameter in parameters])
    signals = [signals_of(recording.smoothed) for recording in recordings]
    measured = [recording.run.force for recording in recordings]
    spread = float(np.std(np.concatenate([force - force.mean() for force in measured])))

    def forces(scaled: Array) -> list[Array]:
        values = _named(parameters, scaled * size)
        try:
            return [simulator.force(along, values) for along in signals]
        except InputError as error:
            at = ", ".join(f"{name} = {value:.4g}" for name, value in values.items())
            raise InputError(f"{error}; this was with {at}: give narrower bounds with --free NAME:LOW:HIGH") from None

    def errors(scaled: Array) -> Array:
        differences = [simulated - force for simulated, force in zip(forces(scaled), measured, strict=True)]
        return np.concatenate([difference - difference.mean() for difference in differences]) / spread

    check_against_force(simulator.name, recordings, forces(start / size))

    def derivatives(scaled: Array) -> Array:
        """Return the derivatives of the errors (samples, parameters), by a step of each parameter within its bounds."""
        here = errors(scaled)
        up, down = upper / size - scaled, scaled - lower / size
        steps = np.where(up >= down, np.minimum(up, DIFFERENCE), -np.minimum(down, DIFFERENCE))
        return np.stack([(errors(scaled + step) - here) / step[k] for k, step in enumerate(np.diag(steps))], axis=1)

    found = least_squares(errors, start / size, jac=derivatives, bounds=(lower / size, upper / size), max_nfev=EVALUATIONS)
    if still := [parameter.name for parameter, column in zip(parameters, found.jac.T, strict=True) if not column.any()]:
        raise InputError(
            f"simulator {simulator.name}: its force does not depend on the parameter {still[0]}; leave it out of --free"
        )
    values = _named(parameters, found.x * size)
    before, after = (float(np.sqrt(np.mean(errors(x) ** 2))) for x in (start / size, found.x))
    return AdjustedSimulator(simulator, values, (_note(simulator.name, parameters, values, before, after),))


def _named(parameters: Sequence[SimulatorParameter], values: Array) -> dict[str, float]:
    # Seven digits: the numbers are repeated on command lines, and no fit knows more. Rounded, they stay within the bounds.
    return {
        parameter.name: min(max(float(f"{value:.7g}"), parameter.lower), parameter.upper)
        for parameter, value in zip(parameters, values, strict=True)
    }


def _bounded(parameter: SimulatorParameter, bounds: Bounds | None, simulator: str) -> SimulatorParameter:
    """Return a parameter with the bounds that were asked for, as far as the simulator allows them."""
    lower, upper = bounds or (parameter.lower, parameter.upper)
    if not lower < upper:
        raise InputError(f"--free: {parameter.name} has the bounds {lower:g} to {upper:g}, expected the lower one first")
    if not parameter.lower <= lower <= parameter.value <= upper <= parameter.upper:
        stated = f" and within {parameter.lower:g} to {parameter.upper:g}" if np.isfinite(parameter.upper) else ""
        raise InputError(
            f"--free: {parameter.name} has the bounds {lower:g} to {upper:g}, expected around its value in {simulator}, "
            f"{parameter.value:g}{stated}"
        )
    return SimulatorParameter(parameter.name, parameter.value, lower, upper, parameter.unit)


def _size(parameter: SimulatorParameter, simulator: str) -> float:
    """Return the size of a parameter, in which it is searched."""
    if parameter.value != 0.0:
        return abs(parameter.value)
    size = max(-parameter.lower, parameter.upper)
    if not np.isfinite(size):
        raise InputError(
            f"--free: {parameter.name} is 0 in {simulator}, and without bounds, so that its size is not known; give them: "
            f"--free {parameter.name}:LOW:HIGH"
        )
    return float(size)


def _note(
    simulator: str, parameters: Sequence[SimulatorParameter], values: Mapping[str, float], before: float, after: float
) -> str:
    """Return what the refit changed."""
    changes = []
    for parameter in parameters:
        value, unit = values[parameter.name], f" {parameter.unit}" if parameter.unit else ""
        width = parameter.upper - parameter.lower
        edge = min(value - parameter.lower, parameter.upper - value) <= AT_BOUND * width if np.isfinite(width) else False
        bound = ", which is its bound" if edge else ""
        changes.append(f"{parameter.name} from {parameter.value:.4g} to {value:.4g}{unit}{bound}")
    return (
        f"Parameters of {simulator} were refitted first: {'; '.join(changes)}. Its error went from {format_share(before)} "
        f"to {format_share(after)} (NRMSE without the offset of each run)."
    )
