"""From series to a `Run`: what makes a recording usable, checked at one place for every source."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.run import Run

Array = NDArray[np.float64]

FEWEST_SAMPLES = 50

# What no bench of this kind measures, per column: largest magnitude and what to suspect beyond it.
_LARGEST = {
    "current_A": (20.0, "is it in mA?"),
    "force_N": (1e6, "is it in mN?"),
    "acceleration_mps2": (1e4, "is it in mm/s²?"),
    "velocity_mps": (50.0, "is it in mm/s?"),
}
_LONGEST_STROKE = 0.5  # m, peak to peak
_INTERVALS = (5e-6, 0.25)  # s, of the median sampling interval


def make_run(
    name: str,
    columns: Mapping[str, Array],
    info: Mapping[str, Any] | None = None,
    *,
    where: str | None = None,
    place: Callable[[int], str] = "sample {}".format,
) -> Run:
    """Check series and make a `Run` of them.

    Parameters
    ----------
    name : str
        Name of the run.
    columns : mapping
        Equally long series (n,) by their column names: ``time_s``, ``position_m``, ``current_A``, ``force_N``, and
        optionally ``velocity_mps``, ``acceleration_mps2``, ``temperature_C``.
    info : mapping, optional
        What is known beside the samples; the notes of the check are appended to its ``notes``.
    where : str, optional
        Prefix of error messages; ``name`` when absent.
    place : callable, optional
        How error messages name the sample of an index.

    Returns
    -------
    Run
        Time starts at 0. The velocity is the recorded one, or that of the smoothed motion.

    Raises
    ------
    InputError
        For fewer than 50 samples, a value that is not finite, time that does not increase, values that must be in another
        unit.
    """
    # numba takes a third of a second to import; the recorder never smooths.
    from mrd_runs.signals.motion import smooth_motion

    where = where or name
    columns = {key: np.ascontiguousarray(values, np.float64) for key, values in columns.items()}
    _check_samples(columns, where, place)
    notes = list((info or {}).get("notes", ())) + _check_units(columns, where)
    time = columns["time_s"] - columns["time_s"][0]
    temperature = columns.get("temperature_C")

    smoothed = None
    if "velocity_mps" not in columns:
        smoothed = smooth_motion(time, columns["position_m"], columns.get("acceleration_mps2"))
        notes += [smoothed.note] if smoothed.note else []
    return Run(
        name,
        time,
        columns["position_m"],
        columns["velocity_mps"] if smoothed is None else smoothed.velocity,
        columns["current_A"],
        columns["force_N"],
        columns.get("acceleration_mps2"),
        None if temperature is None else temperature + 273.15,
        {**(info or {}), "notes": tuple(notes)},
    )


def _check_samples(columns: Mapping[str, Array], where: str, place: Callable[[int], str]) -> None:
    time = columns["time_s"]
    if len(time) < FEWEST_SAMPLES:
        raise InputError(f"{where}: holds {len(time)} samples, expected at least {FEWEST_SAMPLES}")
    for key, values in columns.items():
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise InputError(f"{where}: {place(index)}: {key} is {values[index]}, expected a finite number")
    backwards = np.diff(time) <= 0
    if backwards.any():
        index = int(np.argmax(backwards)) + 1
        raise InputError(
            f"{where}: {place(index)}: time_s is {time[index]:.9g} after {time[index - 1]:.9g}, expected increasing time"
        )


def _check_units(columns: Mapping[str, Array], where: str) -> list[str]:
    """Refuse what must be in another unit; return notes on what might be."""
    interval = float(np.median(np.diff(columns["time_s"])))
    if not _INTERVALS[0] <= interval <= _INTERVALS[1]:
        suspicion = "is it in ms?" if interval > 1e-3 else "is it in minutes or hours?"
        raise InputError(
            f"{where}: time_s advances by {interval:g} a sample, expected {_INTERVALS[0]:g} to {_INTERVALS[1]:g} s; "
            f"{suspicion}"
        )
    stroke = float(np.ptp(columns["position_m"]))
    if stroke > _LONGEST_STROKE:
        raise InputError(
            f"{where}: position_m spans {stroke:g}, expected at most {_LONGEST_STROKE:g} m peak to peak; is it in mm?"
        )
    for key, (largest, suspicion) in _LARGEST.items():
        if key in columns and (found := float(np.abs(columns[key]).max())) > largest:
            raise InputError(f"{where}: {key} reaches {found:g}, expected at most {largest:g}; {suspicion}")
    if "temperature_C" in columns:
        lowest, highest = float(columns["temperature_C"].min()), float(columns["temperature_C"].max())
        if lowest < -60 or highest > 220:
            raise InputError(
                f"{where}: temperature_C spans {lowest:g} to {highest:g}, expected -60 to 220 °C; is it in K or °F?"
            )
    notes = []
    if "velocity_mps" in columns and stroke > 0:
        derivative = np.gradient(columns["position_m"], columns["time_s"])
        ratio = float(np.std(columns["velocity_mps"]) / np.std(derivative))
        if ratio > 100:
            raise InputError(
                f"{where}: velocity_mps is {ratio:.3g} times the derivative of position_m, expected about 1; is it in mm/s?"
            )
        if ratio > 1.5 or ratio < 0.5:
            notes.append(f"velocity_mps is {ratio:.2g} times the derivative of position_m")
    span = float(np.ptp(columns["force_N"]))
    if stroke > 1e-3 and 0 < span < 5:
        notes.append(f"force_N spans only {span:.3g} N over a stroke of {stroke * 1e3:.3g} mm: is it in kN or V?")
    return notes
