"""One candidate over a minute at 1 kHz: this bench against scipy's LSODA and against C, side by side.

LSODA integrates the models' textbook equations, once written in Python and once compiled by numba as ours are, with
the motion a compiled function of time: at rtol 1e-6, and at the power of ten that first is as accurate as ours. The C
(bouc_wen.c) follows our scheme operation by operation, in one pass over the same path.
"""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import numpy as np
from common import RATE, Array, console, current, duration, machine, position, sampled, side_by_side, velocity
from numba import njit
from rich.table import Table
from scipy.integrate import odeint, solve_ivp

from mrd_sim.models import MODELS
from mrd_sim.path import Path, make_path

SECONDS = 60
OURS = "this bench"
ROUNDS = 5
RTOL = 1e-6
LONGEST_STEP = 5e-3
"""s; a twelfth of the motion's shortest period or less, so that LSODA steps over no reversal."""
C_FLAGS = ("-O3", "-march=native")


@njit(cache=True)
def _state_slope(w: float, speed: float, sigma: float) -> float:
    return speed - sigma * abs(speed) * w * abs(w) - (1.0 - sigma) * speed * w * w


@njit(cache=True)
def _bouc_wen(t: float, s: Array, p: Array) -> Array:
    w, u = s
    return np.array([_state_slope(w, velocity(t), p[4]) / (p[2] + p[3] * u), (current(t) - u) / p[10]])


@njit(cache=True)
def _modified(t: float, s: Array, p: Array) -> Array:
    w, u, y = s
    c0, c1 = p[6] + p[7] * u, p[8] + p[9] * u
    v = velocity(t)
    y_speed = ((p[0] + p[1] * u) * w + c0 * v + p[10] * (position(t) - y)) / (c0 + c1)
    return np.array([_state_slope(w, v - y_speed, p[4]) / (p[2] + p[3] * u), (current(t) - u) / p[13], y_speed])


def _bouc_wen_force(s: Array, p: Array, x: Array, v: Array) -> Array:
    w, u = s
    return (p[0] + p[1] * u) * w + (p[6] + p[7] * u) * v + p[8] * x + p[9]


def _modified_force(s: Array, p: Array, x: Array, v: Array) -> Array:
    w, u, y = s
    c0, c1 = p[6] + p[7] * u, p[8] + p[9] * u
    return c1 * ((p[0] + p[1] * u) * w + c0 * v + p[10] * (x - y)) / (c0 + c1) + p[11] * x + p[12]


EQUATIONS = {
    # by model: slopes of the states, force, and the size of each state, to which its absolute tolerance refers
    "bouc_wen": (_bouc_wen, _bouc_wen_force, np.array([1.0, 0.2])),
    "modified_bouc_wen": (_modified, _modified_force, np.array([1.0, 0.2, 0.01])),
}


def at_rest(model_id: str) -> Array:
    """States of a damper at rest and unloaded, its coil settled."""
    return np.array([0.0, current(0.0), position(0.0)][: 2 + (model_id != "bouc_wen")])


def with_solve_ivp(
    model_id: str, theta: Array, time_s: Array, x: Array, v: Array, rtol: float = RTOL, python: bool = False
) -> Array:
    """Force in N by scipy's `solve_ivp`, its equations compiled or in ``python``."""
    slopes, force, size = EQUATIONS[model_id]
    found = solve_ivp(
        slopes.py_func if python else slopes,
        (0.0, time_s[-1]),
        at_rest(model_id),
        "LSODA",
        time_s,
        args=(theta,),
        rtol=rtol,
        atol=rtol * size,
        max_step=LONGEST_STEP,
    )
    return force(found.y, theta, x, v)


def with_odeint(model_id: str, theta: Array, time_s: Array, x: Array, v: Array, rtol: float = RTOL) -> Array:
    """The same by `odeint`: the same LSODA with less of Python about it."""
    slopes, force, size = EQUATIONS[model_id]
    states = odeint(
        slopes,
        at_rest(model_id),
        time_s,
        args=(theta,),
        tfirst=True,
        rtol=rtol,
        atol=rtol * size,
        hmax=LONGEST_STEP,
        mxstep=100_000,
    )
    return force(states.T, theta, x, v)


def compiled_c(folder: str) -> ctypes.CDLL | None:
    """The C models; None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    library = File(folder, "bouc_wen.so")
    source = File(__file__).with_suffix("").with_name("bouc_wen.c")
    subprocess.run([compiler, *C_FLAGS, "-fPIC", "-shared", str(source), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def with_c(library: ctypes.CDLL, model_id: str, theta: Array, path: Path) -> tuple[Callable[[], None], Array]:
    """A call that integrates a model in C, and the force that it fills."""
    is_sample = np.zeros(len(path.dt), np.int8)
    is_sample[path.samples] = 1
    force = np.empty(len(path.samples))
    series = (theta, path.dt, path.position, path.velocity, path.current, is_sample, force)
    first, *others = (array.ctypes.data_as(ctypes.c_void_p) for array in series)
    arguments = (first, ctypes.c_long(len(path.dt)), *others)
    function = library[model_id]

    def call(_keep: object = series) -> None:
        function(*arguments)

    return call, force


def compare(model_id: str, library: ctypes.CDLL | None, table: Table) -> None:
    """Measure one model."""
    model = MODELS[model_id]
    theta = model.defaults
    time_s, x, v, i = sampled(int(SECONDS * RATE))
    path = make_path(time_s, x, v, np.gradient(v, time_s), i)
    reference = with_odeint(model_id, theta, time_s, x, v, rtol=1e-12)

    def nrms(force: Array) -> float:
        return float(np.sqrt(np.mean((force - reference) ** 2)) / np.std(reference))

    def ours() -> Array:
        return model.force(theta, path)

    def solved(**options: Any) -> Callable[[], Array]:
        return lambda: with_solve_ivp(model_id, theta, time_s, x, v, **options)

    goal = nrms(ours())
    equal = next((rtol for rtol in 10.0 ** -np.arange(2, 11) if nrms(solved(rtol=rtol)()) <= goal), 1e-10)
    peers: dict[str, tuple[Callable[[], Any], int]] = {
        OURS: (ours, 30),
        f"scipy solve_ivp, Python, {RTOL:g}": (solved(python=True), 1),
        f"scipy solve_ivp, compiled, {RTOL:g}": (solved(), 1),
        f"scipy solve_ivp, compiled, {equal:g} (as accurate)": (solved(rtol=equal), 1),
        f"scipy odeint, compiled, {RTOL:g}": (lambda: with_odeint(model_id, theta, time_s, x, v), 1),
    }
    forces = {name: work() for name, (work, _) in peers.items()}
    if library is not None:
        name = f"C, gcc {' '.join(C_FLAGS)}"
        call, forces[name] = with_c(library, model_id, theta, path)
        call()
        np.testing.assert_allclose(forces[name], forces[OURS], rtol=0, atol=1e-6, err_msg="C follows another scheme")
        peers[name] = (call, 30)
    measured = side_by_side(peers, ROUNDS)
    for name, seconds in measured.items():
        ratio = seconds / measured[OURS]
        table.add_row(
            model_id if name == OURS else "",
            name,
            duration(seconds),
            f"{ratio:.0f}" if ratio > 10 else f"{ratio:.2f}",
            f"{nrms(forces[name]):.1e}",
            f"{np.abs(forces[name] - reference).max():.1e}",
        )
    table.add_section()


def main() -> None:
    """Print the table."""
    table = Table(title=f"One candidate over {SECONDS} s at {RATE:g} Hz: processor time", caption=machine())
    for column in ("model", "by", "time", "time / ours", "NRMS error", "largest error, N"):
        table.add_column(column, justify="left" if column in ("model", "by") else "right")
    with tempfile.TemporaryDirectory() as folder:
        library = compiled_c(folder)
        for model_id in EQUATIONS:
            compare(model_id, library, table)
    console.print(table)


if __name__ == "__main__":
    main()
