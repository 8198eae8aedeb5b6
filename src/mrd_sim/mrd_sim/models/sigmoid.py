"""Sigmoid model of Wang and Ma: an S-shaped curve over velocity whose shape depends on the peak speed of the motion."""

from dataclasses import replace
from typing import Any

from numba import njit

from mrd_sim.dual import absolute, exp, sqrt, tanh
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import OFFSET

LEAST_SPEED = 1e-4
HIGHEST_SPEED = 1.0
"""m/s; bounds of the peak speed, so that no noise in the acceleration carries the exponentials away."""


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        peak = _peak_speed(x[k], v[k], a[k])
        branch = 1.0 if a[k].real > 0.0 else -1.0 if a[k].real < 0.0 else 0.0
        height = 0.5 * (1.0 + exp(q[k, 1] * peak))
        steepness = q[k, 2] / (1.0 + q[k, 3] * peak)
        curve = tanh(0.5 * steepness * (v[k] - branch * q[k, 4] * peak))
        growth = 1.0 + q[k, 5] * exp(-q[k, 6] * peak) * absolute(v[k])
        force[k] = q[k, 0] * height * curve * growth + q[k, 7]


@njit(cache=True, nogil=True)
def _peak_speed(x: Any, v: Any, a: Any) -> Any:
    """Speed of a sine at the middle of its stroke, from its state at any instant.

    In other motions the acceleration may point away from the middle: then the present speed.
    """
    left = -x * a
    if left.real < 0.0:
        left = 0.0 * left
    peak = sqrt(v * v + left + LEAST_SPEED * LEAST_SPEED)
    return peak if peak.real < HIGHEST_SPEED else HIGHEST_SPEED + 0.0 * peak


MODEL = DamperModel(
    id="sigmoid",
    title="Sigmoid (Wang/Ma)",
    equation="F = f_t h tanh(a (x' - v_h sgn x'') / 2) (1 + k_v |x'|) + f0, x from the middle of the stroke, "
    "peak speed v_m = sqrt(x'^2 - x x''), h = (1 + exp(a1 v_m)) / 2, a = a0 / (1 + k0 v_m), v_h = k4 v_m, "
    "k_v = k1 exp(-a4 v_m)",
    source="Wang et al., Proc. IMechE D 217 (2003); Ma et al. (2003, 2007). Their S(I), for I_j = 0, is the law tanh",
    quantities=(
        Quantity(
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
        Quantity("transition_growth", "a1", "s/m", "growth of this force with the peak speed", 0.5, -2.0, 5.0),
        Quantity(
            "steepness",
            "a0",
            "s/m",
            "slope of the curve over velocity, at low peak speed",
            250.0,
            10.0,
            4000.0,
            (-80.0, -2000.0, 2000.0),
            log=True,
        ),
        Quantity("steepness_decay", "k0", "s/m", "loss of this slope with the peak speed", 2.0, 0.0, 50.0),
        Quantity(
            "loop_half_width",
            "k4",
            "",
            "half the width of the loop over velocity, per peak speed",
            0.05,
            0.0,
            0.5,
            (0.05, -0.5, 0.5),
        ),
        Quantity(
            "viscous_growth",
            "k1",
            "s/m",
            "growth of the force over velocity once the curve has bent",
            6.0,
            0.0,
            50.0,
            (-2.0, -50.0, 50.0),
        ),
        Quantity("viscous_decay", "a4", "s/m", "loss of this growth with the peak speed", 2.0, 0.0, 20.0),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
    dissipative=False,
)
