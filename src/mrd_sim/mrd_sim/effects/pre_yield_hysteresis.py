"""Pre-yield hysteresis, for damper models whose force is a function of speed: it comes with travel after a reversal."""

from numba import njit

from mrd_sim.dual import exp, tanh
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.parameter import Parameter

_CREEP = 2e-3  # m/s


@njit(cache=True, nogil=True)
def _apply(p: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    w, before = state[0], state[1]
    if dt[0] == 0.0:
        before = x[0] + 0.0 * p[0]
    for k in range(len(x)):
        travel = (x[k] - before) / p[2]
        before = x[k] + 0.0 * p[0]
        w = 1.0 - (1.0 - w) * exp(-travel) if travel.real >= 0.0 else (1.0 + w) * exp(travel) - 1.0
        force[k] += (p[0] + p[1] * u[k]) * (w - tanh(v[k] / _CREEP))
    state[0], state[1] = w, before


EFFECT = Effect(
    id="pre_yield_hysteresis",
    title="Pre-yield hysteresis",
    phrase="after each reversal the fluid's friction builds up over {yield_travel} of travel",
    stage="fluid",
    equation="F + (h0 + h1 u) (w - tanh(x' / 2 mm/s)), x_y w' = x' - |x'| w",
    source="Dahl (1968)",
    parameters=(
        Parameter("amount", "N", 0.0, 0.0, 500.0, "friction that becomes hysteretic, at 0 A, h0"),
        Parameter("amount_per_A", "N/A", 0.0, 0.0, 3000.0, "its slope over current, h1"),
        Parameter("yield_travel", "m", 2e-4, 1e-5, 3e-3, "travel to yield, x_y", log=True),
    ),
    typical={"amount": 80.0, "amount_per_A": 600.0, "yield_travel": 3e-4},
    signature="after a reversal the force comes with travel, not with speed: a loop around zero speed, wider with current",
    confused_with=("series_compliance", "joint_play", "backlash", "rate_dependent_hysteresis", "seal_friction"),
    separated_by="small strokes, and the same peak speed at different frequencies",
    kernel=_apply,
    states=2,
)
