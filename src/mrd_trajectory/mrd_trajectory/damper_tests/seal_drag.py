"""Seal drag: slow strokes around mid-stroke."""

from dataclasses import dataclass

from mrd_trajectory.damper_tests.slow_strokes import SlowStrokes


@dataclass(frozen=True, kw_only=True)
class SealDrag(SlowStrokes):
    """Seal drag: half the difference of the force between both directions, on a short stroke slower than the gas force's."""

    REACH = 0.2
    CYCLE = 3.0
