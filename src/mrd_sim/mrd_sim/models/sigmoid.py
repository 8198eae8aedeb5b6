"""Sigmoid model of Wang and Ma: an S-shaped curve over velocity whose shape depends on the peak speed of the motion."""

from typing import Any

from numba import njit

from mrd_sim.dual import absolute, exp, sqrt, tanh
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import CENTRE, PRELOAD
from mrd_sim.named import named_row, tuple_type

LEAST_PEAK_SPEED = 1e-4
"""Share of the highest peak speed; it keeps the root differentiable at rest."""

COEFFICIENTS = (
    Coefficient(
        "transition_force",
        "f_t",
        "N",
        "force at which the curve bends, at low peak speed",
        100.0,
        0.0,
        1500.0,
        (1200.0, 0.0, 3000.0),
        multiplies="term",
        law="tanh",
    ),
    Coefficient("transition_growth", "a1", "s/m", "growth of this force with the peak speed", 0.5, -2.0, 5.0),
    Coefficient(
        "steepness", "a0", "s/m", "slope at low peak speed", 250.0, 10.0, 4000.0, (-80.0, -2000.0, 2000.0), log=True
    ),
    Coefficient("steepness_decay", "k0", "s/m", "loss of this slope with the peak speed", 2.0, 0.0, 50.0),
    Coefficient("loop_half_width", "k4", "", "half the loop width, per peak speed", 0.05, 0.0, 0.5, (0.05, -0.5, 0.5)),
    Coefficient(
        "viscous_growth",
        "k1",
        "s/m",
        "growth of the force after the bend",
        6.0,
        0.0,
        50.0,
        (-2.0, -50.0, 50.0),
        part="viscous",
    ),
    Coefficient("viscous_decay", "a4", "s/m", "loss of this growth with the peak speed", 2.0, 0.0, 20.0),
    Coefficient(
        "highest_peak_speed",
        "v_x",
        "m/s",
        "peak speed beyond which the shape stays, so that noise in the acceleration cannot make the exponentials overflow",
        1.0,
        1.0,
        1.0,
        free=False,
    ),
    PRELOAD,
    CENTRE,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        peak = _peak_speed(x[k] - c.centre, v[k], a[k], c.highest_peak_speed)
        branch = 1.0 if a[k].real > 0.0 else -1.0 if a[k].real < 0.0 else 0.0
        height = 0.5 * (1.0 + exp(c.transition_growth * peak))
        steepness = c.steepness / (1.0 + c.steepness_decay * peak)
        curve = tanh(0.5 * steepness * (v[k] - branch * c.loop_half_width * peak))
        growth = 1.0 + c.viscous_growth * exp(-c.viscous_decay * peak) * absolute(v[k])
        force[k] = c.transition_force * height * curve * growth + c.offset


@njit(cache=True, nogil=True)
def _peak_speed(x: Any, v: Any, a: Any, highest: Any) -> Any:
    """Return the speed of a sine at the middle of its stroke, from its state at any instant.

    In other motions the acceleration may point away from the middle. Then the present speed counts.
    """
    left = -x * a
    if left.real < 0.0:
        left = 0.0 * left
    least = LEAST_PEAK_SPEED * highest
    peak = sqrt(v * v + left + least * least)
    return peak if peak.real < highest.real else highest + 0.0 * peak


MODEL = DamperModel(
    id="sigmoid",
    title="Sigmoid (Wang/Ma)",
    equation="F = f_t h tanh(a (x' - v_h sgn x'') / 2) (1 + k_v |x'|) + f0, x_m the middle of the strokes, "
    "peak speed v_m = sqrt(x'^2 - (x - x_m) x''), h = (1 + exp(a1 v_m)) / 2, a = a0 / (1 + k0 v_m), v_h = k4 v_m, "
    "k_v = k1 exp(-a4 v_m)",
    source="Wang et al., Proc. IMechE D 217 (2003); Ma et al. (2003, 2007). Their S(I), for I_j = 0, is the law tanh",
    coefficients=COEFFICIENTS,
    kernel=_force,
    dissipative=False,
)
