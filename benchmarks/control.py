"""Time of a control loop against simulated time: quarter car, Bouc-Wen damper, on-off skyhook, at 1 kHz on one core.

Beside it scipy's `solve_ivp` (LSODA) integrates the same problem in the same run: the same road, linear between its samples,
the lags of supply and coil, the textbook equation of the damper, and the law read every millisecond as on the bench. So it
is started anew at each sample; with a constant current it chooses its own steps.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from common import Array, console, describe_machine, format_duration, measure_alternately
from numba import njit
from rich.table import Table
from scipy.integrate import solve_ivp

from mrd_control.excitations import Road
from mrd_control.laws import LAWS
from mrd_control.linear import LinearSystem
from mrd_control.loop import run_loop
from mrd_control.systems import QuarterCar
from mrd_sim.damper import Damper

RATE = 1000.0
SECONDS = 60
SCIPY_SECONDS = 4
"""Simulated by scipy, which is slow; its time is scaled to `SECONDS`."""
SUPPLY_LAG = 0.003
ROUNDS = 5
RTOL = 1e-6
LOOSE = 1e-3
"""Tolerance at which scipy is about as accurate as the loop."""
ABSOLUTE = np.array([1e-3, 1e-3, 0.1, 0.1, 1.0, 0.2, 0.2]) * RTOL
"""Of positions (m), velocities (m/s), hysteretic state and currents (A)."""
LEAST = 200.0
"""Times real time that the loop has to reach on one core."""
VALUES = {"yield_force": 80.0, "yield_force_per_A": 900.0, "yield_travel": 125e-6, "viscous": 900.0, "viscous_per_A": 2500.0}
VALUES["coil_lag"] = 0.004


@njit(cache=True)
def slope(t: float, s: Array, a: Array, b: Array, road: Array, current: float, p: Array) -> Array:
    """Return the derivatives of z_s, z_u, z_s', z_u', hysteretic state, current in the coil and effective current."""
    k = min(int(t * RATE), len(road) - 2)
    part = t * RATE - k
    z_r = (1.0 - part) * road[k] + part * road[k + 1]
    x, v, w, u = s[0] - s[1], s[2] - s[3], s[4], s[6]
    force = (p[0] + p[1] * u) * w + (p[3] + p[4] * u) * v + p[5] * x + p[6]
    derivative = np.empty(7)
    for i in range(4):
        derivative[i] = b[i, 0] * z_r + b[i, 2] * force
        for j in range(4):
            derivative[i] += a[i, j] * s[j]
    derivative[4] = (v - p[7] * abs(v) * w * abs(w) - (1.0 - p[7]) * v * w * w) / p[2]
    derivative[5] = (current - s[5]) / SUPPLY_LAG
    derivative[6] = (s[5] - u) / p[8]
    return derivative


def with_solve_ivp(
    system: LinearSystem, road: Array, p: Array, rtol: float, skyhook: bool, function: Callable[..., Any] = slope
) -> Array:
    """Return the states (n, 7) at the samples."""
    states = np.zeros((len(road), 7))
    options = {"method": "LSODA", "rtol": rtol, "atol": ABSOLUTE * rtol / RTOL}
    if not skyhook:
        time = np.arange(len(road)) / RATE
        arguments = (system.a, system.b, road, 0.3, p)
        return solve_ivp(function, (0.0, time[-1]), states[0], t_eval=time, args=arguments, max_step=5e-3, **options).y.T
    for k in range(len(road) - 1):
        v_s, v_u = states[k, 2:4]
        current = 0.3 if v_s * (v_s - v_u) >= 0.0 else 0.0
        span = (k / RATE, (k + 1) / RATE)
        states[k + 1] = solve_ivp(function, span, states[k], args=(system.a, system.b, road, current, p), **options).y[:, -1]
    return states


def main() -> None:
    """Print the table; fail where the loop is slower than it has to be."""
    system, damper = QuarterCar().linear(), Damper("bouc_wen", VALUES)
    names = {name: float(value) for name, value in zip(damper.model.names, damper.theta, strict=True)}
    assert names["exponent"] == 2.0
    wanted = ("yield_force", "yield_force_per_A", "yield_travel", "viscous", "viscous_per_A", "stiffness", "offset", "shape")
    p = np.array([*(names[name] for name in wanted), names["coil_lag"]])
    base = Road("B", 20.0, seed=1).base(int(SECONDS * RATE) + 1, RATE)
    short = np.ascontiguousarray(base[: int(SCIPY_SECONDS * RATE) + 1, 0])

    def loop(law: str, motion: Array, gains: dict[str, float]) -> Any:
        return run_loop(system, damper, LAWS[law], motion, RATE, gains=gains, supply_lag=SUPPLY_LAG)

    table = Table(
        title=f"Quarter car with Bouc-Wen damper at {RATE:g} Hz: {SECONDS} s, one core", caption=describe_machine()
    )
    for column in ("law", "by", "time", "times real time", "NRMS error of travel"):
        table.add_column(column, justify="left" if column in ("law", "by") else "right")
    slowest = math.inf
    for law, gains in (("skyhook_on_off", {}), ("constant_current", {"current": 0.3})):
        skyhook = law == "skyhook_on_off"
        reference = with_solve_ivp(system, short, p, 1e-9, skyhook)
        travel = reference[:, 0] - reference[:, 1]
        works: dict[str, tuple[Callable[[], Any], int, float]] = {
            "this bench": (lambda law=law, gains=gains: loop(law, base, gains), 10, SECONDS),
            f"scipy solve_ivp, compiled, {RTOL:g}": (
                lambda skyhook=skyhook: with_solve_ivp(system, short, p, RTOL, skyhook),
                1,
                SCIPY_SECONDS,
            ),
            f"scipy solve_ivp, compiled, {LOOSE:g}": (
                lambda skyhook=skyhook: with_solve_ivp(system, short, p, LOOSE, skyhook),
                1,
                SCIPY_SECONDS,
            ),
            f"scipy solve_ivp, Python, {RTOL:g}": (
                lambda skyhook=skyhook: with_solve_ivp(system, short, p, RTOL, skyhook, slope.py_func),
                1,
                SCIPY_SECONDS,
            ),
        }
        found = {name: work() for name, (work, _, _) in works.items()}
        measured = measure_alternately({name: work[:2] for name, work in works.items()}, ROUNDS)
        for name, seconds in measured.items():
            result = found[name]
            own = result.travel[: len(short)] if name == "this bench" else result[:, 0] - result[:, 1]
            error = np.sqrt(np.mean((own - travel) ** 2)) / np.std(travel)
            ratio = works[name][2] / seconds
            slowest = min(slowest, ratio) if name == "this bench" else slowest
            time = format_duration(seconds * SECONDS / works[name][2])
            table.add_row(law if name == "this bench" else "", name, time, f"{ratio:.3g}", f"{error:.1e}")
        table.add_section()
    console.print(table)
    if slowest < LEAST:
        raise SystemExit(f"the loop runs {slowest:.0f} times real time, expected at least {LEAST:.0f}")


if __name__ == "__main__":
    main()
