"""Gas force: slow strokes over the whole usable stroke."""

from dataclasses import dataclass

from mrd_trajectory.damper_tests.slow_strokes import SlowStrokes


@dataclass(frozen=True, kw_only=True)
class GasForce(SlowStrokes):
    """Gas force and its stiffness: the mean force of both directions over the whole usable stroke."""

    REACH = 1.0
    CYCLE = 4.0
