"""Compliance in series with the damper: compressed fluid, load cell, mounts."""

from typing import Any

from numba import njit

from mrd_sim.effects.effect import Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (Parameter("compliance", "m/N", 0.0, 0.0, 2e-6, "elongation over force, 1 / k_s"),)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _elongation(parameters: Any, before: Any, dt: float, force: Any, x: Any) -> Any:
    p = named(Parameters, parameters)
    return p.compliance * force


EFFECT = Effect(
    id="series_compliance",
    title="Compliance in series",
    phrase="a compliance of {compliance} is in series with the damper",
    stage="fluid",
    equation="F = damper(x - F / k_s)",
    source="Guo, Hu & Yi, JIMSS (2013); load cells of 100 kg: 2.5 to 5 MN/m",
    parameters=PARAMETERS,
    typical={"compliance": 4e-7},
    symptom="something between motor and damper gives",
    signature="rounded reversals, each of which loses a travel of 2 F / k_s",
    confused_with=("joint_play", "backlash", "pre_yield_hysteresis", "channel_delay", "force_sensor_lag", "bypass_flow"),
    separated_by="small strokes at high current; the same peak speed at different frequencies",
    shows=("reversal", "step"),
    elongation=_elongation,
)
