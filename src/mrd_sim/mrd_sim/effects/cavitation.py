"""Cavitation: gas pressure balances no more than a certain compressing force. Rebound first has to close the void."""

from typing import Any

from numba import njit

from mrd_sim.effects.effect import Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("inverse_cap", "1/N", 0.0, 0.0, 5e-3, "1 / the largest compressing force, p"),
    Parameter("opening", "m/s", 0.1, 1e-3, 10.0, "speed at which the void grows under twice that force, s", log=True),
    Parameter("preload", "N", 0.0, 0.0, 300.0, "gas force at mid-stroke, F_0"),
    Parameter("stiffness", "N/m", 0.0, 0.0, 1e4, "stiffness of the gas, k"),
    Parameter(
        "closing", "N s/m", 500.0, 500.0, 500.0, "resistance against which a void closes, almost none, c_v", free=False
    ),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _elongation(parameters: Any, before: Any, dt: float, force: Any, x: Any) -> Any:
    p = named(Parameters, parameters)
    after = before
    fluid = force + p.preload - p.stiffness * x
    over = -p.inverse_cap * fluid - 1.0
    if over.real > 0.0:
        after -= p.opening * dt * over
    elif fluid.real > 0.0:
        after += dt * fluid / p.closing
    return after if after.real < 0.0 else 0.0 * after


EFFECT = Effect(
    id="cavitation",
    title="Cavitation in compression",
    phrase="cavitation limits the force in compression to {inverse_cap:inverse}",
    stage="fluid",
    equation="F = damper(x - e), e <= 0, by the fluid's part f = F + F_0 - k x: e' = -s (p |f| - 1) where f < -1/p, "
    "f / c_v where f > 0, else 0",
    source="gas pressure times piston area carries 1-2 kN; shock-absorber practice (compression cap, delayed rebound)",
    parameters=PARAMETERS,
    typical={"inverse_cap": 1.5e-3, "opening": 0.3, "preload": 50.0, "stiffness": 1000.0},
    starts=lambda force: [1.0 / (share * max(-float(force.min()), 1.0)) for share in (0.9, 0.75, 0.5)],
    symptom="extension and compression differ",
    signature="the force in compression is capped, the more so the more current; the rebound after it comes late",
    confused_with=("backlash", "flow_asymmetry", "current_saturation", "bypass_flow"),
    separated_by="rising current at one speed; another gas pressure",
    shows=("reversal", "sign", "current"),
    imitated_by=("timing", "clipped force"),
    elongation=_elongation,
)
