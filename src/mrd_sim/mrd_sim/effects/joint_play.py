"""Play in a joint in series with the damper, crossed against friction or a film of grease."""

from typing import Any

from numba import njit

from mrd_sim.effects.effect import Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter
from mrd_sim.play import MOST_FILM, offset_in_play

PARAMETERS = (
    Parameter("play", "m", 0.0, 0.0, 4e-3, "free travel end to end, g"),
    Parameter("resistance", "N s/m", 2.5e4, 5e3, 3e5, "resistance to crossing the play from its middle, c_g", log=True),
    Parameter("film", "", 0.5, 0.02, MOST_FILM, "share by which crossing is slower where a film is squeezed out, m"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _elongation(parameters: Any, before: Any, dt: float, force: Any, x: Any) -> Any:
    p = named(Parameters, parameters)
    return offset_in_play(before, dt, force, p.play, p.resistance, p.film)


EFFECT = Effect(
    id="joint_play",
    title="Play in a joint",
    phrase="a joint has {play} of play",
    stage="structure",
    equation="F = damper(x - e), within |e| <= g / 2: e' = (F / c_g) (1 - m e sgn F / (g / 2))",
    source="measured on a rig with clevis joints: g about 0.3 mm, c_g 17-35 kN s/m",
    parameters=PARAMETERS,
    typical={"play": 3e-4, "resistance": 2.5e4, "film": 0.5},
    starts=lambda _force: [3e-4, 1e-3, 1e-4, 3e-5],
    symptom="something between motor and damper gives",
    signature="a step or dead zone where the force changes sign, over a travel that does not depend on current",
    confused_with=("series_compliance", "backlash", "pre_yield_hysteresis"),
    separated_by="small strokes at several currents; a preload that keeps the force from changing sign",
    shows=("reversal",),
    imitated_by=("timing", "clipped position"),
    elongation=_elongation,
)
