"""Play of the drive between where the position is measured and the rod: gearbox, rack and pinion."""

from typing import Any

from numba import njit

from mrd_sim.dual import clip
from mrd_sim.effects.effect import Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter
from mrd_sim.play import MOST_FILM, offset_in_play

PARAMETERS = (
    Parameter("play", "m", 0.0, 0.0, 4e-3, "free travel between the two flanks, g"),
    Parameter("drag", "N", 10.0, 1.0, 240.0, "dry friction that holds the rod within the play, F_d", log=True),
    Parameter("resistance", "N s/m", 300.0, 30.0, 3000.0, "resistance to crossing the play from its middle, c_g", log=True),
    Parameter("film", "", 0.5, 0.02, MOST_FILM, "share by which crossing is slower where a film is squeezed out, m"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _elongation(parameters: Any, before: Any, dt: float, force: Any, x: Any) -> Any:
    p = named(Parameters, parameters)
    return offset_in_play(before, dt, force - clip(force, -p.drag, p.drag), p.play, p.resistance, p.film)


EFFECT = Effect(
    id="backlash",
    title="Backlash of the drive",
    phrase="the drive has {play} of backlash",
    stage="drive",
    equation="F = damper(x - e), within |e| <= g / 2: e' = 0 where |F| <= F_d, else (F - F_d sgn F) / c_g "
    "(1 - m e sgn F / (g / 2))",
    source="two-stage planetary gears 8-15 arcmin, module-2 rack 50-150 µm: 0.1-0.3 mm at the rod",
    parameters=PARAMETERS,
    typical={"play": 2e-4, "drag": 10.0, "resistance": 300.0, "film": 0.5},
    starts=lambda _force: [2e-4, 8e-4, 6e-5, 2e-5],
    symptom="something between motor and damper gives",
    signature="the force stays near zero while the drive crosses the play, whenever the force changes sign",
    confused_with=("joint_play", "series_compliance", "cavitation", "seal_friction", "channel_delay"),
    separated_by="position of the rod compared with that of the motor; a preload that keeps the force from changing sign",
    shows=("reversal",),
    imitated_by=("timing", "clipped position"),
    elongation=_elongation,
)
