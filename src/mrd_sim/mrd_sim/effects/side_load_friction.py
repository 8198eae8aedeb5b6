"""Friction that grows away from one place of the stroke: side load on a misaligned rod."""

from numba import njit

from mrd_sim.dual import absolute, tanh
from mrd_sim.effects.effect import Array, Effect
from mrd_sim.parameter import Parameter

_CREEP = 2e-3  # m/s


@njit(cache=True, nogil=True)
def _apply(p: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] += p[0] * absolute(x[k] - p[1]) * tanh(v[k] / _CREEP)


EFFECT = Effect(
    id="side_load_friction",
    title="Side-load friction",
    phrase="side load adds friction that grows with the stroke by {slope}",
    stage="structure",
    equation="F + F_1 |x - x_c| tanh(x' / 2 mm/s)",
    source="misaligned clamping: 5-30 N across the stroke of measured dampers",
    parameters=(
        Parameter("slope", "N/m", 0.0, 0.0, 3000.0, "friction over the distance from the centre, F_1"),
        Parameter("centre", "m", 0.0, -0.025, 0.025, "where it is least, x_c"),
    ),
    typical={"slope": 1500.0, "centre": 0.0},
    signature="a bow tie of force over position: friction varies along the stroke, at every current",
    confused_with=("gas_spring", "end_stop", "seal_friction", "servo_ripple"),
    separated_by="slow ramps over the whole stroke; the damper clamped anew",
    kernel=_apply,
)
