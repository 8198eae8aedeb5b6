"""Goals of a trial."""

from dataclasses import dataclass

import numpy as np

from mrd_trials.scoring.gap import ExperimentComparison
from mrd_trials.scoring.rates import Calibration, Distribution, Rate

Figure = Rate | Distribution | Calibration | ExperimentComparison | float
"""A figure that a score consists of."""


@dataclass(frozen=True)
class Goal:
    """A figure with the range that it should lie in."""

    text: str
    figure: Figure
    least: float = -np.inf
    most: float = np.inf

    @property
    def value(self) -> float:
        """The number that is compared with the range."""
        match self.figure:
            case Rate():
                return self.figure.value
            case Distribution():
                return self.figure.median
            case Calibration():
                return self.figure.error
            case ExperimentComparison():
                return self.figure.ratio
        return self.figure

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None where nothing was measured."""
        return None if np.isnan(self.value) else bool(self.least <= self.value <= self.most)
