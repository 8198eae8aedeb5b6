"""Play of the drive between where the position is measured and the rod: gearbox, rack and pinion."""

from typing import Any

from numba import njit

from mrd_sim.dual import sqrt
from mrd_sim.effects.effect import Effect
from mrd_sim.parameter import Parameter


@njit(cache=True, nogil=True)
def _stretch(p: Any, before: Any, dt: float, force: Any) -> Any:
    # Nowhere flat, unlike a tanh, so that Newton's method for the force finds its way from afar.
    return 0.5 * p[0] * force / sqrt(force * force + p[1] * p[1])


EFFECT = Effect(
    id="backlash",
    title="Backlash of the drive",
    phrase="the drive has {play} of backlash",
    stage="drive",
    equation="F = damper(x - (g/2) F / sqrt(F² + F_d²))",
    source="two-stage planetary gears 8-15 arcmin, module-2 rack 50-150 µm: 0.1-0.3 mm at the rod",
    parameters=(
        Parameter("play", "m", 0.0, 0.0, 6e-4, "free travel g between the two flanks"),
        Parameter("drag", "N", 10.0, 1.0, 60.0, "force F_d that carries the rod across the play", log=True),
    ),
    typical={"play": 2e-4, "drag": 10.0},
    signature="the force stays near zero while the drive crosses the play, each time that the force changes sign",
    confused_with=("joint_play", "series_compliance", "cavitation", "seal_friction", "channel_delay"),
    separated_by="position on the rod against position of the motor; a preload that keeps the force from changing sign",
    stretch=_stretch,
)
