"""What the live plots draw: some hundred points of the latest samples, with the prediction of a fitted model.

All plots share one table, in the units that people read. Its size does not depend on the sampling rate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from mrd_dashboard.sample_history import SampleHistory, Samples
from mrd_identification.fit_file import StoredFit, read_fit
from mrd_sim.models import DamperModel, find_model
from mrd_sim.path import make_path

Array = NDArray[np.float64]

SHOWN = 5.0
"""s of the latest samples that the plots show."""
MOST_POINTS = 500
"""Points of each curve."""
# The prediction begins so many seconds before the first point that is shown: the state of a hysteresis is forgotten by then.
_LEAD = 1.0
# Time in s over which a quadratic is fitted for velocity and acceleration; noise of the LVDT is 5 µm.
_SMOOTHING = 0.02

COLUMNS = ("time_s", "force_N", "position_mm", "current_mA", "velocity_mm_per_s", "predicted_N", "residual_N")


@dataclass(frozen=True, eq=False)
class LivePrediction:
    """A fitted model whose force is drawn over the measured one.

    Attributes
    ----------
    name : str
        Where it comes from, as the page names it.
    model : DamperModel
    theta : ndarray
        Parameters of the model.
    """

    name: str
    model: DamperModel
    theta: Array

    @classmethod
    def of_fit(cls, fit: StoredFit, name: str) -> "LivePrediction":
        """Return the prediction of a stored fit."""
        model = find_model(fit.model, fit.laws, fit.effects)
        return cls(name, model, model.vector(fit.values))

    def force(self, samples: Samples) -> Array:
        """Return the modelled force (n,) in N at the samples."""
        velocity, acceleration = derivative(samples, 1), derivative(samples, 2)
        path = make_path(samples.time - samples.time[0], samples.position, velocity, acceleration, samples.current)
        return np.asarray(self.model.force(self.theta, path))


def try_prediction(fit: str) -> LivePrediction:
    """Return the prediction of a fit.json, once it has computed a force; the first time, its model is compiled meanwhile.

    Raises
    ------
    InputError
        When the file cannot be used.
    """
    prediction = LivePrediction.of_fit(read_fit(fit), fit)
    time = np.arange(100) / 1000.0
    prediction.force(Samples(np.arange(100), time, 1e-3 * np.sin(6.0 * time), 0.0 * time, 0.0 * time))
    return prediction


def compile_prediction(fit: str) -> None:
    """Compute a force with a fit.json, for a process that only compiles its model onto the disk."""
    try_prediction(fit)


def derivative(samples: Samples, order: int) -> Array:
    """Return velocity (order 1, in m/s) or acceleration (2, in m/s²) (n,) of a local quadratic through the positions.

    Source: Savitzky and Golay (1964), Analytical Chemistry 36, 1627-1639.
    """
    if len(samples) < 5:
        return np.zeros(len(samples))
    period = (samples.time[-1] - samples.time[0]) / (len(samples) - 1)
    window = min(max(5, 2 * round(_SMOOTHING / period / 2) + 1), len(samples) - 1 + len(samples) % 2)
    return np.asarray(savgol_filter(samples.position, window, 2, deriv=order, delta=period))


def live_frame(history: SampleHistory, prediction: LivePrediction | None = None) -> dict[str, list[float]]:
    """Return the columns of the table that the plots draw; time counts back from the latest sample.

    A sample is drawn or not by its number alone, so that points do not jump from one frame to the next.
    """
    samples = history.latest(SHOWN + (_LEAD if prediction else 0.0))
    if not len(samples):
        return {name: [] for name in COLUMNS}
    velocity = derivative(samples, 1)
    stride = -(-int(np.count_nonzero(samples.time > samples.time[-1] - SHOWN)) // MOST_POINTS)
    drawn = np.flatnonzero((samples.number % stride == 0) & (samples.time >= samples.time[-1] - SHOWN))
    columns = [samples.time - samples.time[-1], samples.force, 1e3 * samples.position, 1e3 * samples.current, 1e3 * velocity]
    if prediction and len(samples) >= 5:
        predicted = prediction.force(samples)
        columns += [predicted, samples.force - predicted]
    return {name: np.round(column[drawn], 3).tolist() for name, column in zip(COLUMNS, columns, strict=False)} | {
        name: [] for name in COLUMNS[len(columns) :]
    }
