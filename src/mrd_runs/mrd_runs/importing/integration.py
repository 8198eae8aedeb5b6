"""The position of recordings that hold the velocity only."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FEWEST_TURNS = 4
_WANDERING = 0.05
"""Wandering of the turning points, relative to the stroke, from which the position is said to be doubtful."""


def integrate_velocity(time: Array, velocity: Array) -> tuple[Array, str]:
    """Integrate a velocity to a position whose strokes do not drift.

    A zero error of the velocity integrates to a straight line. The middle between each turning point of the rod and the next
    shows it: unlike a mean velocity, it does not depend on where in a stroke the recording begins and ends.

    Parameters
    ----------
    time : ndarray (n,)
        In s.
    velocity : ndarray (n,)
        In m/s.

    Returns
    -------
    position : ndarray (n,)
        In m, about the middle of its range, because nothing tells where the rod was.
    note : str
        What was done.
    """
    # They take half a second to import, and few recordings hold no position.
    from scipy.integrate import cumulative_trapezoid
    from scipy.signal import find_peaks

    position = np.asarray(cumulative_trapezoid(velocity, time, initial=0.0))
    stroke = float(np.ptp(position - np.polyval(np.polyfit(time, position, 1), time)))
    turns = np.sort(np.concatenate([find_peaks(sign * position, prominence=0.2 * stroke)[0] for sign in (1, -1)]))
    begin = "there is no position: it is the integral of the velocity, with its middle at zero"
    if len(turns) < _FEWEST_TURNS:
        centred = position - 0.5 * (position.max() + position.min())
        return centred, f"{begin}; the rod turns too rarely to tell a drift, which a zero error of the velocity would make"
    middles = 0.5 * (position[turns[1:]] + position[turns[:-1]])
    times = 0.5 * (time[turns[1:]] + time[turns[:-1]])
    slope, start = np.polyfit(times, middles, 1)
    wandering = float(np.std(middles - (start + slope * times)))
    centred = position - slope * time
    centred -= 0.5 * (centred.max() + centred.min())
    note = (
        f"{begin}; a drift of {1e3 * slope:.3g} mm/s was removed, {1e3 * abs(slope) * (time[-1] - time[0]):.3g} mm over the "
        "recording"
    )
    if wandering > _WANDERING * np.ptp(centred):
        note += f", but the middle of the strokes still wanders by {1e3 * wandering:.2g} mm rms: trust no spring or end stop"
    return np.asarray(centred), note
