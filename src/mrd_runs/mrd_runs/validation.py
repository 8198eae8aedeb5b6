"""`make_run`: checks columns of samples from any source and makes a `Run` of them."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.quantities import ZERO_CELSIUS
from mrd_base.table import check_columns
from mrd_runs.missing import check_missing
from mrd_runs.run import FEWEST_SAMPLES, Run
from mrd_runs.scales import LARGEST, SMALLEST

Array = NDArray[np.float64]

REQUIRED = ("time_s", "position_m", "current_A", "force_N")
"""Columns that every run has."""

# Magnitude of each column that no damper bench exceeds, and the unit to suspect beyond it.
_LARGEST_MAGNITUDES = {
    "current_A": (LARGEST.current, "is it in mA?"),
    "force_N": (LARGEST.force, "is it in mN?"),
    "acceleration_mps2": (1e4, "is it in mm/s²?"),
    "velocity_mps": (5.0 * LARGEST.speed, "is it in mm/s?"),  # single samples are faster than the strokes
}
_LARGEST_STROKE = 2.0 * LARGEST.stroke  # m, peak to peak
LARGEST_RATIO = 100.0
"""Velocity over the derivative of the position, from which its unit must be another one."""
_USUAL_RATIOS = (0.5, 1.5)
"""The same, between which a velocity is that of the position; a smoother makes it smaller."""
_AVERAGING_TIME = 0.02  # s
MEDIAN_INTERVALS = (5e-6, 0.25)  # s; 4 Hz to 200 kHz
_TIME_UNITS = {"ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "minutes": 60.0, "hours": 3600.0, "days": 86400.0}
_LONGEST_GAP, _LARGEST_GAP = 60.0, 100.0  # s, and relative to all other times
_TEMPERATURES = (-60.0, 220.0)  # °C; the limits of damper oils and seals


def make_run(
    name: str,
    columns: Mapping[str, Array],
    info: Mapping[str, Any] | None = None,
    *,
    where: str | None = None,
    place: Callable[[int], str] = "sample {}".format,
) -> Run:
    """Check columns of samples and make a `Run` of them.

    Parameters
    ----------
    name : str
        Name of the run.
    columns : mapping of str to ndarray (n,)
        Equally long columns: ``time_s``, ``position_m``, ``current_A``, ``force_N``, and optionally ``velocity_mps``,
        ``acceleration_mps2``, ``temperature_C``.
    info : mapping, optional
        Facts about the recording. Notes of the checks are appended to its ``notes``.
    where : str, optional
        Prefix of error messages, by default ``name``.
    place : callable, optional
        Returns how an error message names the sample of an index.

    Returns
    -------
    Run
        Its time starts at 0. Its velocity is the recorded one, where this is about the derivative of the position, or else
        that of the smoothed motion.

    Raises
    ------
    InputError
        For fewer than 50 samples, a value that is not finite, time that does not increase, or values that must be in
        another unit.
    """
    # Importing the smoother imports numba, which takes a third of a second. The recorder never needs it.
    from mrd_runs.signals.motion import smooth_motion

    where = where or name
    if missing := [key for key in REQUIRED if key not in columns]:
        raise InputError(
            f"{where}: has no column {missing[0]} (columns: {', '.join(map(str, columns)) or 'none'}), expected "
            f"{', '.join(REQUIRED)}"
        )
    columns = {key: np.ascontiguousarray(values, np.float64) for key, values in columns.items()}
    check_values(columns, where, place)
    notes = [*(info or {}).get("notes", ()), *_unit_notes(columns)]
    time = columns["time_s"] - columns["time_s"][0]
    velocity, note = _usable_velocity(columns, where)
    notes += [note] if note and note not in notes else []
    temperature = columns.get("temperature_C")
    if velocity is None:
        smoothed = smooth_motion(time, columns["position_m"], columns.get("acceleration_mps2"))
        velocity = smoothed.velocity
        notes += [smoothed.note] if smoothed.note else []
    return Run(
        name,
        time,
        columns["position_m"],
        velocity,
        columns["current_A"],
        columns["force_N"],
        columns.get("acceleration_mps2"),
        None if temperature is None else temperature + ZERO_CELSIUS,
        {**(info or {}), "notes": tuple(notes)},
    )


def check_values(columns: Mapping[str, Array], where: str, place: Callable[[int], str] = "sample {}".format) -> None:
    """Check columns of samples as `make_run` does; raise InputError for the first that is unusable."""
    check_columns(columns, FEWEST_SAMPLES, where, place)
    for name, values in columns.items():
        check_missing(values, name, where, place)
    _check_gaps(columns["time_s"], where, place)
    _check_units(columns, where)


def _check_gaps(time: Array, where: str, place: Callable[[int], str]) -> None:
    """Refuse a time that lies so far from all others that it must be wrong."""
    steps = np.diff(time)
    index = int(np.argmax(steps))
    rest = float(time[-1] - time[0] - steps[index])
    if steps[index] > max(_LONGEST_GAP, _LARGEST_GAP * rest):
        raise InputError(
            f"{where}: {place(index + 1)}: time_s is {time[index + 1]:.9g} after {time[index]:.9g}; this gap is "
            f"{steps[index] / rest:.3g} times as long as the rest of the recording; if the time stamp is wrong, remove the "
            "sample, else split the file there"
        )


def _check_units(columns: Mapping[str, Array], where: str) -> None:
    """Refuse values that must be in another unit."""
    interval = float(np.median(np.diff(columns["time_s"])))
    shortest, longest = MEDIAN_INTERVALS
    if not shortest <= interval <= longest:
        units = [unit for unit, size in _TIME_UNITS.items() if shortest <= interval * size <= longest]
        raise InputError(
            f"{where}: time_s advances by {interval:g} a sample, expected {shortest:g} to {longest:g} s; "
            f"is it in {' or '.join(units) or 'another unit'}?"
        )
    stroke = float(np.ptp(columns["position_m"]))
    if stroke > _LARGEST_STROKE:
        raise InputError(
            f"{where}: position_m spans {stroke:g}, expected at most {_LARGEST_STROKE:g} m peak to peak; is it in mm?"
        )
    for name, values in columns.items():
        if problem := magnitude_problem(name, values):
            raise InputError(f"{where}: {problem}")


def magnitude_problem(name: str, values: Array) -> str:
    """Return what no damper bench measures in a column; "" where nothing."""
    if name in _LARGEST_MAGNITUDES:
        largest, suspicion = _LARGEST_MAGNITUDES[name]
        if (magnitude := float(np.abs(values).max(initial=0.0))) > largest:
            return f"{name} reaches {magnitude:g}, expected at most {largest:g}; {suspicion}"
    if name == "temperature_C" and len(values):
        lowest, highest = float(values.min()), float(values.max())
        if lowest < _TEMPERATURES[0] or highest > _TEMPERATURES[1]:
            return (
                f"{name} spans {lowest:g} to {highest:g}, "
                f"expected {_TEMPERATURES[0]:g} to {_TEMPERATURES[1]:g} °C; is it in K or °F?"
            )
    return ""


@np.errstate(all="ignore")  # a stranger's numbers may be anything
def velocity_ratio(time: Array, position: Array, velocity: Array) -> float:
    """Return how many times the derivative of the position a velocity is, in the rms of the ways within `_AVERAGING_TIME`.

    A derivative from sample to sample would be mostly noise where a slow motion is sampled fast.
    """
    width = max(1, min(round(_AVERAGING_TIME / float(np.median(np.diff(time)))), len(time) // 4))
    path = np.append(0.0, np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)))
    ways, expected = (float(np.sqrt(np.mean((series[width:] - series[:-width]) ** 2))) for series in (path, position))
    return ways / expected if expected > 0.0 else 1.0


def _usable_velocity(columns: Mapping[str, Array], where: str) -> tuple[Array | None, str]:
    """Return the recorded velocity, or None where it is not that of the position, and a note then; refuse a unit of mm/s."""
    velocity, position = columns.get("velocity_mps"), columns["position_m"]
    # A rod at rest tells nothing about it.
    if velocity is None or np.ptp(position) < 2.0 * SMALLEST.stroke:
        return velocity, ""
    ratio = velocity_ratio(columns["time_s"], position, velocity)
    if ratio > LARGEST_RATIO:
        raise InputError(
            f"{where}: velocity_mps is {ratio:.3g} times the derivative of position_m, expected about 1; is it in mm/s?"
        )
    if _USUAL_RATIOS[0] <= ratio <= _USUAL_RATIOS[1]:
        return velocity, ""
    return None, (
        f"velocity_mps is {ratio:.2g} times the derivative of position_m, expected about 1: it is not used; the velocity is "
        "that of the smoothed motion"
    )


def _unit_notes(columns: Mapping[str, Array]) -> list[str]:
    """Return notes on values that may be in another unit."""
    notes = []
    stroke = float(np.ptp(columns["position_m"]))
    span = float(np.ptp(columns["force_N"]))
    if stroke > 1e-3 and 0 < span < 5:
        notes.append(f"force_N spans only {span:.3g} N over a stroke of {stroke * 1e3:.3g} mm: is it in kN or V?")
    return notes
