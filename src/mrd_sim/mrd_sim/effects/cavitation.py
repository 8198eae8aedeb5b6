"""Cavitation: gas pressure cannot hold up a large compressing force; the void that forms is crossed before rebound acts."""

from numba import njit

from mrd_sim.dual import exp, power
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.parameter import Parameter

_SHARPNESS = 6.0
_EDGE = 2e-4  # m, travel over which the force returns as the void closes


@njit(cache=True, nogil=True)
def _apply(p: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    void, before = state[0], state[1]
    if dt[0] == 0.0:
        before = x[0] + 0.0 * p[0]
    for k in range(len(x)):
        travel = x[k] - before
        before = x[k] + 0.0 * p[0]
        if force[k].real < 0.0:
            load = -p[0] * force[k]
            if load.real > 1.0 and travel.real < 0.0:
                # What the fluid that a capped pressure drives through the gap leaves behind.
                void -= p[1] * (1.0 - 1.0 / load) * travel
            force[k] *= power(1.0 + power(load, _SHARPNESS), -1.0 / _SHARPNESS)
        elif travel.real > 0.0 and void.real > 0.0:
            void -= travel
            if void.real < 0.0:
                void = 0.0 * void
            force[k] *= exp(-void / _EDGE)
    state[0], state[1] = void, before


EFFECT = Effect(
    id="cavitation",
    title="Cavitation in compression",
    phrase="cavitation limits the force in compression to {inverse_cap:inverse}",
    stage="fluid",
    equation="F (1 + r^6)^(-1/6) for F < 0, r = p |F|, void y' = V |x'| (1 - 1/r) where r > 1, F exp(-y / 0.2 mm) for F > 0",
    source="gas pressure times piston area carries 1-2 kN; shock-absorber practice (compression cap, delayed rebound)",
    parameters=(
        Parameter("inverse_cap", "1/N", 0.0, 0.0, 5e-3, "1 / the largest compressing force, p"),
        Parameter("void", "", 1.0, 0.0, 1.5, "void travel over that of a linear damper, V"),
    ),
    typical={"inverse_cap": 1.5e-3, "void": 1.0},
    signature="compression flattens at one force, the more current the more; rebound after it comes late",
    confused_with=("backlash", "flow_asymmetry", "current_saturation"),
    separated_by="rising current at one speed; a change of gas pressure",
    kernel=_apply,
    states=2,
)
